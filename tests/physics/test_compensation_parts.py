"""What a compensation holds of channels, places and references, and up to where it believes its model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.earth import geomagnetic
from magcal_service.model import Array, d_matrix
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.live_drivers import positions_km
from magcal_service.physics.apply.live_reference import shifts_s
from magcal_service.physics.apply.model_file import ModelSpin, ModelTerm
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Vector,
)
from tests.physics.live_models import HOT_X, THERMAL, model_of
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, turning

START_NS = 1_742_472_000 * 10**9
SECOND_NS = 10**9


def common(time_s: float, **changes: object) -> dict[str, object]:
    made = {"craft": "hot", "source": "test", "sequence": 0, "time_ns": START_NS + round(time_s * SECOND_NS)}
    return made | changes


def compensation(*terms: ModelTerm) -> Compensation:
    return Compensation(model_of(*terms, origin_ns=START_NS))


def heat(time_s: float, *values: float, channel: str = "temperature", unit: str = "degC") -> TelemetrySample:
    return TelemetrySample(**common(time_s), channel=channel, unit=unit, values=values)  # type: ignore[arg-type]


def sample(time_s: float, field_nt: Vector = (20e3, -3e3, 40e3)) -> MagnetometerSample:
    return MagnetometerSample(**common(time_s), field_body_nt=field_nt)  # type: ignore[arg-type]


def place(time_s: float, km: Vector, frame: Frame = Frame.ECEF, clock: Clock = Clock.UTC) -> PositionSample:
    return PositionSample(**common(time_s, clock=clock), position_km=km, frame=frame)  # type: ignore[arg-type]


# Channels


def test_a_channel_is_held_in_its_base_unit_with_its_pace() -> None:
    of = compensation()
    of.telemetry(heat(1.0, 250.0, unit="mA", channel="bus"))
    held = of._channels["bus"]
    assert (held.quantity, held.values, held.pace_s) == ("current", (pytest.approx(0.25),), 120.0)
    of.telemetry(heat(3.5, 500.0, unit="mA", channel="bus"))
    held = of._channels["bus"]
    assert (held.time_ns, held.pace_s, held.values) == (
        START_NS + 3_500_000_000,
        pytest.approx(2.5),
        (pytest.approx(0.5),),
    )
    of.telemetry(heat(4.0, 1.0, unit="furlong", channel="bus"))
    assert of._channels["bus"] is held


@pytest.mark.parametrize(
    ("time_s", "taken"), [(200.0, False), (199.0, False), (80.1, False), (80.0, True), (10.0, True)]
)
def test_a_late_value_is_dropped_unless_the_clock_was_set_back(time_s: float, taken: bool) -> None:
    """By two minutes and more; the pace then begins anew."""
    of = compensation()
    of.telemetry(heat(190.0, 1.0))
    of.telemetry(heat(200.0, 2.0))
    of.telemetry(heat(time_s, 3.0))
    held = of._channels["temperature"]
    assert (held.values, held.pace_s) == (((3.0,), 120.0) if taken else ((2.0,), 10.0))


def test_invented_channels_take_bounded_memory_and_known_ones_go_on() -> None:
    of = compensation()
    for number in range(70):
        of.telemetry(heat(1.0, 5.0, channel=f"c{number}"))
    assert list(of._channels) == [f"c{number}" for number in range(64)]
    of.telemetry(heat(2.0, 6.0, channel="c63"))
    assert of._channels["c63"].values == (6.0,)


# One recorded driver


def warmed(time_s: float, *values: float, unit: str = "degC", at_s: float = 0.0) -> Compensation:
    of = compensation(THERMAL[0])
    of.telemetry(heat(at_s, *values, unit=unit))
    of.correct(sample(time_s))
    return of


def test_a_bias_is_subtracted_through_the_sensors_own_errors() -> None:
    """At 30 degC against 20: (I + D)^-1 of ten kelvin's bias."""
    of = compensation(THERMAL[0])
    of.telemetry(heat(0.0, 30.0))
    corrected = of.correct(sample(1.0)).field_body_nt
    off = np.linalg.solve(np.eye(3) + d_matrix(HOT_X), 10.0 * np.array([8.0, -6.0, 12.0]))
    assert np.array([20e3, -3e3, 40e3]) - corrected == pytest.approx(off)
    assert of.missing == ()


@pytest.mark.parametrize(
    ("age_s", "missing"), [(119.9, ()), (120.1, ("thermal_bias",)), (-119.9, ()), (-120.1, ("thermal_bias",))]
)
def test_a_first_value_holds_for_two_minutes(age_s: float, missing: tuple[str, ...]) -> None:
    assert warmed(200.0 + age_s, 30.0, at_s=200.0).missing == missing


def test_a_channel_of_another_kind_or_width_is_no_driver() -> None:
    assert warmed(1.0, 30.0, unit="A").missing == ("thermal_bias",)
    second = replace(THERMAL[0], variant="column 2", constants={"zero_degc": 20.0, "column": 1.0})
    of = compensation(second)
    of.telemetry(heat(0.0, 30.0))
    assert of.correct(sample(1.0)) == sample(1.0)
    assert of.missing == ("thermal_bias",)
    of.telemetry(heat(1.0, 30.0, 40.0))
    of.correct(sample(2.0))
    assert of.missing == ()


@pytest.mark.parametrize(("share", "missing"), [(0.99, ()), (1.01, ("thermal_bias",))])
def test_what_no_sensor_could_read_is_not_subtracted(share: float, missing: tuple[str, ...]) -> None:
    """Each component of what is left may be a millitesla at most."""
    measured = np.array([20e3, -3e3, 40e3])
    for axis in range(3):
        off = np.zeros(3)
        off[axis] = measured[axis] - share * 1e6
        amplitudes = (np.eye(3) + d_matrix(HOT_X)) @ off / 10.0
        of = compensation(replace(THERMAL[0], amplitudes={"nt_per_k": amplitudes}))
        of.telemetry(heat(0.0, 30.0))
        corrected = of.correct(sample(1.0)).field_body_nt
        assert of.missing == missing, axis
        assert corrected[axis] == pytest.approx(measured[axis] if missing else share * 1e6)


# Places


def test_a_place_is_carried_on_along_the_line_through_the_last_two() -> None:
    of = compensation()
    assert positions_km(of._places, [START_NS]) is None
    of.position(place(0.0, (7000.0, 0.0, 0.0)))
    assert positions_km(of._places, [START_NS + 5 * SECOND_NS]) == pytest.approx(np.array([[7000.0, 0.0, 0.0]]))
    of.position(place(10.0, (7000.0, 70.0, -20.0)))
    of.position(place(20.0, (7000.0, 140.0, -50.0)))
    found = positions_km(of._places, [START_NS + 20 * SECOND_NS, START_NS + 30 * SECOND_NS])
    assert found == pytest.approx(np.array([[7000.0, 140.0, -50.0], [7000.0, 210.0, -80.0]]))
    of.position(place(20.0, (1.0, 1.0, 1.0)))
    of.position(place(15.0, (1.0, 1.0, 1.0)))
    assert of._places[-1].ecef_km == (7000.0, 140.0, -50.0)


@pytest.mark.parametrize(("age_s", "known"), [(119.9, True), (120.1, False), (-119.9, True), (-120.1, False)])
def test_a_place_is_known_for_two_minutes(age_s: float, known: bool) -> None:
    of = compensation()
    of.position(place(500.0, (7000.0, 0.0, 0.0)))
    times = [START_NS + 500 * SECOND_NS, START_NS + round((500.0 + age_s) * SECOND_NS)]
    assert (positions_km(of._places, times) is not None) is known


@pytest.mark.parametrize(("gap_s", "held"), [(120.0, 2), (120.1, 1), (-120.1, 1), (-119.0, 1)])
def test_after_two_minutes_a_track_begins_anew(gap_s: float, held: int) -> None:
    of = compensation()
    of.position(place(500.0, (7000.0, 0.0, 0.0)))
    of.position(place(500.0 + gap_s, (7000.0, 100.0, 0.0)))
    assert len(of._places) == held
    late = gap_s == -119.0
    assert of._places[-1].ecef_km == ((7000.0, 0.0, 0.0) if late else (7000.0, 100.0, 0.0))


def test_a_place_in_space_is_turned_with_the_earth_where_the_time_is_utc() -> None:
    of = compensation()
    of.position(place(3.0, (7000.0, 1.0, 2.0), Frame.ECI))
    turned = geomagnetic.ecef_from_eci(np.array([START_NS + 3 * SECOND_NS]), np.array([[7000.0, 1.0, 2.0]]))
    assert of._places[-1].ecef_km == pytest.approx(turned[0])
    elapsed = compensation()
    elapsed.position(place(3.0, (7000.0, 1.0, 2.0), Frame.ECI, Clock.ELAPSED))
    assert elapsed._places == []
    elapsed.position(place(3.0, (7000.0, 1.0, 2.0), clock=Clock.ELAPSED))
    assert len(elapsed._places) == 1


# References


RING = ModelTerm("external_field", "none", "uniform", {"mean_nt": np.array(-100.0)})
"""A ring current of -100 nT along the dipole's axis."""


def reference(time_s: float, field_nt: Vector) -> ReferenceSample:
    return ReferenceSample(**common(time_s), field_nt=field_nt, frame=Frame.ECI)  # type: ignore[arg-type]


def dipole_axis() -> Array:
    """Towards geomagnetic north (3,), ECI."""
    latitude, longitude = np.radians([80.8, -72.8])
    axis = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    return np.asarray(geomagnetic.eci_from_ecef(np.array([START_NS]), np.array([axis]))[0])


def test_a_growth_is_worked_out_once_a_second_and_goes_along_the_field() -> None:
    """Without a place: the dipole's axis against the field; within the second it is held."""
    pole = dipole_axis()
    of = compensation(RING)
    x, y, z = (40e3 * pole).tolist()
    grown = of.reference(reference(0.0, (x, y, z))).field_nt
    assert np.array(grown) == pytest.approx(39_900.0 * pole, abs=0.01)
    u, v, w = np.cross(pole, [1.0, 0.0, 0.0]).tolist()
    across = (30e3 * u, 30e3 * v, 30e3 * w)
    held = of.reference(reference(0.9, across)).field_nt
    length = float(np.linalg.norm(across))
    assert float(np.linalg.norm(held)) == pytest.approx(length - 100.0, abs=0.01)
    anew = of.reference(reference(1.0, across)).field_nt
    assert float(np.linalg.norm(anew)) == pytest.approx(length, abs=0.05)


@pytest.mark.parametrize(
    ("growth_nt", "missing"), [(-0.49, ()), (-0.51, ("external_field",)), (0.51, ("external_field",))]
)
def test_a_reference_may_be_wrong_by_a_half(growth_nt: float, missing: tuple[str, ...]) -> None:
    of = compensation(replace(RING, amplitudes={"mean_nt": np.array(growth_nt * 40e3)}))
    x, y, z = (40e3 * dipole_axis()).tolist()
    grown = of.reference(reference(0.0, (x, y, z)))
    assert of.missing == missing
    size = 40e3 * (1.0 + (0.0 if missing else growth_nt))
    assert float(np.linalg.norm(grown.field_nt)) == pytest.approx(size, rel=1e-5)


def test_shifts_of_time_add_their_drift_and_have_a_largest() -> None:
    def late(**amplitudes: float) -> ModelTerm:
        return ModelTerm("time_offset", "none", "", {name: np.array(value) for name, value in amplitudes.items()})

    terms = [late(offset_s=2.0), late(offset_s=-1.0, drift_ppm=500.0), late(offset_s=3601.0), late(drift_ppm=1.0)]
    found, unfit = shifts_s(terms, 4000.0)
    assert found == pytest.approx([2.0, 1.0])
    assert unfit == ["time_offset", "time_offset"]
    assert shifts_s([late(offset_s=-3600.0)], 0.0) == ([-3600.0], [])
    assert compensation(late(offset_s=2.0), late(offset_s=1.5)).wait_s == 3.5
    assert compensation(late(offset_s=-2.0)).wait_s == 0.0


def test_without_terms_nothing_changes() -> None:
    of = compensation()
    assert of.correct(sample(1.0)) == sample(1.0)
    given = ReferenceSample(**common(1.0), magnitude_nt=45e3)  # type: ignore[arg-type]
    assert of.reference(given) == given
    assert (of.missing, of.wait_s) == ((), 0.0)


# Attitude


@pytest.mark.parametrize(("later_s", "known_from"), [(0.0, 0), (86_400.0, 9)])
def test_the_models_axis_in_space_holds_where_its_recording_began_and_that_of_the_stream_later(
    later_s: float, known_from: int
) -> None:
    """A day later the axis has moved by 61 deg: nothing is said before the tenth sample, and then it is the new one."""
    axis = AXIS_ECI if later_s == 0.0 else np.array([0.0, 0.0, 1.0])
    spin = ModelSpin(tuple(AXIS_BODY.tolist()), tuple(AXIS_ECI.tolist()), 0.2)
    of = Compensation(model_of(RING, origin_ns=START_NS, spin=spin))
    of._begun_ns = START_NS + round(later_s * SECOND_NS)
    for k in range(20):
        time_s = later_s + 60.0 * k
        field = 3e4 * np.array([np.cos(0.3 * k), np.sin(0.3 * k), np.sin(0.7 * k)])
        truth = turning(AXIS_BODY, axis, np.array([0.2 * time_s]))
        x, y, z = field.tolist()
        of.reference(reference(time_s, (x, y, z)))
        found = of._attitude(truth @ field, START_NS + round(time_s * SECOND_NS))
        assert (found is not None) is (k >= known_from)
        if found is not None:
            assert found == pytest.approx(truth, abs=1e-6)
