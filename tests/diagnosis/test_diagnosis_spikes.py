"""Single samples that stand out are spikes, but for those that a recorded command explains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service import Recording
from magcal_service.diagnosis.prepare import prepare
from magcal_service.diagnosis.spikes import spikes
from magcal_service.model import Array, measure
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.recordings.inspect.account import Account
from tests.physics.scenes import COUNT, NOISE_NT, X, scene, spoiled

BEGINS = np.arange(40, COUNT - 10, 90)
LASTS = 5
"""Rows of a pulse, about one of which the median of nine rows is that of none."""

FIELD_NT = 40.0 * NOISE_NT * np.array([0.8, -0.5, 0.33])
NOISE = NOISE_NT * np.random.default_rng(20261132).normal(size=(COUNT, 3))


def commanded() -> Array:
    """A coil's command (n,), on for five rows again and again, with either sign."""
    command = np.zeros(COUNT)
    for number, begin in enumerate(BEGINS.tolist()):
        command[begin : begin + LASTS] = (-1.0) ** number
    return command


def flown(disturbance_nt: Array, **channels: Array) -> Scene:
    """The clean craft with noise, a body field (n, 3) and recorded commands in A m2."""
    of = spoiled(measure(X, scene().calibrated_nt + disturbance_nt + NOISE), scene())
    told = {name: Telemetry(name, "magnetic moment", values[:, None]) for name, values in channels.items()}
    return replace(of, channels=told)


def rows_of(of: Scene) -> tuple[set[int], set[int]]:
    single, edges = spikes(of, X)
    return set(np.flatnonzero(single).tolist()), set(np.flatnonzero(edges).tolist())


def single(rows: list[int]) -> Array:
    """A field far beyond the noise in some rows alone (n, 3)."""
    found = np.zeros((COUNT, 3))
    found[rows] = 60.0 * NOISE_NT * scene().unit[rows]
    return found


def test_a_sample_far_out_of_its_neighbourhood_is_a_spike() -> None:
    """Eight of the residual's robust sigmas, of its neighbours and of all; a step is none."""
    of = scene(NOISE_NT)
    field = np.array(of.field_nt)
    field[700] += 12.0 * NOISE_NT * scene().unit[700]
    field[900] += 6.0 * NOISE_NT * scene().unit[900]
    field[0] -= 12.0 * NOISE_NT * scene().unit[0]
    assert rows_of(spoiled(field, of)) == ({0, 700}, set())
    stepped = of.field_nt + 20.0 * NOISE_NT * scene().unit * (np.arange(COUNT) > 1000)[:, None]
    assert rows_of(spoiled(stepped, of)) == (set(), set())


@pytest.mark.parametrize("late", [0, 1])
def test_what_a_recorded_command_explains_is_no_spike(late: int) -> None:
    """Also where it acts from the row after its own; without a record of it the same rows are spikes."""
    acting = np.roll(commanded(), late)
    disturbance = acting[:, None] * FIELD_NT
    without, _ = rows_of(flown(disturbance))
    assert len(without) > len(BEGINS)
    assert without <= set(np.flatnonzero(acting).tolist())
    assert rows_of(flown(disturbance, coil=commanded())) == (set(), set())


def test_a_spike_is_one_whatever_is_recorded_beside_it() -> None:
    """Within a pulse and between them."""
    rows = [int(BEGINS[3]) + 2, int(BEGINS[7]) + 40]
    disturbance = commanded()[:, None] * FIELD_NT + single(rows)
    assert rows_of(flown(disturbance, coil=commanded())) == (set(rows), set())


def test_a_row_that_is_wrong_in_the_command_too_does_not_explain_itself() -> None:
    """A record whose one value that differs is in the row of the spike fits that row, and nothing else."""
    glitch = np.zeros(COUNT)
    glitch[700] = 5.0
    assert rows_of(flown(single([700]), coil=glitch)) == ({700}, set())


def test_a_row_within_the_change_of_a_command_is_an_edge_of_it() -> None:
    """A coil that comes on halfway through the sample of its row; a spike elsewhere stays one."""
    acting = commanded()
    acting[BEGINS[2::5]] *= 0.5
    disturbance = 4.0 * acting[:, None] * FIELD_NT + single([int(BEGINS[4]) + 40])
    found, edges = rows_of(flown(disturbance, coil=commanded()))
    assert found == {int(BEGINS[4]) + 40}
    assert len(edges) >= 3
    assert edges <= set(BEGINS[2::5].tolist())


def test_edges_are_left_out_and_counted_as_such() -> None:
    acting = commanded()
    acting[BEGINS[2::5]] *= 0.5
    of = flown(4.0 * acting[:, None] * FIELD_NT, coil=commanded())
    channels = {"coil": (commanded(), "A m2")}
    recording = Recording.from_arrays(of.time_s, of.field_nt, of.magnitude_nt, noise_nt=NOISE_NT, channels=channels)
    left_out = prepare(recording, ()).left_out
    assert left_out["spikes"] == 0
    assert 1 <= left_out["edges"] <= len(BEGINS[2::5])
    account = str(Account(COUNT, left_out))
    assert account.endswith(f"left out: {left_out['edges']} within an edge of a recorded command")
