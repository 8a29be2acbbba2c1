"""Torquers that nobody recorded, by their beat: found with cycle, share and size, and nothing else taken for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.pulses import Beat, _evidences, _nats_of_absence, _swells, _without_empty
from magcal_service.physics.interface import Finding
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.physics.scene.view import View
from tests.physics.scenes import ORIGIN_NS

COUNT, NOISE_NT = 9000, 100.0
TIME_S = np.arange(COUNT) * 1.0
CYCLE_S, SHARE, FIRST_S = 90.0, 0.3, 21.0
CYCLE = ((TIME_S - FIRST_S) // CYCLE_S).astype(int)
ON = (TIME_S - FIRST_S) % CYCLE_S < SHARE * CYCLE_S


def test_the_evidence_for_fields_is_the_ratio_of_two_normal_densities() -> None:
    """Of what was measured with fields of a variance, and without any."""
    rng = np.random.default_rng(5)
    directions, seen = rng.normal(size=(4, 6, 3)), rng.normal(size=(4, 6))
    squares, products = np.swapaxes(directions, 1, 2) @ directions, np.einsum("kni,kn->ki", directions, seen)
    sizes = (0.1, 2.0)
    found = _evidences(squares, products, sizes)
    for row, size in zip(found, sizes, strict=True):
        for nats, of, values in zip(row.tolist(), directions, seen, strict=True):
            covariance = np.eye(6) + size * of @ of.T
            gained = values @ values - values @ np.linalg.solve(covariance, values)
            assert nats == pytest.approx(0.5 * (gained - np.linalg.slogdet(covariance)[1]))


def scene(**channels: Telemetry) -> Scene:
    """A craft that tumbles in orbit."""
    turn = np.stack([np.sin(TIME_S / 1.9), np.cos(TIME_S / 1.9), 0.7 * np.sin(TIME_S / 5.3)], axis=1)
    field = 40_000.0 * turn / np.linalg.norm(turn, axis=1)[:, None]
    return Scene(TIME_S, ORIGIN_NS, True, field, field, field, np.linalg.norm(field, axis=1), channels=channels)


def found(disturbance: Array, of: Scene | None = None, noise: Array | None = None) -> Finding | None:
    """What a field (n, 3) [nT] in the body, beside white noise, is taken for."""
    of = scene() if of is None else of
    noise = np.random.default_rng(3).normal(0.0, NOISE_NT, COUNT) if noise is None else noise
    residual = np.einsum("ni,ni->n", of.unit, disturbance) + noise
    find = effect_named("torquer").find
    assert find is not None
    return find(View(of, residual, NOISE_NT))


def levels(seed: int = 9) -> Array:
    """(n, 3) another field in each cycle, 150 nT by rms and axis."""
    return np.asarray(np.random.default_rng(seed).normal(0.0, 150.0, (CYCLE.max() + 2, 3))[CYCLE])


def test_a_beat_is_found_with_its_cycle_share_and_size() -> None:
    pulses = found(ON[:, None] * levels())
    assert pulses is not None
    value = {name: float(one.value) for name, one in pulses.parameters.items()}
    assert value["period_s"] == CYCLE_S
    assert value["on_share"] == pytest.approx(SHARE, abs=0.05)
    assert value["pulse_nt"] == pytest.approx(150.0 * np.sqrt(3.0), rel=0.15)
    assert pulses.driver == "inferred:pulses"
    assert pulses.rivals == (("unknown", 0.03),)
    assert 0.0 < pulses.off_nats <= pulses.nats
    assert pulses.nats > 1000.0


def test_all_rows_of_the_pulses_are_left_out_and_most_others_stay() -> None:
    pulses = found(ON[:, None] * levels())
    assert pulses is not None
    assert pulses.spoiled is not None
    assert pulses.spoiled[ON].all()
    assert np.mean(pulses.spoiled[~ON]) < 0.12


def turning_slowly() -> Scene:
    turn = np.stack([np.sin(TIME_S / 27.0), np.cos(TIME_S / 27.0), 0.7 * np.sin(TIME_S / 154.0)], axis=1)
    field = 40_000.0 * turn / np.linalg.norm(turn, axis=1)[:, None]
    return replace(scene(), field_nt=field, calibrated_nt=field, clean_field_nt=field)


@pytest.mark.parametrize("size", [0.6, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("seed", [46, 60, 62, 65])
def test_what_switches_at_random_has_no_pauses(seed: int, size: float) -> None:
    """A magnet that flips, every three minutes on the average, on a craft that turns slowly: cut into cycles it has
    another field in each, and in the pauses as well."""
    flips = np.cumsum(np.random.default_rng(seed).random(COUNT) < 1.0 / 180.0) % 2
    assert found(size * np.outer(2.0 * flips - 1.0, [36.0, -24.0, 56.0]), turning_slowly()) is None


def test_what_pulses_on_a_craft_that_turns_slowly_has_pauses() -> None:
    assert found(0.7 * ON[:, None] * levels(), turning_slowly()) is not None


def test_pauses_of_few_rows_are_not_left_out_with_the_pulses() -> None:
    """Coils on for four rows of five: one to either side of the fifth would leave none that is sound."""
    count, whole = COUNT // 3, scene()
    on = np.arange(count) % 5 != 1
    each = np.random.default_rng(31).normal(0.0, 400.0, (count // 5 + 1, 3))[(np.arange(count) - 2) // 5 + 1]
    field, length = whole.field_nt[:count], whole.magnitude_nt[:count]
    seldom = Scene(6.0 * np.arange(count), ORIGIN_NS, True, field, field, field, length)
    pulses = found(on[:, None] * each, seldom, np.random.default_rng(3).normal(0.0, NOISE_NT, count))
    assert pulses is not None
    assert float(pulses.parameters["period_s"].value) == 30.0
    assert pulses.spoiled is not None
    assert pulses.spoiled[on].all()
    assert not pulses.spoiled[~on].any()


@pytest.mark.parametrize("cycle_s", [90.0, 120.0])
def test_a_cycle_without_empty_pulses_is_the_one_that_is_told(cycle_s: float) -> None:
    """Coils on for a tenth of it: half of the cycle, with every second pulse empty, fits nearly as well."""
    on = TIME_S % cycle_s < 0.1 * cycle_s
    each = np.random.default_rng(29).normal(0.0, 250.0, (int(TIME_S[-1] // cycle_s) + 1, 3))
    pulses = found(on[:, None] * each[(TIME_S // cycle_s).astype(int)])
    assert pulses is not None
    assert float(pulses.parameters["period_s"].value) == cycle_s


def test_where_nothing_speaks_for_any_cycle_the_best_is_still_one() -> None:
    found = [(-5.0, Beat(60.0, 0.0, 0.2), 0.1), (-5.2, Beat(120.0, 0.0, 0.1), 0.1), (-9.0, Beat(50.0, 0.0, 0.1), 0.1)]
    assert _without_empty(found) == found[0]
    assert _without_empty([(-one[0], *one[1:]) for one in found])[1].period_s == 50.0
    near = [(60.0, Beat(60.0, 0.0, 0.2), 0.1), (58.0, Beat(120.0, 0.0, 0.1), 0.1), (59.0, Beat(100.0, 0.0, 0.1), 0.1)]
    assert _without_empty(near)[1].period_s == 120.0


def test_one_coil_with_either_sign_is_found_with_more_doubt() -> None:
    pulses = found(ON[:, None] * levels()[:, :1] * np.array([0.6, -0.64, 0.48]))
    assert pulses is not None
    assert float(pulses.parameters["period_s"].value) == CYCLE_S
    assert pulses.rivals == (("current_loop", 0.03), ("unknown", 0.03))


def test_what_pulses_that_are_gone_tell_is_what_noise_gives_against_them() -> None:
    """Over many draws of noise alone, to three of its own sigmas."""
    rng = np.random.default_rng(20261131)
    unit = rng.normal(size=(30, 9, 3))
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    squares = np.einsum("kni,knj->kij", unit, unit)
    products = np.einsum("kni,dkn->dki", unit, rng.normal(size=(2000, 30, 9)))
    against = -np.array([_evidences(squares, one, (0.5,)).sum() for one in products])
    sigma = float(against.std()) / len(against) ** 0.5
    assert _nats_of_absence(squares, 0.5) == pytest.approx(float(against.mean()), abs=3.0 * sigma)
    assert sigma < 0.01 * against.mean()


@pytest.mark.parametrize(("wave", "seen"), [(False, True), (True, False)])
def test_a_wave_that_passes_through_none_is_no_coil(wave: bool, seen: bool) -> None:
    """A half of a sine in each cycle swells and fades, where a coil is on at once and at all of it."""
    within = np.where(ON, (TIME_S - FIRST_S) % CYCLE_S / (SHARE * CYCLE_S), 0.0)
    course = np.sin(np.pi * within) if wave else ON.astype(np.float64)
    assert (found(course[:, None] * levels()) is not None) is seen


def test_pulses_of_one_row_have_no_middle_to_be_held_against() -> None:
    """A row every 5 s, and pulses of a tenth of 45 s: each holds one, at its beginning."""
    some, field = TIME_S % 5.0 == 0.0, scene().field_nt
    time_s, field = TIME_S[some], field[some]
    of = Scene(time_s, ORIGIN_NS, True, field, field, field, np.linalg.norm(field, axis=1), channels={})
    beat = Beat(45.0, 0.0, 0.1)
    fields = np.ones((int(of.time_s[-1] // 45.0), 3))
    assert not _swells(View(of, np.zeros(len(of.time_s)), NOISE_NT), beat, fields)


def _bursts() -> Array:
    rng = np.random.default_rng(12)
    field = np.zeros((COUNT, 3))
    for begin in rng.integers(0, COUNT - 30, 80):
        field[begin : begin + 27] += rng.normal(0.0, 200.0, 3)
    return field


def _memory() -> Array:
    noise = np.random.default_rng(2).normal(0.0, 60.0, (COUNT, 3))
    for row in range(1, COUNT):
        noise[row] += 0.97 * noise[row - 1]
    return noise


ONE_WAY = np.array([0.6, -0.64, 0.48])
ELSE = {
    "nothing": np.zeros((COUNT, 3)),
    "noise with a memory": _memory(),
    "bursts at no regular times": _bursts(),
    "two loads, each in some of the pulses": ON[:, None]
    * 200.0
    * ((levels()[:, :1] > 0.0) * np.array([0.6, -0.64, 0.48]) + (levels()[:, 1:2] > 0.0) * np.array([0.1, 0.7, 0.7])),
    "a load of another current in each cycle": ON[:, None] * np.abs(levels()[:, :1]) * ONE_WAY,
    "the same field in each pulse": ON[:, None] * np.array([150.0, -90.0, 60.0]),
    "pulses that follow the orbit": ON[:, None]
    * 200.0
    * np.stack([np.sin(TIME_S / 900.0 + k) for k in range(3)], axis=1),
    "a gain that is lower in every third pulse": -0.008 * (ON & (CYCLE % 3 == 0))[:, None] * scene().field_nt,
    "a gain that is lower in each pulse": -0.004 * ON[:, None] * scene().field_nt,
    "gains of the axes that change in each pulse": ON[:, None] * scene().field_nt * np.array([0.006, -0.005, 0.003]),
    "a field in the gaps as well": levels() + 0.5 * levels(4),
    "ten bursts, by chance at multiples of a cycle": (ON & np.isin(CYCLE, [3, 17, 22, 38, 41, 59, 66, 78, 90, 95]))[
        :, None
    ]
    * 6.0
    * levels(),
    "steps": 300.0 * np.sign(np.sin(TIME_S[:, None] / np.array([700.0, 900.0, 1300.0]))),
}


@pytest.mark.parametrize("name", ELSE)
def test_what_is_no_beat_is_none(name: str) -> None:
    assert found(ELSE[name]) is None


def test_a_noise_that_is_louder_in_the_pulses_is_no_field() -> None:
    """Its means vary more, in any direction and with either sign."""
    louder = np.random.default_rng(23).normal(0.0, NOISE_NT, COUNT) * np.where(ON, 4.0, 1.0)
    assert found(np.zeros((COUNT, 3)), noise=louder) is None
    quiet = np.random.default_rng(24).normal(0.0, 0.5 * NOISE_NT, COUNT) * np.where(ON, 4.0, 1.0)
    assert found(np.zeros((COUNT, 3)), noise=quiet) is None


def test_a_recorded_torquer_and_a_laboratory_are_left_to_what_was_recorded() -> None:
    beat = ON[:, None] * levels()
    coils = Telemetry("coils", "magnetic moment", np.sign(levels()) * ON[:, None])
    assert found(beat, scene(coils=coils)) is None
    assert found(beat, replace(scene(), in_orbit=False)) is None
