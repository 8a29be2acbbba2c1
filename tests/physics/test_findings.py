"""What effects find in samples, attitude and noise: their numbers by hand, and where a finding begins."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.effects.coloured_noise import is_noise
from magcal_service.physics.interface import Finding
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import Turn
from magcal_service.physics.scene.view import View

COUNT, NOISE_NT = 1000, 10.0
TIME_S = 2.0 * np.arange(float(COUNT))
RPM = math.pi / 30.0


def field_nt() -> Array:
    """A field (n, 3) that swings on every axis, with noise."""
    swing = np.stack([np.sin(TIME_S / 37.0), np.cos(TIME_S / 53.0), np.sin(TIME_S / 29.0)], axis=1)
    return 30e3 * swing + np.random.default_rng(1).normal(0.0, NOISE_NT, (COUNT, 3))


def viewed(field: Array, residual: Array | None = None, **changes: object) -> View:
    magnitude = np.linalg.norm(field, axis=1)
    scene = Scene(TIME_S[: len(field)], 0, True, field, field, field, magnitude)
    given = np.random.default_rng(2).normal(0.0, NOISE_NT, len(field)) if residual is None else residual
    return View(scene, given, NOISE_NT, **changes)  # type: ignore[arg-type]


def find(name: str, view: View) -> Finding | None:
    effect = effect_named(name)
    assert effect.find is not None
    return effect.find(view)


# Samples


@pytest.mark.parametrize(("length", "found"), [(24, False), (25, True)])
def test_an_axis_is_stuck_from_25_samples_on(length: int, found: bool) -> None:
    """The value, the first and the last second, and the rows that no fit should use."""
    field = field_nt()
    field[100 : 100 + length, 1] = 123.0
    finding = find("stuck_axis", viewed(field))
    assert (finding is not None) is found
    if finding is not None:
        assert finding.spoiled is not None
        assert np.flatnonzero(finding.spoiled).tolist() == list(range(100, 125))
        values = {name: value.value.tolist() for name, value in finding.parameters.items()}
        assert values == {
            "axis": [0.0, 1.0, 0.0],
            "value_nt": 123.0,
            "share_of_samples": 0.025,
            "from_s": 200.0,
            "to_s": 248.0,
        }
        assert (finding.nats, finding.share, finding.time_s) == (25.0, 1.0, (200.0, 248.0))
        assert all(not value.sigma.any() for value in finding.parameters.values())
        assert all(value.sigma.shape == value.value.shape for value in finding.parameters.values())


@pytest.mark.parametrize(("moved_sigmas", "found"), [(19.0, False), (21.0, True)])
def test_an_axis_is_stuck_only_while_the_others_move(moved_sigmas: float, found: bool) -> None:
    field = field_nt()
    field[100:140] = [5.0, 6.0, 7.0]
    field[100:140, 2] += np.linspace(0.0, moved_sigmas * NOISE_NT, 40)
    field[140:, 0] += np.random.default_rng(3).normal(size=COUNT - 140)
    finding = find("stuck_axis", viewed(field))
    assert (finding is not None) is found


def test_the_longest_stretch_is_told_and_all_are_spoiled() -> None:
    field = field_nt()
    field[100:130, 0], field[400:450, 2], field[700:730, 1] = 1.0, 2.0, 3.0
    finding = find("stuck_axis", viewed(field))
    assert finding is not None
    assert finding.spoiled is not None
    assert int(finding.spoiled.sum()) == 110
    assert float(finding.parameters["value_nt"].value) == 2.0
    assert finding.time_s == (200.0, 1458.0)


@pytest.mark.parametrize(("length", "found"), [(390, False), (410, True)])
def test_an_axis_in_coarse_steps_stays_for_longer(length: int, found: bool) -> None:
    """In steps of more than the noise it has to repeat 400 times."""
    field = field_nt()
    field[:, 0] = np.round(field[:, 0] / 4000.0) * 4000.0
    field[100 : 100 + length, 0] = 8000.0
    finding = find("stuck_axis", viewed(field))
    assert (finding is not None) is found


@pytest.mark.parametrize(("clipped", "found"), [(2, False), (4, True), (8, True)])
def test_an_end_that_comes_a_few_times_where_others_come_once_is_a_stop(clipped: int, found: bool) -> None:
    field = field_nt()
    order = np.argsort(field[:, 2])
    field[order[:clipped], 2] = field[order[0], 2] - 5.0
    finding = find("saturation", viewed(field))
    assert (finding is not None) is found
    if finding is not None:
        assert finding.spoiled is not None
        rows = np.sort(order[:clipped])
        assert np.flatnonzero(finding.spoiled).tolist() == rows.tolist()
        assert finding.parameters["axis"].value.tolist() == [0.0, 0.0, 1.0]
        assert finding.parameters["axis"].sigma.tolist() == [0.0, 0.0, 0.0]
        assert finding.parameters["limit_nt"].value.tolist() == [float(field[order[0], 2])]
        assert finding.parameters["limit_nt"].labels == (("z",),)
        assert float(finding.parameters["share_of_samples"].value) == clipped / len(field)
        assert finding.time_s == (TIME_S[rows[0]], TIME_S[rows[-1]])


@pytest.mark.parametrize(("beside", "found"), [(5, True), (6, False)])
def test_a_stop_comes_more_than_five_times_as_often_as_the_values_beside_it(beside: int, found: bool) -> None:
    """Thirty at the end, and five or six at a value next to it: a lattice has many at both."""
    field = field_nt()
    order = np.argsort(field[:, 0])[::-1]
    field[order[:29], 0] = 31_000.0
    field[order[29 : 29 + beside], 0] = 30_900.0
    assert (find("saturation", viewed(field)) is not None) is found


@pytest.mark.parametrize(("step_nt", "found"), [(4.9, False), (12.0, True)])
def test_a_lattice_counts_from_half_of_the_noise_on(step_nt: float, found: bool) -> None:
    field = 300.0 * np.random.default_rng(4).normal(size=(COUNT, 3))
    field[:, 1] = np.round(field[:, 1] / step_nt) * step_nt
    finding = find("quantisation", viewed(field, np.full(COUNT, 10.0)))
    assert (finding is not None) is found
    if finding is not None:
        own = step_nt / math.sqrt(12.0)
        assert float(finding.parameters["lsb_nt"].value) == pytest.approx(step_nt)
        assert finding.parameters["lsb_by_axis_nt"].value == pytest.approx([0.0, step_nt, 0.0])
        assert 0.0 < float(finding.parameters["lsb_nt"].sigma) < 1e-3 * step_nt  # whole nT over hundreds of steps
        assert float(finding.parameters["added_noise_nt"].value) == pytest.approx(own)
        assert finding.nats == pytest.approx(math.sqrt(COUNT) * own / NOISE_NT)
        assert finding.share == pytest.approx(own**2 / 100.0)


def test_a_lattice_that_the_recording_is_too_short_for_is_no_finding() -> None:
    """sqrt(n) times its own noise in sigmas has to be ten: 12 nT beside 10 need 834 samples."""
    for count, found in ((800, False), (870, True)):
        field = 300.0 * np.random.default_rng(4).normal(size=(count, 3))
        field[:, 1] = np.round(field[:, 1] / 12.0) * 12.0
        assert (find("quantisation", viewed(field)) is not None) is found


# The turn


def turned(phase: Array, wander_rad_s: float = 0.0, noise_rad: float = 1e-3, seed: int = 5) -> Turn:
    raw = phase + np.random.default_rng(seed).normal(0.0, noise_rad, COUNT)
    rate = float(np.polyfit(TIME_S, raw, 1)[0])
    across = np.full(COUNT, NOISE_NT / noise_rad)
    return Turn(np.array([0.0, 0.0, 1.0]), phase, raw, rate, across, wander_rad_s)


def spun(turn: Turn, nominal_rpm: float | None = None) -> Finding | None:
    nominal = None if nominal_rpm is None else nominal_rpm * RPM
    return find("spin_rate", viewed(field_nt(), alone=turn, nominal_rate_rad_s=nominal))


def test_a_rate_that_changes_is_told_at_the_start_with_its_change() -> None:
    change = -2e-6
    found = spun(turned(0.8 * TIME_S + 0.5 * change * TIME_S**2), 0.8 / RPM)
    assert found is not None
    rate, slope = found.parameters["rate_rpm"], found.parameters["rate_rpm_per_s"]
    assert float(rate.value) == pytest.approx(0.8 / RPM, abs=4.0 * float(rate.sigma))
    assert float(slope.value) == pytest.approx(change / RPM, abs=4.0 * float(slope.sigma))
    assert float(slope.sigma) < 0.01 * abs(change) / RPM
    assert float(found.parameters["nominal_rpm"].value) == pytest.approx(0.8 / RPM)
    assert found.share > 0.99
    assert found.nats > 1000.0


@pytest.mark.parametrize("time_constant_s", [900.0, 3000.0])
@pytest.mark.parametrize("stated", [0.8, 0.5])
def test_a_rate_that_dies_away_is_told_at_the_start(time_constant_s: float, stated: float) -> None:
    """As eddy currents take it, by one exponential: a parabola through the whole said -1.4 +- 3.4 rpm."""
    phase = 0.8 * time_constant_s * -np.expm1(-TIME_S / time_constant_s)
    found = spun(turned(phase), stated / RPM)
    assert found is not None
    for name, truth in (("rate_rpm", 0.8 / RPM), ("rate_rpm_per_s", -0.8 / time_constant_s / RPM)):
        value = found.parameters[name]
        assert float(value.value) == pytest.approx(truth, abs=3.0 * float(value.sigma)), name
        assert float(value.sigma) < 0.05 * abs(truth), name


def test_a_rate_that_falls_at_once_and_then_hardly_has_no_sure_rate() -> None:
    """No polynomial follows it: 0.56 +- 0.20 rpm were said of 2.9, by two that both miss the start."""
    phase = 0.05 * TIME_S + 0.25 * 60.0 * -np.expm1(-TIME_S / 60.0)
    found = spun(turned(phase), 0.2 / RPM)
    if found is not None:
        rate = found.parameters["rate_rpm"]
        assert float(rate.value) == pytest.approx(0.3 / RPM, abs=3.0 * float(rate.sigma))


@pytest.mark.parametrize(("bend_deg", "found"), [(2.8, False), (3.2, True)])
def test_a_bend_counts_from_three_degrees_on_and_beyond_what_the_direction_may_turn(
    bend_deg: float, found: bool
) -> None:
    """The bend is a quarter of what the change turns over the recording."""
    span = float(TIME_S[-1])
    curve = 4.0 * math.radians(bend_deg) / span**2
    assert (spun(turned(0.8 * TIME_S + curve * TIME_S**2)) is not None) is found
    wander = 4.0 * math.radians(10.0) / span
    assert spun(turned(0.8 * TIME_S + curve * TIME_S**2, wander)) is None
    large = 4.0 * math.radians(10.0 + bend_deg) / span**2
    assert (spun(turned(0.8 * TIME_S + large * TIME_S**2, wander)) is not None) is found


@pytest.mark.parametrize(("share", "found"), [(1.0009, False), (1.0011, True), (0.9989, True)])
def test_a_steady_rate_that_is_not_the_stated_one_is_told_from_a_thousandth_on(share: float, found: bool) -> None:
    """Stated with digits enough that a thousandth is more than half a unit of the last one."""
    finding = spun(turned(share * 7.5123 * RPM * TIME_S, noise_rad=1e-5), 7.5123)
    assert (finding is not None) is found
    if finding is not None:
        assert float(finding.parameters["rate_rpm"].value) == pytest.approx(share * 7.5123, rel=1e-5)
        assert (finding.share, finding.nats) == (1.0, 15.0)


def test_a_rate_whose_numbers_do_not_differ_by_what_they_may_be_off_is_none() -> None:
    """A phase that wanders by a cube: the mean rate is 0.3 % off, but at no time is it known to that."""
    share = TIME_S / TIME_S[-1]
    wandering = 0.8 * TIME_S + 0.02 * 0.8 * float(TIME_S[-1]) * (share - 0.5) ** 3
    turn = turned(wandering)
    assert abs(turn.rate_rad_s / 0.8 - 1.0) > 0.002
    assert spun(turn, 0.8 / RPM) is None
    steady = turned(turn.rate_rad_s * TIME_S)
    assert spun(steady, 0.8 / RPM) is not None


def test_a_turn_with_pauses_or_too_few_samples_says_nothing() -> None:
    bent = turned(0.8 * TIME_S + 1e-5 * TIME_S**2)
    seen = viewed(field_nt(), alone=bent)
    assert find("spin_rate", seen) is not None
    paused = replace(seen, scene=replace(seen.scene, time_s=TIME_S + 500.0 * (np.arange(COUNT) > 500)))
    assert find("spin_rate", paused) is None
    assert find("spin_rate", replace(seen, alone=None)) is None


# The noise


def test_noise_of_another_level_than_stated_is_told_from_three_per_cent_on() -> None:
    """And from six sigmas of what so many samples tell: 13 % of a thousand."""
    white = np.random.default_rng(6).normal(size=COUNT)
    white *= 1.0 / math.sqrt(float(np.mean(white**2)))
    unit = np.ones((COUNT, 3))
    for level, found in ((1.12, False), (1.15, True), (0.5, False)):
        seen = viewed(unit * np.array([30e3, 0.0, 0.0]), level * NOISE_NT * white, stated_noise_nt=NOISE_NT)
        finding = find("coloured_noise", seen)
        assert (finding is not None) is found
        if finding is not None:
            assert float(finding.parameters["level_nt"].value) == pytest.approx(level * NOISE_NT)
            assert float(finding.parameters["level_nt"].sigma) == pytest.approx(level * NOISE_NT / math.sqrt(2000.0))
            assert float(finding.parameters["correlation"].sigma) == pytest.approx(2.0 / math.sqrt(1000.0))
            assert float(finding.parameters["stated_nt"].value) == NOISE_NT
            assert (finding.nats, finding.share) == (15.0, 0.0)


def test_noise_with_a_memory_is_told_with_its_correlation_and_explains_no_mismatch() -> None:
    """What a memory of 0.6 foretells is 0.36 of the squares: that is its evidence, and no share of a mismatch."""
    white = np.random.default_rng(7).normal(0.0, NOISE_NT, COUNT)
    for row in range(1, COUNT):
        white[row] += 0.6 * white[row - 1]
    finding = find("coloured_noise", viewed(np.tile([30e3, 0.0, 0.0], (COUNT, 1)), white))
    assert finding is not None
    assert float(finding.parameters["correlation"].value) == pytest.approx(0.6, abs=0.07)
    assert 1.0 - math.exp(-2.0 * finding.nats / COUNT) == pytest.approx(0.36, abs=0.08)
    assert finding.share == 0.0
    assert "stated_nt" not in finding.parameters


@pytest.mark.parametrize("of_magnitudes", [False, True])
def test_a_memory_that_does_not_turn_with_the_body_is_the_references(of_magnitudes: bool) -> None:
    """Errors of a field model last for half a turn; a sensor's own noise points elsewhere as the body turns."""
    rng, kept = np.random.default_rng(31), 0.8
    noise = rng.normal(0.0, NOISE_NT, (COUNT, 3))
    for row in range(1, COUNT):
        noise[row] = kept * noise[row - 1] + math.sqrt(1.0 - kept**2) * noise[row]
    angle = np.linspace(0.0, 600.0, COUNT) + np.sin(np.arange(COUNT) / 90.0)
    field = 30e3 * np.stack([np.cos(angle), np.sin(angle), 0.2 * np.ones(COUNT)], axis=1)
    unit = field / np.linalg.norm(field, axis=1)[:, None]
    seen = noise[:, 0] if of_magnitudes else np.einsum("ni,ni->n", noise, unit)
    assert is_noise(viewed(field, seen + rng.normal(0.0, 0.3 * NOISE_NT, COUNT))) is not of_magnitudes


@pytest.mark.parametrize(
    ("period_s", "in_orbit", "level_nt", "is_said"),
    [(10.0, True, 20.0, False), (10.0, True, 90.0, True), (1.0, True, 20.0, True), (10.0, False, 20.0, True)],
)
@pytest.mark.parametrize("placed", [True, False])
def test_a_memory_that_a_field_models_errors_have_as_well_is_not_the_sensors(
    period_s: float, in_orbit: bool, level_nt: float, is_said: bool, placed: bool
) -> None:
    """In orbit, sampled so slowly that they fade within ten samples, and no larger than they are."""
    noise = np.random.default_rng(9071).normal(0.0, 0.8 * level_nt, COUNT)
    for row in range(1, COUNT):
        noise[row] += 0.6 * noise[row - 1]
    seen = viewed(np.tile([30e3, 0.0, 0.0], (COUNT, 1)), noise)
    place = np.tile([6878.0, 0.0, 0.0], (COUNT, 1)) if placed else None
    scene = replace(seen.scene, time_s=period_s * np.arange(COUNT), in_orbit=in_orbit, position_ecef_km=place)
    assert (find("coloured_noise", replace(seen, scene=scene)) is not None) is is_said
