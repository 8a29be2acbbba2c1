"""What has no name is fitted as a curve over what is there on another day, and kept only where held-out blocks gain."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.empirical.curves import ELAPSED, drivers_of
from magcal_service.diagnosis.empirical.modelled import Modelled, modelled
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import Kind
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.diagnosis.made_up import FLOOR_NT, TIME_S, along, flown, searching
from tests.physics.scenes import COUNT, NOISE_NT, X

WARM = 15.0 + 8.0 * np.sin(TIME_S / 900.0) + 1.5 * np.sin(TIME_S / 311.0)
"""A temperature that rises and falls, and no cycle is like another."""


def peak(warm: Array) -> Array:
    """What follows it: nothing but around 15 degC."""
    return np.asarray(np.exp(-0.5 * ((warm - 15.0) / 2.5) ** 2))


def recorded(scene: Scene, **channels: Array) -> Scene:
    made = {name: Telemetry(name, "temperature", values.reshape(COUNT, -1)) for name, values in channels.items()}
    return replace(scene, channels=made)


def found(scene: Scene) -> Modelled | None:
    search, fit = searching(scene)
    return modelled(search, fit, FLOOR_NT, with_sun=False)


def test_a_bias_that_peaks_at_a_temperature_is_followed() -> None:
    """By its channel, to the noise, and with the numbers that it has."""
    field = along(0, 500.0 * peak(WARM)) + along(2, -300.0 * peak(WARM))
    result = found(recorded(flown(field), board=WARM))
    assert result is not None
    curve = result.curves[0]
    assert (curve.driver, curve.kind, curve.quantity, curve.column) == ("channel:board", Kind.BIAS, "temperature", 0)
    assert result.is_usable
    before_nt, after_nt = result.held_out_rms_nt
    assert before_nt > 1.25 * NOISE_NT
    assert after_nt < 1.06 * NOISE_NT
    assert result.standard_errors > 5.0
    assert result.seen > 0.7 * result.blocks
    assert result.forward_nt is not None
    assert result.forward_nt[1] < result.forward_nt[0]
    assert curve.span[0] == pytest.approx(np.quantile(WARM, 0.005))
    assert curve.span[1] == pytest.approx(np.quantile(WARM, 0.995))
    x = WARM[curve.covers(WARM)]
    for axis, size in ((0, 500.0), (1, 0.0), (2, -300.0)):
        off = curve.at(x)[:, axis] - size * (peak(x) - peak(WARM).mean())
        assert np.sqrt(np.mean(off**2)) < 30.0
        assert np.abs(off).max() < 0.2 * 500.0  # straight between knots, where the peak is sharpest
        knots = curve.knots[1:-1]
        missed = curve.values[1:-1, axis] - size * (peak(knots) - peak(WARM).mean())
        assert (np.abs(missed) < 4.0 * curve.sigma[1:-1, axis] + 30.0).all()
    assert np.abs(result.fit.x[:3] - X[:3] - field.mean(axis=0)).max() < 60.0  # the mean is the bias's


def test_a_growth_of_the_magnitude_and_a_gain_are_told_by_their_kind() -> None:
    grown = recorded(flown(np.zeros((COUNT, 3)), 300.0 * peak(WARM)), board=WARM)
    result = found(grown)
    assert result is not None
    assert (result.curves[0].driver, result.curves[0].kind) == ("channel:board", Kind.MAGNITUDE)
    assert result.curves[0].values.shape == result.curves[0].knots.shape
    clean = flown(np.zeros((COUNT, 3)))
    stretched = flown(-0.02 * peak(WARM)[:, None] * clean.field_nt * [1.0, -0.5, 0.7])
    result = found(recorded(stretched, board=WARM))
    assert result is not None
    assert result.curves[0].kind is Kind.GAIN
    assert np.ptp(result.curves[0].values, axis=0) == pytest.approx([0.02, 0.01, 0.014], rel=0.35)
    assert result.held_out_rms_nt[1] < 1.08 * NOISE_NT


def test_noise_has_no_curve() -> None:
    assert found(recorded(flown(np.zeros((COUNT, 3))), board=WARM)) is None


def test_a_channel_that_has_nothing_to_do_with_it_is_not_given() -> None:
    """A course over time that no driver follows is told for this recording only, whatever decoys there are."""
    rng = np.random.default_rng(5)
    course = np.repeat(rng.normal(0.0, 300.0, 12), -(-COUNT // 12))[:COUNT]
    decoys = {f"decoy{k}": 20.0 + 5.0 * np.sin(TIME_S / (517.0 + 97.0 * k) + k) for k in range(4)}
    scene = replace(recorded(flown(along(1, course)), **decoys), position_ecef_km=None)
    result = found(scene)
    assert result is not None
    assert [curve.driver for curve in result.curves] == [ELAPSED]
    assert not result.is_usable
    assert result.held_out_rms_nt[1] < result.held_out_rms_nt[0]


def test_a_clock_is_no_driver() -> None:
    """A channel that only rises cannot be told from elapsed time, so its curve is of no use on another day."""
    rising = 10.0 + 1e-3 * TIME_S + 0.2 * np.sin(TIME_S / 40.0)
    scene = replace(recorded(flown(along(0, 400.0 * peak(TIME_S / 400.0))), uptime=rising), position_ecef_km=None)
    result = found(scene)
    assert result is not None
    assert [curve.driver for curve in result.curves] == [ELAPSED]


def test_a_second_driver_gets_a_curve_of_its_own() -> None:
    load = np.abs(np.sin(TIME_S / 173.0) + 0.3 * np.sin(TIME_S / 57.0))
    field = along(0, 500.0 * peak(WARM)) + along(1, 600.0 * (load - 0.6) ** 2)
    result = found(recorded(flown(field), board=WARM, load=load))
    assert result is not None
    assert {curve.driver for curve in result.curves} == {"channel:board", "channel:load"}
    assert result.held_out_rms_nt[1] < 1.06 * NOISE_NT


def test_a_short_recording_has_no_curve() -> None:
    from tests.physics.given_scene import cut

    field = along(0, 2000.0 * peak(WARM))
    assert found(cut(recorded(flown(field), board=WARM), 0, 299)) is None


def test_the_json_has_all_that_is_needed_to_use_it() -> None:
    result = found(recorded(flown(along(0, 500.0 * peak(WARM))), board=WARM))
    assert result is not None
    content = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert content["usable_elsewhere"] is True
    assert content["interpolating_only"] is True
    assert content["outside"] == "not applied (driver_outside)"
    assert content["held_out_rms_nt"] == {"before": result.before.held_out_rms_nt, "after": result.fit.held_out_rms_nt}
    curve = content["curves"][0]
    assert (curve["driver"], curve["driver_unit"], curve["kind"], curve["unit"]) == (
        "channel:board",
        "degC",
        "bias",
        "nT",
    )
    assert curve["form"] == f"piecewise linear, {len(curve['knots'])} knots"
    assert np.array(curve["values"]).shape == np.array(curve["sigma"]).shape == (len(curve["knots"]), 3)
    assert curve["range"] == [curve["knots"][0], curve["knots"][-1]]
    assert content["D"] != np.zeros((3, 3)).tolist()


def test_a_driver_with_values_never_seen_before_foretells_nothing() -> None:
    """A temperature that in the last third is another one altogether has no curve for another day."""
    late = TIME_S[-1] * 0.64 <= TIME_S
    moved = WARM + 40.0 * late
    result = found(replace(recorded(flown(along(0, 500.0 * peak(WARM))), board=moved), position_ecef_km=None))
    assert result is None or all(curve.driver != "channel:board" for curve in result.curves)


def test_off_orbit_a_place_within_a_field_is_no_driver() -> None:
    """A quadrotor's latitude follows its currents as well as anything; so does a field that hardly changes."""
    still = replace(flown(np.zeros((COUNT, 3))), in_orbit=False)
    assert {name for name, _, _ in drivers_of(still, with_sun=True)} == {
        "computed:field_size",
        *(f"computed:field_{axes}" for axes in ("x", "y", "z", "xy", "xz", "yz")),
    }
    tiny = replace(still, magnitude_nt=40_000.0 + 190.0 * np.sin(TIME_S / 700.0))
    assert "computed:field_size" not in {name for name, _, _ in drivers_of(tiny, with_sun=True)}
