"""What a scene works out of a recording, against the motion that it was made with and against numbers by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.joint.scene import under
from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import Places
from magcal_service.model import Array
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.motion import smooth_slope
from magcal_service.physics.scene.recent import Recent
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.physics.scene.view import runs
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, COUNT, PERIOD_S, RATE_RAD_S, scene, turning

NO_GYRO = {name: channel for name, channel in scene().channels.items() if name != "gyro"}


def small(time_s: Array, **changes: object) -> Scene:
    """A scene of a few samples that have nothing but their times and a field of 1, 2, 2 nT."""
    field = np.tile([1.0, 2.0, 2.0], (len(time_s), 1))
    return Scene(time_s, 10**18, True, field, field, field, np.full(len(time_s), 3.0), **changes)  # type: ignore[arg-type]


def with_attitude(phase: Array, time_s: Array) -> Scene:
    """A scene whose attitude alone is known: at angles ``phase`` about the axis."""
    return small(time_s, body_from_eci=turning(AXIS_BODY, AXIS_ECI, phase))


# The turn of the craft


def test_a_recorded_attitude_gives_the_rate_of_the_motion() -> None:
    """A steady turn is a steady vector along the axis, at every sample, to rounding."""
    rate = replace(scene(), channels={}).rate_body
    assert rate == pytest.approx(np.tile(RATE_RAD_S * AXIS_BODY, (COUNT, 1)), abs=1e-9)


def test_a_turn_the_other_way_has_the_opposite_rate() -> None:
    time_s = 2.0 * np.arange(50.0)
    rate = with_attitude(-0.05 * time_s, time_s).rate_body
    assert rate == pytest.approx(np.tile(-0.05 * AXIS_BODY, (50, 1)), abs=1e-9)


def test_a_rate_that_grows_is_that_of_the_middle_between_samples() -> None:
    time_s = 2.0 * np.arange(200.0)
    rate = with_attitude(0.02 * time_s + 0.5 * 1e-4 * time_s**2, time_s).rate_body
    expected = (0.02 + 1e-4 * time_s)[:, None] * AXIS_BODY
    assert rate is not None
    assert rate[1:-1] == pytest.approx(expected[1:-1], abs=1e-9)
    assert rate[[0, -1]] == pytest.approx(expected[[0, -1]] + np.outer([1e-4, -1e-4], AXIS_BODY), abs=1e-9)


def test_a_pause_is_bridged_and_not_taken_for_a_turn() -> None:
    """Over a gap the turn could be any number of times; the rate is taken from both sides of it."""
    time_s = np.concatenate([np.arange(30.0), 500.0 + np.arange(30.0)])
    rate = with_attitude(0.3 * time_s, time_s).rate_body
    assert rate == pytest.approx(np.tile(0.3 * AXIS_BODY, (60, 1)), abs=1e-9)


def test_samples_that_are_pauses_alone_have_no_rate() -> None:
    alone = with_attitude(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    alone.__dict__["pauses"] = np.array([0, 1])
    assert alone.rate_body == pytest.approx(np.zeros((2, 3)))


@pytest.mark.parametrize(("period_s", "known"), [(29.0, True), (30.0, False)])
def test_an_attitude_every_half_minute_tells_no_rate(period_s: float, known: bool) -> None:
    time_s = period_s * np.arange(20.0)
    assert (with_attitude(1e-3 * time_s, time_s).rate_body is not None) is known


def test_a_gyro_tells_the_rate_where_no_attitude_does() -> None:
    gyro = Telemetry("gyro", "angular rate", np.arange(12.0).reshape(4, 3))
    pair = Telemetry("pair", "angular rate", np.ones((4, 2)))
    at = small(np.arange(4.0), channels={"pair": pair, "gyro": gyro})
    assert at.rate_body == pytest.approx(gyro.values)
    assert replace(at, channels={"pair": pair}).rate_body is None


def test_a_turn_that_is_told_stands_in_for_attitude_and_gyro() -> None:
    time_s = np.arange(6.0)
    told = replace(with_attitude(0.3 * time_s, time_s), turning_rad_s=np.array([0.0, 0.1, 0.0]))
    assert told.rate_body == pytest.approx(np.tile([0.0, 0.1, 0.0], (6, 1)))


# Slopes


def test_the_field_turns_against_the_craft_and_changes_in_space() -> None:
    """dw/dt of the clean craft equals fine differences of the field itself, turned exactly between the samples."""
    slope = scene().field_slope
    assert scene().reference_eci_nt is not None
    early, late = (
        np.einsum(
            "nij,nj->ni",
            turning(AXIS_BODY, AXIS_ECI, RATE_RAD_S * (scene().time_s + step) + 0.3),
            scene().reference_eci_nt + step * scene().slope(scene().reference_eci_nt),
        )
        for step in (-1e-3, 1e-3)
    )
    exact = (late - early) / 2e-3
    assert np.abs(slope - exact)[1:-1].max() < 1e-4 * np.abs(exact).max()


def test_without_a_rate_the_slope_is_that_of_differences() -> None:
    bare = replace(scene(), channels=NO_GYRO, body_from_eci=None)
    assert np.array_equal(bare.field_slope, bare.slope(bare.calibrated_nt))


def test_with_a_gyro_and_a_magnitude_the_growth_goes_along_the_field() -> None:
    of = replace(scene(), body_from_eci=None)
    grown = scene().unit * scene().magnitude_slope[:, None]
    expected = -np.cross(RATE_RAD_S * AXIS_BODY, scene().calibrated_nt) + grown
    assert of.field_slope == pytest.approx(expected, abs=1e-9)


def test_along_a_steady_axis_the_slope_is_that_of_the_field_along_it() -> None:
    """With the turn about the axis told, the part along it comes from the field's own course, to 2 nT/s in 60."""
    of = replace(scene(), body_from_eci=None, channels={}, turning_rad_s=RATE_RAD_S * AXIS_BODY)
    slow = (of.field_slope @ AXIS_BODY)[100:-100]
    exact = (scene().field_slope @ AXIS_BODY)[100:-100]
    assert float(np.abs(exact).max()) > 20.0
    assert float(np.abs(slow - exact).max()) < 2.0
    given = replace(of, given={})
    plain = -np.cross(RATE_RAD_S * AXIS_BODY, of.calibrated_nt) + of.unit * of.magnitude_slope[:, None]
    assert given.field_slope == pytest.approx(plain, abs=1e-9)


def test_a_smoothed_slope_of_a_line_is_its_slope_at_every_sample() -> None:
    """Also at the ends and across a gap; a stretch of fewer than four samples has none."""
    time_s = np.concatenate([np.arange(40.0), 400.0 + np.arange(4.0), 800.0 + np.arange(3.0)])
    of = small(time_s)
    slope = smooth_slope(7.0 - 0.5 * time_s, 10.0, time_s, of.pauses, of.period_s)
    assert slope == pytest.approx(np.concatenate([np.full(44, -0.5), np.zeros(3)]))


def test_a_smoothed_slope_takes_means_of_half_a_width_on_both_sides() -> None:
    values = np.zeros(41)
    values[25] = 1.0
    of = small(np.arange(41.0))
    slope = smooth_slope(values, 10.0, of.time_s, of.pauses, of.period_s)
    rises = np.zeros(41)
    rises[21:26] = 1.0 / 25.0  # the five samples from each row on, against the five before it, five seconds apart
    rises[26:31] = -1.0 / 25.0
    assert slope[6:35] == pytest.approx(rises[6:35])


def test_slopes_are_central_within_each_stretch_and_none_for_one_sample() -> None:
    time_s = np.concatenate([np.arange(5.0), [100.0, 101.0], [150.0], 200.0 + np.arange(7.0)])
    of = small(time_s)
    assert of.pauses.tolist() == [0, 5, 7, 8]
    values = time_s**2
    expected = [1.0, 2.0, 4.0, 6.0, 7.0, 201.0, 201.0, 0.0, 401.0, *np.arange(402.0, 411.0, 2.0), 411.0]
    assert of.slope(values) == pytest.approx(expected)


# Time


@pytest.mark.parametrize(("gap_s", "pauses"), [(10.0, [0]), (10.5, [0, 6])])
def test_more_than_ten_periods_are_a_pause(gap_s: float, pauses: list[int]) -> None:
    time_s = np.concatenate([np.arange(6.0), 5.0 + gap_s + np.arange(6.0)])
    assert small(time_s).pauses.tolist() == pauses


@pytest.mark.parametrize("times", [[0.0, 0.1], [0.0, 0.1, 0.2]])
def test_the_reference_changes_between_samples_that_come_in_pairs_or_threes_too(times: list[float]) -> None:
    """Its slope was 0 throughout, so that a clock that was off could not be found, and a place was named for it."""
    time_s = np.concatenate([4.0 * k + np.array(times) for k in range(20)])
    of = small(np.concatenate([time_s, 500.0 + time_s]))
    assert len(of.pauses) == 40
    of = replace(of, magnitude_nt=3e4 + 5.0 * of.time_s**2)
    inner = [*range(1, len(time_s) - 1), *range(len(time_s) + 1, len(of) - 1)]
    assert of.magnitude_slope[inner] == pytest.approx(10.0 * of.time_s[inner])


def test_the_period_is_the_usual_one() -> None:
    assert small(np.array([0.0, 2.0, 4.0, 60.0, 62.0])).period_s == 2.0
    assert small(np.array([0.0])).period_s == 1.0


def test_source_times_are_whole_nanoseconds_from_the_origin() -> None:
    assert small(np.array([0.0, 1.5, 2.0000000014])).time_ns.tolist() == [
        10**18,
        10**18 + 1_500_000_000,
        10**18 + 2_000_000_001,
    ]


def test_knots_are_ten_seconds_apart_and_around_each_gap() -> None:
    time_s = np.concatenate([4.0 * np.arange(6.0), 4.0 * np.arange(25, 30)])
    assert small(time_s).knots.tolist() == [0, 3, 5, 6, 9, 10]
    sparse = 25.0 * np.arange(4.0)
    assert small(sparse).knots.tolist() == [0, 1, 2, 3]
    values = np.array([0.0, 12.0, 20.0, 100.0, 110.0, 116.0])
    between = small(time_s).from_knots(values)
    assert between == pytest.approx(np.interp(time_s, time_s[[0, 3, 5, 6, 9, 10]], values))


def test_stretches_of_a_flag_have_first_and_last_plus_one() -> None:
    flag = np.array([True, False, False, True, True, False, True])
    assert runs(flag) == [(0, 1), (3, 5), (6, 7)]
    assert runs(np.zeros(3, dtype=bool)) == []


# Constants of a model, and memory


def test_a_models_constants_hold_in_place_of_the_scenes_own() -> None:
    own = small(np.arange(3.0))
    given = replace(own, given={"zero": 5.0, "column_0": 4.0, "column_1": 2.0, "column_5": 9.0})
    assert (own.is_given, given.is_given) == (False, True)
    assert (own.constant("zero", 1.0), given.constant("zero", 1.0), given.constant("other", 1.0)) == (1.0, 5.0, 1.0)
    assert own.chosen("column", [7, 8]) == [7, 8]
    assert given.chosen("column", [7, 8]) == [4, 2]


def test_an_effect_with_a_past_goes_on_from_the_row_that_the_next_scene_begins_at() -> None:
    memory = Memory(1)
    of = small(np.arange(3.0), memory=memory)
    assert of.begin("state", -1.0) == -1.0
    states = np.array([10.0, 20.0, 30.0])
    of.keep("state", states)
    states[:] = 0.0
    assert of.begin("state", -1.0) == 20.0
    small(np.arange(3.0)).keep("state", states)
    assert Memory().next_row == -1


def test_channels_of_several_kinds_come_in_their_order() -> None:
    at = small(np.arange(2.0), channels={n: Telemetry(n, n[0], np.zeros((2, 1))) for n in ("b1", "a1", "c1", "b2")})
    assert [channel.name for channel in at.of_quantity("b", "a")] == ["b1", "a1", "b2"]


# The Sun, and the reference


def test_places_light_and_the_dipole_need_utc() -> None:
    clock = replace(scene(), utc=False)
    assert clock.position_eci_km is None
    assert clock.sun_eci is None
    assert clock.lit is None
    assert clock.sun_body is None
    assert clock.dipole_eci is None
    assert not clock.has_model
    assert not clock.eclipses


def test_the_dipoles_axis_points_to_the_geomagnetic_north_pole() -> None:
    """80.8 N 72.8 W, turned with the Earth."""
    assert scene().dipole_eci is not None
    fixed = geomagnetic.ecef_from_eci(scene().time_ns, scene().dipole_eci)
    latitude = np.degrees(np.arcsin(fixed[:, 2]))
    longitude = np.degrees(np.arctan2(fixed[:, 1], fixed[:, 0]))
    assert latitude == pytest.approx(np.full(COUNT, 80.8), abs=1e-6)
    assert longitude == pytest.approx(np.full(COUNT, -72.8), abs=1e-6)


@pytest.mark.parametrize(
    ("share", "followed"), [(0.0, False), (0.019, False), (0.03, True), (0.97, True), (0.985, False)]
)
def test_light_has_to_change_for_anything_to_follow_it(share: float, followed: bool) -> None:
    of = replace(scene())
    of.__dict__["lit"] = (np.arange(COUNT) < share * COUNT).astype(float)
    assert of.eclipses is followed
    given = replace(scene(), given={})
    given.__dict__["lit"] = of.lit
    assert given.eclipses


def test_light_counts_from_its_mean_unless_a_model_says_otherwise() -> None:
    assert scene().lit is not None
    assert scene().mean_light == pytest.approx(float(np.mean(scene().lit)))
    assert replace(scene(), given={"mean_light": 0.25}).mean_light == 0.25


def test_warmth_follows_light_through_a_skin() -> None:
    """Euler's method at a hundredth of the period gives the same answer, to a thousandth of the swing."""
    of = replace(scene())
    assert of.lit is not None
    fine = np.arange(0.0, 2000.0, PERIOD_S / 100.0)
    drive = np.interp(fine, of.time_s, of.lit - float(of.lit.mean()))
    skin, warm = 0.0, 0.0
    found = np.zeros(len(fine))
    for row, light in enumerate(drive[:-1]):
        skin += (light - skin) * PERIOD_S / 100.0 / 300.0
        warm += (skin - warm) * PERIOD_S / 100.0 / 900.0
        found[row + 1] = warm
    answer, decay = of.warmed(900.0, 300.0)
    assert answer[:500] == pytest.approx(found[::100], abs=2e-3)
    assert decay == pytest.approx(np.exp(-of.time_s / 900.0))
    bare, _ = of.warmed(900.0, 0.0)
    assert float(np.abs(bare - answer).max()) > 0.05
    assert of.warmed(900.0, 300.0)[0] is answer


def test_the_model_knows_the_field_where_time_and_place_are_known() -> None:
    assert scene().has_model
    assert scene().position_ecef_km is not None
    rows = scene().knots
    places = scene().position_ecef_km[rows]
    expected = np.linalg.norm(geomagnetic.igrf_ecef_nt(scene().time_ns[rows], places), axis=1)
    assert scene().model_magnitude() == pytest.approx(expected)
    assert scene().model_magnitude(Places(places)) == pytest.approx(expected)
    short = np.linalg.norm(geomagnetic.igrf_ecef_nt(scene().time_ns[rows], places, 8), axis=1)
    assert scene().model_magnitude(degree=8) == pytest.approx(short)
    assert not replace(scene(), position_ecef_km=None).has_model
    assert not replace(scene(), origin_ns=8 * 10**18).has_model


def test_results_asked_for_last_are_kept_and_older_ones_made_again() -> None:
    made: list[int] = []
    recent = Recent[int, int](2)

    def ask(key: int) -> int:
        return recent.once(key, lambda: made.append(key) or 10 * key)

    assert [ask(key) for key in (1, 2, 1, 3, 1, 2)] == [10, 20, 10, 30, 10, 20]
    assert made == [1, 2, 3, 2]
    assert len(recent) == 2


def test_a_scene_without_places_has_none_under_a_models_constants_either() -> None:
    """What does not depend on the constants is worked out before, and is nothing where nothing is known."""
    blind = replace(scene(), position_ecef_km=None, channels={})
    given = under(blind, {"lag_s": 2.0}, Recent(4))
    assert (given.position_ecef_km, given.lit, given.given) == (None, None, {"lag_s": 2.0})
    assert not given.has_model
