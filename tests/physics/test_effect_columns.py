"""What each effect adds to the field or to the reference, worked out here from its equation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import has_its_sign
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.drivers.change import instants
from magcal_service.physics.drivers.temperature import direct_by_temperature
from magcal_service.physics.effects.external_field import ring_current
from magcal_service.physics.effects.hysteresis import play
from magcal_service.physics.effects.position_offset import gradients
from magcal_service.physics.effects.reference_epoch import truncated_change, yearly_change
from magcal_service.physics.effects.sun_disturbance import harmonics
from magcal_service.physics.effects.torquer import remembered
from magcal_service.physics.interface import Hypothesis, value_of
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.scenes import COUNT, PERIOD_S, scene

TIME_S, SPAN_S = scene().time_s, float(scene().time_s[-1])
FIELD, UNIT = scene().clean_field_nt, scene().unit

PRIORS = {
    "axis_skew": (1.0, 1000.0),
    "bias_drift": (5.0, 5000.0),
    "bias_step": (10.0, 5000.0),
    "coloured_noise": (1.0, 2000.0),
    "cubic_response": (5.0, 3000.0),
    "current_loop": (1.0, 30_000.0),
    "external_field": (5.0, 500.0),
    "hysteresis": (10.0, 2000.0),
    "nutation": (10.0, 20000.0),
    "position_offset": (10.0, 30000.0),
    "quantisation": (1.0, 500.0),
    "reference_epoch": (5.0, 3000.0),
    "response_lag": (5.0, 30000.0),
    "saturation": (10.0, 30000.0),
    "scale_drift": (5.0, 5000.0),
    "scale_step": (10.0, 5000.0),
    "spin_rate": (10.0, 50000.0),
    "stuck_axis": (100.0, 100000.0),
    "sun_disturbance": (1.0, 300.0),
    "thermal_bias": (5.0, 5000.0),
    "thermal_scale": (5.0, 5000.0),
    "time_offset": (10.0, 30000.0),
    "tone": (1.0, 1000.0),
    "torquer": (10.0, 50000.0),
}
"""Usual sizes [nT] from the sources that each entry names; what is larger is believed of no recording."""


def test_every_effect_has_the_size_of_its_source() -> None:
    assert {effect.name: effect.prior for effect in catalogue()} == PRIORS


def forms(name: str, of: Scene | None = None) -> dict[tuple[str, str], Hypothesis]:
    """The forms of an effect by driver and variant."""
    return {(form.driver, form.variant): form for form in effect_named(name).hypotheses(of or scene())}


def added(form: Hypothesis, amplitudes: object, *theta: float) -> Array:
    """The body field (n, 3) of amplitudes, given in the shape of the results."""
    return form.columns(np.array(theta)).field(np.asarray(amplitudes, dtype=float).reshape(-1))


def grown(form: Hypothesis, amplitudes: object, *theta: float) -> Array:
    """The growth of the magnitude (n,)."""
    return np.asarray(form.columns(np.array(theta)).growth(np.asarray(amplitudes, dtype=float).reshape(-1)))


def sizes(form: Hypothesis) -> dict[str, tuple[int, ...]]:
    return {block.name: block.shape for block in form.blocks}


# Errors that take a course


def test_a_bias_drifts_by_its_rate_and_bends_by_its_curve() -> None:
    found = forms("bias_drift")
    rate, curve = np.array([1e-3, -2e-3, 3e-3]), np.array([1e-7, 0.0, -2e-7])
    variants = ["", "quadratic", "relaxing", "over a while", "relaxing from an instant"]
    assert list(found) == [("none", variant) for variant in variants]
    assert added(found["none", ""], rate) == pytest.approx(np.outer(TIME_S, rate))
    both = np.outer(TIME_S, rate) + np.outer(TIME_S**2, curve)
    assert added(found["none", "quadratic"], [rate, curve]) == pytest.approx(both)
    end = np.array([100.0, -50.0, 20.0])
    relaxed = np.outer(1.0 - np.exp(-TIME_S / 900.0), end)
    assert added(found["none", "relaxing"], end, 900.0) == pytest.approx(relaxed)
    between = np.outer(np.interp(TIME_S, [400.0, 1600.0], [0.0, 1.0]), end)
    assert added(found["none", "over a while"], end, 400.0, 1600.0) == pytest.approx(between)
    later = np.outer(np.where(TIME_S > 400.0, 1.0 - np.exp((400.0 - TIME_S) / 900.0), 0.0), end)
    assert added(found["none", "relaxing from an instant"], end, 400.0, 900.0) == pytest.approx(later)
    names = [[(block.name, block.unit) for block in form.blocks] for form in found.values()]
    plain = [[("nt_per_s", "nT/s")], [("nt_per_s", "nT/s"), ("nt_per_s2", "nT/s2")]]
    assert names == [*plain, [("nt_end", "nT")], [("nt_between", "nT")], [("nt_end", "nT")]]
    assert found["none", "relaxing"].nonlinear[0].grid == pytest.approx(
        SPAN_S * np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8])
    )


def test_before_the_origin_of_time_nothing_has_relaxed() -> None:
    early = replace(scene(), time_s=TIME_S - 100.0)
    field = added(forms("bias_drift", early)["none", "relaxing"], [1.0, 0.0, 0.0], 500.0)
    assert not field[: int(100.0 / PERIOD_S)].any()


def test_a_gain_drifts_against_the_reading() -> None:
    found = forms("scale_drift")
    rate = np.array([1e-7, -2e-7, 3e-7])
    assert added(found["none", ""], rate) == pytest.approx(-TIME_S[:, None] * rate * FIELD)
    assert [block.name for block in found["none", "relaxing"].blocks] == ["end"]
    assert [block.name for block in found["none", "quadratic"].blocks] == ["per_s", "per_s2"]


def test_a_step_is_there_from_its_instant_on() -> None:
    late = (TIME_S >= 4000.0).astype(float)[:, None]
    step = np.array([100.0, -40.0, 10.0])
    assert added(forms("bias_step")["none", ""], step, 4000.0) == pytest.approx(late * step)
    gain = np.array([0.01, -0.02, 0.03])
    found = forms("scale_step")
    assert added(found["none", ""], gain, 4000.0) == pytest.approx(-late * gain * FIELD)
    assert added(found["none", "one gain"], 0.01, 4000.0) == pytest.approx(-late * 0.01 * FIELD)


def test_instants_are_even_in_samples_and_at_the_end_of_every_pause() -> None:
    even = instants(scene())
    rows = np.linspace(0, COUNT - 1, 98)[1:-1].astype(int)
    assert even.grid == pytest.approx(TIME_S[rows] - 0.5 * PERIOD_S)
    assert even.role == "instant"
    paused = replace(scene(), time_s=TIME_S + 900.0 * (np.arange(COUNT) >= 1207))
    extra = sorted(set(instants(paused).grid.tolist()) - set((paused.time_s[rows] + paused.time_s[rows - 1]) / 2.0))
    assert extra == pytest.approx([paused.time_s[1207] - 0.5 * PERIOD_S])


# The sensor's answer


def test_the_cubic_answer_has_own_cross_and_common_terms() -> None:
    found = forms("cubic_response")
    own, cross = np.array([1e-9, -2e-9, 3e-9]), np.arange(1.0, 7.0).reshape(3, 2) * 1e-9
    assert added(found["none", ""], own) == pytest.approx(own * FIELD**3)
    expected = own * FIELD**3
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        for number, other in enumerate(others):
            expected[:, axis] += cross[axis, number] * FIELD[:, axis] * FIELD[:, other] ** 2
    flat = np.concatenate([own, cross.reshape(-1)])
    assert added(found["none", "with cross terms of each axis"], flat) == pytest.approx(expected)
    pairs = np.array([4e-9, -5e-9, 6e-9])
    expected = own * FIELD**3
    for pair, (one, other) in zip(pairs, ((0, 1), (0, 2), (1, 2)), strict=True):
        expected[:, one] += pair * FIELD[:, one] * FIELD[:, other] ** 2
        expected[:, other] += pair * FIELD[:, other] * FIELD[:, one] ** 2
    assert added(found["none", "with cross terms"], np.concatenate([own, pairs])) == pytest.approx(expected)
    size = (FIELD**2).sum(axis=1)[:, None]
    assert added(found["none", "by the field's size"], 1e-9) == pytest.approx(1e-9 * FIELD * size)


def test_a_magnitude_shows_every_number_of_the_cross_terms() -> None:
    """Of six it shows three sums; their differences took what heat did, and vectors were off by 770 nT, trusted."""
    forms_of = {h.variant: h for h in effect_named("cubic_response").hypotheses(scene())}
    least = {}
    for variant, form in forms_of.items():
        along = form.columns(np.zeros(0)).along(scene().unit)
        values = np.linalg.svd(along / np.linalg.norm(along, axis=0), compute_uv=False)
        least[form.needs_vectors, variant] = float(values[-1] / values[0])
    for (needs_vectors, variant), share in least.items():
        assert (share < 0.03) is needs_vectors, (variant, share)


def test_a_soft_knee_bends_an_axis_beyond_it() -> None:
    """What is missing grows as the square from the knee on, against the reading, and is whole at the end of range."""
    for axis, name in enumerate("xyz"):
        form = forms("saturation")["none", f"soft knee of {name}"]
        largest = float(np.percentile(np.abs(FIELD[:, axis]), 99.9))
        assert form.constants == {"axis": float(axis), "full_scale_nt": largest}
        expected = np.zeros((COUNT, 3))
        beyond = np.maximum(np.abs(FIELD[:, axis]) - 0.8 * largest, 0.0) / (0.2 * largest)
        expected[:, axis] = -np.sign(FIELD[:, axis]) * 50.0 * beyond**2
        assert added(form, 50.0, 0.8) == pytest.approx(expected)
        assert form.odds == 1.0
        assert form.nonlinear[0].grid == pytest.approx(np.linspace(0.5, 0.97, 12))


def test_permeable_parts_lag_behind_the_field() -> None:
    """The play of each axis less the field, its width a share of the largest; rods put it on every axis."""
    w = scene().calibrated_nt
    scale = float(np.percentile(np.abs(w), 99))
    state, followed = np.zeros(3), np.zeros_like(w)
    for row, value in enumerate(w):
        state = np.clip(state, value - 0.3 * scale, value + 0.3 * scale)
        followed[row] = state
    found = forms("hysteresis")
    share = np.array([0.01, 0.02, -0.03])
    assert added(found["none", ""], share, 0.3) == pytest.approx(share * (followed - w))
    matrix = np.arange(9.0).reshape(3, 3) * 1e-3
    assert added(found["none", "rods along the axes"], matrix, 0.3) == pytest.approx((followed - w) @ matrix)
    assert found["none", ""].constants == {"scale_nt": scale}
    assert found["none", ""].nonlinear[0].grid.tolist() == [0.05, 0.15, 0.3, 0.5, 0.8]


def test_a_play_begins_where_it_was_left() -> None:
    values = np.array([[0.0, 0.0], [5.0, -5.0], [4.0, -4.0]])
    assert play(values, 2.0, np.array([1.5, -3.0])).tolist() == [[1.5, -2.0], [3.0, -3.0], [3.0, -3.0]]


def test_axes_that_are_digitised_later_see_a_later_field() -> None:
    slope = scene().field_slope
    expected = np.stack([np.zeros(COUNT), 0.01 * slope[:, 1], -0.02 * slope[:, 2]], axis=1)
    assert added(forms("axis_skew")["none", ""], [0.01, -0.02]) == pytest.approx(expected)
    derived = effect_named("axis_skew").derived({"after_x_s": value_of([0.01, 0.02], [1e-3, 2e-3], "s")})
    assert derived["delay_s"].value.tolist() == [0.0, 0.01, 0.02]
    assert derived["delay_s"].sigma.tolist() == [0.0, 1e-3, 2e-3]


def test_a_late_answer_is_short_by_the_square_of_its_delay() -> None:
    """tau^2 |dB/dt across|^2 / (2 |B|), against the field; the time constant and its sigma follow from tau^2."""
    slope = scene().field_slope
    across = slope - np.einsum("ni,ni->n", slope, UNIT)[:, None] * UNIT
    loss = (across**2).sum(axis=1) / (2.0 * np.linalg.norm(scene().calibrated_nt, axis=1))
    assert added(forms("response_lag")["none", ""], 0.04, 0.0) == pytest.approx(-0.04 * loss[:, None] * UNIT)
    derived = effect_named("response_lag").derived({"tau2_s2": value_of(0.04, 0.004, "s2")})
    assert (float(derived["tau_s"].value), float(derived["tau_s"].sigma)) == pytest.approx((0.2, 0.01))
    assert effect_named("response_lag").derived({"tau2_s2": value_of(-0.04, 0.004, "s2")}) == {}
    unturned = forms("response_lag", replace(scene(), channels={}, body_from_eci=None))
    names = [variant for (_, variant), form in unturned.items() if not form.needs_vectors]
    assert names == ["by the steps", "by the steps, from its start", "average of samples"]  # test_physics_lag.py


# Drivers that were recorded


def test_a_bias_and_a_gain_follow_a_recorded_temperature_from_its_mean() -> None:
    channel = scene().channels["temperature"].values[:, 0]
    zero = round(float(channel.mean()), 1)
    warmth = (channel - zero)[:, None]
    bias, gain = forms("thermal_bias"), forms("thermal_scale")
    by = "channel:temperature"
    k = np.array([5.0, -2.0, 1.0])
    assert bias[by, ""].constants == {"zero_degc": zero, "column": 0.0}
    assert added(bias[by, ""], k) == pytest.approx(warmth * k)
    assert added(gain[by, ""], 1e-4 * k) == pytest.approx(-1e-4 * warmth * k * FIELD)
    assert added(gain[by, "one gain"], 1e-4) == pytest.approx(-1e-4 * warmth * FIELD)


def two_boards(swing_k: float) -> Scene:
    values = np.stack([20.0 + swing_k * np.sign(np.sin(TIME_S)), 5.0 + np.sin(TIME_S / 900.0)], axis=1)
    return replace(scene(), channels={"boards": Telemetry("boards", "temperature", values)})


@pytest.mark.parametrize(("swing_k", "columns"), [(0.04, ["column 2"]), (0.06, ["column 1", "column 2"])])
def test_a_temperature_that_stands_still_drives_nothing(swing_k: float, columns: list[str]) -> None:
    found = forms("thermal_bias", two_boards(swing_k))
    assert [variant for driver, variant in found if driver == "channel:boards"] == columns
    assert found["channel:boards", "column 2"].constants["column"] == 1.0
    given = replace(two_boards(swing_k), given={"zero_degc": 3.0})
    form = forms("thermal_bias", given)["channel:boards", "column 1"]
    warmth = given.channels["boards"].values[:, 0] - 3.0
    assert added(form, [1.0, 0.0, 0.0])[:, 0] == pytest.approx(warmth)


def test_a_temperature_that_is_inferred_has_odds_against_it_where_one_was_recorded() -> None:
    """It answers to light behind a skin; what it began with decays by itself."""
    found = forms("thermal_bias")["inferred:temperature", "answer to light"]
    bare = forms("thermal_bias", replace(scene(), channels={}))["inferred:temperature", "answer to light"]
    assert (found.odds, bare.odds) == (5.0, 0.0)
    assert sizes(found) == {"nt_swing": (3,), "start_nt_swing": (3,)}
    answer, decay = scene().warmed(900.0, 300.0)
    swing, start = np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0])
    expected = np.outer(answer, swing) + np.outer(decay, start)
    assert added(found, [swing, start], 900.0, 300.0) == pytest.approx(expected)
    assert found.constants == {"mean_light": scene().mean_light}
    grids = [number.grid for number in found.nonlinear]
    assert grids[0] == pytest.approx(np.geomspace(120.0, 14400.0, 9))
    assert grids[1].tolist() == [0.0, 300.0, 900.0, 2400.0]


@pytest.mark.parametrize("effect", ["thermal_bias", "thermal_scale"])
def test_what_settles_may_be_a_sensor_that_warms_up(effect: str) -> None:
    """Beside a thermometer elsewhere, and without light; the curve of a drift that relaxes, but for its constant."""
    bare = replace(scene(), channels={})
    dawn = replace(bare, position_ecef_km=None)
    assert dawn.lit is None
    for one in (scene(), bare, dawn):
        name = next(v for d, v in forms(effect, one) if d == "inferred:temperature" and v.endswith("settling"))
        found = forms(effect, one)["inferred:temperature", name]
        assert [number.name for number in found.nonlinear] == ["time_constant_s"]
    start = np.array([10.0, 20.0, 30.0])
    settling = forms("thermal_bias", bare)["inferred:temperature", "settling"]
    decay = np.exp(-bare.time_s / 900.0)
    assert sizes(settling) == {"start_nt_swing": (3,)}
    assert added(settling, start, 900.0) == pytest.approx(np.outer(decay, start))
    early = replace(bare, time_s=bare.time_s - 1000.0)
    expected = np.where(early.time_s < -60.0, 0.0, np.exp(-np.maximum(early.time_s, 0.0) / 900.0))
    assert early.settling(900.0) == pytest.approx(expected)  # what was warm at its start says nothing of before
    relaxing = forms("bias_drift", bare)["none", "relaxing"]
    assert added(relaxing, -start, 900.0) + start == pytest.approx(np.outer(decay, start))


def test_currents_add_their_field_by_circuit() -> None:
    found = forms("current_loop")
    panels, battery = scene().channels["current"].values, scene().channels["battery"].values
    k = np.arange(1.0, 7.0).reshape(2, 3)
    assert added(found["channel:current", ""], k) == pytest.approx(panels @ k)
    assert found["channel:current", ""].constants == {"column_0": 0.0, "column_1": 1.0}
    assert added(found["channel:current", "circuit 2"], k[1]) == pytest.approx(panels[:, [1]] * k[1])
    assert found["channel:current", "circuit 2"].constants == {"column_0": 1.0}
    assert added(found["channel:battery", ""], k[0]) == pytest.approx(battery * k[0])
    assert ("channel:battery", "circuit 1") not in found
    together = found["channel:current+battery", "all circuits"]
    m = np.arange(9.0).reshape(3, 3)
    assert added(together, m) == pytest.approx(np.concatenate([panels, battery], axis=1) @ m)
    assert together.constants == {"column_0": 0.0, "column_1": 1.0, "column_2": 2.0}


def test_a_circuit_that_stands_still_is_left_out() -> None:
    """Swings below a thousandth of the largest are rounding."""
    ripple = np.sign(np.sin(TIME_S / 50.0))
    values = np.stack([1.0 + 5e-4 * ripple, 1.0 + 2e-3 * ripple, np.full(COUNT, 2.0)], axis=1)
    still = replace(scene(), channels={"bus": Telemetry("bus", "current", values)})
    form = forms("current_loop", still)["channel:bus", ""]
    assert form.constants == {"column_0": 1.0}
    assert sizes(form) == {"nt_per_a": (3,)}


def test_a_recorded_current_is_bounded_by_its_amperes_and_a_guessed_one_by_its_field() -> None:
    """5000 nT/A are a single wire 4 cm away; an array that nobody recorded stays below 2000 nT."""
    current = 7.0 + np.sin(TIME_S / 300.0)
    drone = replace(scene(), channels={"battery": Telemetry("battery", "current", current[:, None])})
    found = forms("current_loop", drone)
    assert found["channel:battery", ""].largest_nt == 30_000.0
    assert [block.most for block in found["channel:battery", ""].blocks] == [5000.0]
    small = replace(scene(), channels={"bus": Telemetry("bus", "current", 0.01 * current[:, None])})
    assert forms("current_loop", small)["channel:bus", ""].largest_nt == pytest.approx(
        5000.0 * float(np.sqrt(np.mean((0.01 * current) ** 2)))
    )
    assert {form.largest_nt for (driver, _), form in found.items() if driver.startswith("inf")} == {2000.0}


def test_what_has_no_unit_may_go_along_with_a_current() -> None:
    """Readings, states, duties and loads, each by itself; a Sun sensor and what is declared something else do not."""
    steps = np.sign(np.sin(TIME_S / 300.0))[:, None]
    kinds = ("counts", "dimensionless", "fraction", "power")
    others = ("temperature", "voltage", "angular rate", "field", "length")
    channels = {kind: Telemetry(kind, kind, steps) for kind in (*kinds, *others)}
    channels["two"] = Telemetry("two", "counts", np.concatenate([steps, 0.0 * steps, TIME_S[:, None]], axis=1))
    channels["sun"] = Telemetry("sun", "counts", np.repeat(steps, 3, axis=1))
    found = forms("current_loop", replace(scene(), channels=channels))
    recorded = {key for key in found if key[0].startswith("channel")}
    wanted = {(f"channel:{kind}", variant) for kind in kinds for variant in ("", "lagging", "recorded late")}
    of_two = {("channel:two", f"column {number}{late}") for number in (1, 3) for late in ("", ", recorded late")}
    assert recorded == wanted | of_two
    k = np.array([10.0, -20.0, 5.0])
    assert added(found["channel:two", "column 3"], k) == pytest.approx(np.outer(TIME_S, k))
    assert found["channel:two", "column 3"].constants == {"column_0": 2.0}
    given = replace(scene(), channels=channels, given={"column_0": 2.0})
    assert added(forms("current_loop", given)["channel:two", "column 3"], k) == pytest.approx(np.outer(TIME_S, k))


def test_a_current_that_was_recorded_late_has_the_values_of_rows_to_come() -> None:
    """All circuits of a channel and each by itself: a mean over the time it is held, straight between rows, at the end
    as the last row has it; and in a stream, where none has come yet, as the row has it."""
    two = Telemetry("two", "current", np.stack([np.sin(TIME_S / 300.0), np.cos(TIME_S / 170.0)], axis=1))
    late_s, held_s = 10.0, 20.0  # two rows and a half; five rows
    k = np.array([10.0, -20.0, 5.0])
    found = forms("current_loop", replace(scene(), channels={"two": two}))
    late = {variant for _, variant in found if "late" in variant and "lit" not in variant}
    assert late == {"recorded late", "circuit 1, recorded late", "circuit 2, recorded late"}
    ahead = np.mean([np.interp(TIME_S + by, TIME_S, two.values[:, 1]) for by in np.linspace(10.02, 29.98, 500)], axis=0)
    form = found["channel:two", "circuit 2, recorded late"]
    assert form.columns(np.array([late_s, held_s])).field(k) == pytest.approx(np.outer(ahead, k), abs=1e-3)
    at_once = np.interp(TIME_S + late_s, TIME_S, two.values[:, 1])
    assert form.columns(np.array([late_s, 0.0])).field(k) == pytest.approx(np.outer(at_once, k))
    both = found["channel:two", "recorded late"].columns(np.array([late_s, held_s]))
    assert both.field(np.concatenate([0.0 * k, k])) == pytest.approx(np.outer(ahead, k), abs=1e-3)
    streamed = forms("current_loop", replace(scene(), channels={"two": two}, memory=Memory()))
    as_it_is = streamed["channel:two", "circuit 2, recorded late"].columns(np.array([late_s, held_s])).field(k)
    assert as_it_is == pytest.approx(np.outer(two.values[:, 1], k))


def followed_by_hand(drive: Array, tau_s: float) -> Array:
    """dy/dt = (drive - y) / tau in a hundred small steps from one sample to the next."""
    value, found = float(drive[0]), [float(drive[0])]
    for first, last, step_s in zip(drive[:-1], drive[1:], np.diff(TIME_S), strict=True):
        for into in (np.arange(100) + 0.5) / 100.0:
            value += (first + (last - first) * into - value) * step_s / 100.0 / tau_s
        found.append(value)
    return np.array(found)


def test_panels_that_were_not_recorded_follow_the_sun() -> None:
    """Light alone, each face by the cosine of the Sun on it, pairs, the sum, and every face for itself."""
    assert scene().sun_body is not None
    assert scene().lit is not None
    sun, lit = scene().sun_body, scene().lit[:, None]
    faces = np.concatenate([np.maximum(sun, 0.0), np.maximum(-sun, 0.0)], axis=1) * lit
    found = {variant: form for (driver, variant), form in forms("current_loop").items() if driver.startswith("inf")}
    k = np.array([1.0, 2.0, 3.0])
    assert added(found["lit or not"], k) == pytest.approx(lit * k)
    late = found["lit or not, late"]
    assert late.refines == found["lit or not"].label
    tau_s, light = 30.0, lit[:, 0]
    assert added(late, k, tau_s) == pytest.approx(np.outer(followed_by_hand(light, tau_s), k), abs=0.02 * k.max())
    lit_faces = [index for index in range(6) if np.std(faces[:, index]) > 0.02]
    names = ("+x", "+y", "+z", "-x", "-y", "-z")
    assert {name for name in found if name.startswith("panel ")} == {f"panel {names[index]}" for index in lit_faces}
    for index in lit_faces:
        assert added(found[f"panel {names[index]}"], k) == pytest.approx(faces[:, [index]] * k)
    m = np.arange(6.0).reshape(2, 3)
    for index, name in enumerate("xyz"):
        assert (f"panels +-{name}" in found) is ({index, index + 3} <= set(lit_faces))
        if f"panels +-{name}" in found:
            assert added(found[f"panels +-{name}"], m) == pytest.approx(faces[:, [index, index + 3]] @ m)
    used = faces[:, lit_faces]
    assert added(found["sum of all panels"], k) == pytest.approx(used.sum(axis=1, keepdims=True) * k)
    every = np.arange(3.0 * len(lit_faces)).reshape(-1, 3)
    assert added(found["every panel its own circuit"], every) == pytest.approx(used @ every)
    constants = {f"face_{index}": float(face) for index, face in enumerate(lit_faces)}
    assert found["sum of all panels"].constants == found["every panel its own circuit"].constants == constants


def test_a_command_that_is_given_after_its_row_acts_from_there_on() -> None:
    """As a row's command is of the time before it, where the log has what was commanded when the sample was taken."""
    found = forms("torquer")
    before, after = (found["channel:torquer", form] for form in ("", "commands after their rows"))
    m = np.arange(float(before.size))
    for decay_s in (0.0, 1.0):
        held, late = (form.columns(np.array([decay_s])).field(m) for form in (before, after))
        assert late[1:] == pytest.approx(held[:-1])
        assert late[0] == pytest.approx(held[0])
        assert not np.allclose(late, held)


def test_an_array_gives_no_more_than_is_taken_of_it() -> None:
    """All panels, and those on the sides of two axes, each sum cut at a share of full sun on one panel."""
    assert scene().sun_body is not None
    assert scene().lit is not None
    faces = np.maximum(np.concatenate([scene().sun_body, -scene().sun_body], axis=1), 0.0) * scene().lit[:, None]
    found = forms("current_loop")
    for name, used in (("all panels", [0, 1, 3, 4, 5]), ("panels across x and y", [0, 1, 3, 4])):
        total = faces[:, used].sum(axis=1)
        form = found["inferred:array_current", f"sum of {name}, limited"]
        assert form.refines == f"current_loop[sum of {name}] by inferred:array_current"
        for limit in (0.5, 1.1):
            field = form.columns(np.array([limit])).field(np.array([1.0, 0.0, -2.0]))
            assert field == pytest.approx(np.minimum(total, limit)[:, None] * [1.0, 0.0, -2.0])
            assert np.mean(total > limit) > 0.1


def test_a_model_has_the_panels_that_it_names() -> None:
    given = replace(scene(), given={"face_0": 5.0, "face_1": 0.0, "face_2": 4.0})
    found = forms("current_loop", given)["inferred:array_current", "every panel its own circuit"]
    assert scene().sun_body is not None
    assert scene().lit is not None
    faces = np.maximum(np.concatenate([scene().sun_body, -scene().sun_body], axis=1), 0.0) * scene().lit[:, None]
    every = np.arange(9.0).reshape(3, 3)
    assert added(found, every) == pytest.approx(faces[:, [5, 0, 4]] @ every)


def test_the_suns_disturbance_has_harmonics_of_its_direction() -> None:
    """On the sphere the five are orthogonal to one another and to the direction, and of the sizes of their formulas."""
    x, y, z = 0.36, 0.48, 0.8
    expected = [x * y, x * z, y * z, x * x - y * y, 2.0 * z * z - x * x - y * y]
    assert harmonics(np.array([[x, y, z]]))[0] == pytest.approx(expected)
    assert scene().sun_body is not None
    assert scene().lit is not None
    found = forms("sun_disturbance")
    inferred = scene().sun_body * scene().lit[:, None]
    for driver, sun in (("channel:sun", scene().channels["sun"].values), ("inferred:sun_direction", inferred)):
        m, second, light = np.arange(9.0).reshape(3, 3), np.arange(15.0).reshape(5, 3), np.array([1.0, 2.0, 3.0])
        linear = sun @ m
        assert added(found[driver, ""], m) == pytest.approx(linear)
        both = linear + harmonics(sun) @ second
        flat = np.concatenate([m, second])
        assert added(found[driver, "second degree"], flat) == pytest.approx(both)
        whole = both + np.linalg.norm(sun, axis=1)[:, None] * light
        flat = np.concatenate([flat, [light]])
        assert added(found[driver, "second degree and light"], flat) == pytest.approx(whole)


@pytest.mark.parametrize(
    ("name", "quantity", "width", "taken"),
    [
        ("sun", "dimensionless", 3, True),
        ("Photo_cells", "counts", 3, True),
        ("css", "irradiance", 3, True),
        ("sun", "temperature", 3, False),
        ("sun", "counts", 2, False),
        ("moon", "counts", 3, False),
    ],
)
def test_a_channel_is_a_sun_sensor_by_its_name_kind_and_width(
    name: str, quantity: str, width: int, taken: bool
) -> None:
    """Counts are brought to a full Sun of 1: the 99th percentile of their length."""
    values = 800.0 * np.abs(np.sin(TIME_S / 300.0))[:, None] * np.ones(width)
    of = replace(scene(), channels={name: Telemetry(name, quantity, values)})
    found = forms("sun_disturbance", of)
    assert ((f"channel:{name}", "") in found) is taken
    if taken:
        full = float(np.percentile(np.linalg.norm(values, axis=1), 99)) if quantity == "counts" else 1.0
        assert found[f"channel:{name}", ""].constants == {"full_sun": full}
        field = added(found[f"channel:{name}", ""], np.eye(3))
        assert field == pytest.approx(values / full)


def test_torquers_add_their_field_with_decay_and_remanence() -> None:
    moment = scene().channels["torquer"].values
    found = forms("torquer")
    m = np.arange(9.0).reshape(3, 3)
    plain = found["channel:torquer", ""]
    assert added(plain, m, 0.0) == pytest.approx(moment @ m)
    decayed = np.array(moment)
    for row in range(1, COUNT):
        decayed[row] += (decayed[row - 1] - moment[row]) * math.exp(-PERIOD_S / 3.0)
    assert added(plain, m, 3.0) == pytest.approx(decayed @ m)
    largest = float(np.abs(moment).max())
    signs, last = np.zeros_like(moment), np.zeros(3)
    for row, value in enumerate(moment):
        last = np.where(np.abs(value) > 0.02 * largest, np.sign(value), last)
        signs[row] = last
    form = found["channel:torquer", "with remanence"]
    both = np.concatenate([m, 10.0 * m])
    assert added(form, both, 0.0) == pytest.approx(moment @ m + signs @ (10.0 * m))
    assert form.constants == {"column_0": 0.0, "column_1": 1.0, "column_2": 2.0, "largest_am2": largest}
    assert plain.nonlinear[0].grid.tolist() == [0.0, 0.1, 0.3, 1.0, 3.0]
    derived = effect_named("torquer").derived({"nt_per_am2": value_of(m, m + 1.0, "nT/(A m2)")})
    assert derived["nt_per_am2"].value.tolist() == m.T.tolist()
    assert derived["nt_per_am2"].sigma.tolist() == (m.T + 1.0).tolist()
    assert effect_named("torquer").derived({}) == {}


def test_a_coil_that_is_never_used_is_left_out_and_a_core_begins_where_it_was_left() -> None:
    values = np.stack([np.sign(np.sin(TIME_S / 71.0)), np.zeros(COUNT)], axis=1)
    of = replace(scene(), channels={"coils": Telemetry("coils", "magnetic moment", values)})
    assert forms("torquer", of)["channel:coils", ""].constants == {"column_0": 0.0}
    memory = Memory(-1, {"sign": np.array([-1.0, 1.0])})
    begun = replace(scene(), memory=memory)
    commands = np.array([[0.0, 0.0], [0.021, -0.019], [0.0, 1.0]])
    assert remembered(begun, commands, 1.0).tolist() == [[-1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]
    assert memory.states["sign"].tolist() == [1.0, 1.0]


def test_a_regular_duty_is_on_for_its_share_from_its_phase_on() -> None:
    form = forms("torquer")["inferred:duty", "regular duty"]
    field = added(form, [10.0, 20.0, 30.0], 100.0, 0.3, 0.25)
    on = np.mod(TIME_S - 25.0, 100.0) < 30.0
    assert field == pytest.approx(on[:, None] * np.array([10.0, 20.0, 30.0]))
    assert [number.role for number in form.nonlinear] == ["period", "held", "held"]
    assert form.nonlinear[1].grid == pytest.approx(np.arange(1, 13) / 24.0)
    assert form.nonlinear[2].grid == pytest.approx(np.arange(24) / 24.0)


def test_a_tone_has_a_size_over_all_its_amplitudes() -> None:
    form = forms("tone")["none", ""]
    p, q = np.array([3.0, 0.0, 4.0]), np.array([0.0, 12.0, 0.0])
    angle = 2.0 * np.pi * 0.02 * TIME_S
    expected = np.outer(np.cos(angle), p) + np.outer(np.sin(angle), q)
    assert added(form, [p, q], 0.02) == pytest.approx(expected)
    sigma = np.array([1.0, 2.0, 3.0])
    derived = effect_named("tone").derived({"cosine_nt": value_of(p, sigma, "nT"), "sine_nt": value_of(q, sigma, "nT")})
    spread = math.sqrt(3.0**2 + 12.0**2 + 24.0**2) / 13.0
    found = derived["amplitude_nt"]
    assert (float(found.value), float(found.sigma)) == pytest.approx((13.0, spread))


@pytest.mark.parametrize(("count", "offered"), [(63, False), (64, True)])
def test_a_tone_needs_64_samples_to_be_looked_for(count: int, offered: bool) -> None:
    field = np.ones((count, 3))
    short = Scene(np.arange(float(count)), 0, True, field, field, field, field[:, 0])
    assert bool(effect_named("tone").hypotheses(short)) is offered
    assert effect_named("tone").hypotheses(replace(short, given={}))


# A wrong reference


def test_a_late_clock_sees_the_field_of_another_time() -> None:
    slope = scene().magnitude_slope
    found = forms("time_offset")
    assert grown(found["none", ""], 2.0) == pytest.approx(2.0 * slope)
    assert grown(found["none", "with drift"], [2.0, 50.0]) == pytest.approx(slope * (2.0 + 50e-6 * TIME_S))
    still = replace(scene(), magnitude_nt=np.full(COUNT, 45e3), position_ecef_km=None)
    assert all(form.needs_vectors for form in forms("time_offset", still).values())
    ahead, behind = (found["none", f"{way} the attitude"] for way in ("ahead of", "behind"))
    assert added(ahead, [0.02]) == pytest.approx(0.02 * scene().field_slope)
    assert added(behind, [0.02]) == pytest.approx(-0.02 * scene().field_slope)
    turn = np.linalg.norm(scene().field_slope) / np.linalg.norm(scene().calibrated_nt)
    assert ahead.blocks[0].most == pytest.approx(min(120.0, 0.5 / turn))
    moved, bend = replace(scene(), moved_s=np.full(COUNT, 0.1)), scene().slope(scene().field_slope)
    found_nt = added(forms("time_offset", moved)["none", "ahead of the attitude"], [0.1])
    second_nt = found_nt - 0.1 * scene().field_slope
    assert (
        np.linalg.norm(second_nt - 0.005 * bend, axis=1)[5:-5].max() < 0.2 * np.linalg.norm(0.005 * bend, axis=1).max()
    )


def magnitude(places_ecef_km: Array, times_ns: Array, degree: int = 13) -> Array:
    return np.asarray(np.linalg.norm(geomagnetic.igrf_ecef_nt(times_ns, places_ecef_km, degree), axis=1))


def test_a_wrong_place_sees_the_gradient_of_the_field() -> None:
    """Steps of 1 km outwards, along the motion in space, and to the left of it, to a hundredth of the largest."""
    assert scene().position_ecef_km is not None
    rows = scene().knots[5:-5:40]
    times_ns, here = scene().time_ns[rows], scene().position_ecef_km[rows]
    inertial = scene().position_eci_km
    assert inertial is not None
    motion = (inertial[rows + 1] - inertial[rows - 1]) / np.linalg.norm(
        inertial[rows + 1] - inertial[rows - 1], axis=1
    )[:, None]
    up = inertial[rows] / np.linalg.norm(inertial[rows], axis=1)[:, None]
    steps = {"radial": up, "along": motion, "cross": np.cross(up, motion)}
    found = gradients(scene())
    for name, step in steps.items():
        there = geomagnetic.ecef_from_eci(times_ns, inertial[rows] + step)
        growth = magnitude(there, times_ns) - magnitude(here, times_ns)
        assert np.abs(found[name][rows] - growth).max() < 0.02 * np.abs(growth).max(), name


def test_geodetic_latitude_and_height_read_as_geocentric() -> None:
    """At 45 deg and 500 km the place read is 4 km further out and 0.19 deg further north; the whole of it, or none."""
    form = forms("position_offset")["none", "geodetic as geocentric"]
    assert form.is_whole
    knots = scene().knots
    assert scene().position_ecef_km is not None
    place = scene().position_ecef_km[knots]
    radius = np.linalg.norm(place, axis=1)
    flat = 1.0 / 298.257223563
    sine = place[:, 2] / radius
    north_rad = flat * 2.0 * sine * np.sqrt(1.0 - sine**2) * 6378.137 / radius  # to first order in the flattening
    further_km = 6371.2 - 6378.137 * (1.0 - flat * sine**2)
    meridian = np.stack([-place[:, 0] * sine, -place[:, 1] * sine, radius * (1.0 - sine**2)], axis=1)
    meridian /= np.linalg.norm(meridian, axis=1)[:, None]
    read = place + north_rad[:, None] * radius[:, None] * meridian + (further_km / radius)[:, None] * place
    expected = scene().model_magnitude(place) - scene().model_magnitude(read)
    assert grown(form, [1.0])[knots] == pytest.approx(expected, abs=0.03 * np.abs(expected).max())


def test_the_forms_of_a_wrong_place_are_sums_of_gradients() -> None:
    g, hours = gradients(scene()), TIME_S / 3600.0
    found = forms("position_offset")
    cases: dict[str, tuple[list[float], Array]] = {
        "radial": ([2.0], 2.0 * g["radial"]),
        "along": ([3.0], 3.0 * g["along"]),
        "cross": ([4.0], 4.0 * g["cross"]),
        "radial and along": ([2.0, 3.0], 2.0 * g["radial"] + 3.0 * g["along"]),
        "three axes": ([2.0, 3.0, 4.0], 2.0 * g["radial"] + 3.0 * g["along"] + 4.0 * g["cross"]),
        "along, growing": ([3.0, 5.0], g["along"] * (3.0 + 5.0 * hours)),
        "along, growing faster": ([3.0, 5.0, 6.0], g["along"] * (3.0 + 5.0 * hours + 6.0 * hours**2)),
        "three axes, growing along": (
            [2.0, 3.0, 4.0, 5.0],
            2.0 * g["radial"] + 4.0 * g["cross"] + g["along"] * (3.0 + 5.0 * hours),
        ),
    }
    for variant, (amplitudes, expected) in cases.items():
        assert grown(found["none", variant], amplitudes) == pytest.approx(expected), variant
        assert found["none", variant].largest_nt == 3000.0
    units = {block.name: block.unit for form in found.values() for block in form.blocks}
    assert units["along_km_per_h2"] == "km/h2"
    assert units["radial_km"] == "km"


def test_without_a_model_a_place_further_out_sees_a_dipole() -> None:
    """|H| falls with the cube of the distance."""
    assert scene().position_ecef_km is not None
    clock = replace(scene(), utc=False)
    radius = np.linalg.norm(scene().position_ecef_km, axis=1)
    expected = scene().magnitude_nt * ((1.0 + 1e-4 / radius) ** -3 - 1.0) / 1e-4
    assert grown(forms("position_offset", clock)["none", "radial, dipole"], 1.0) == pytest.approx(expected, rel=1e-3)
    assert forms("position_offset", replace(clock, position_ecef_km=None)) == {}


def test_old_coefficients_lag_by_a_years_change() -> None:
    """A fifth of what five years have changed; a series cut short lacks what its terms above hold."""
    assert scene().position_ecef_km is not None
    rows = scene().knots[::40]
    times_ns, places = scene().time_ns[rows], scene().position_ecef_km[rows]
    five_years = round(5 * 365.25 * 86400 * 1e9)
    change = (magnitude(places, times_ns) - magnitude(places, times_ns - five_years)) / 5.0
    assert yearly_change(scene())[rows] == pytest.approx(change, abs=1e-6)
    assert grown(forms("reference_epoch")["none", ""], 3.0)[rows] == pytest.approx(3.0 * change, abs=1e-5)
    for age in (10.0, 21.0):  # between the ages at which it is computed, straight
        step = 2.5 * (age // 2.5)
        before, after = (
            magnitude(places, times_ns) - magnitude(places, times_ns - round(one * 365.25 * 86400 * 1e9))
            for one in (step, step + 2.5)
        )
        share = (age - step) / 2.5
        found = grown(forms("reference_epoch")["none", "by decades"], 20.0, age)[rows]
        assert grown(forms("reference_epoch")["none", "by decades"], 40.0, 400.0)[rows] == pytest.approx(
            magnitude(places, times_ns) - magnitude(places, times_ns - round(40.0 * 365.25 * 86400 * 1e9)), abs=1e-3
        )
        assert found == pytest.approx(20.0 / age * ((1.0 - share) * before + share * after), abs=1e-5)
    cut = magnitude(places, times_ns) - magnitude(places, times_ns, 6)
    assert truncated_change(scene(), 6)[rows] == pytest.approx(cut, abs=1e-6)
    form = forms("reference_epoch")["none", "degree 6"]
    assert form.constants == {"degree": 6.0}
    assert grown(form, 0.5)[rows] == pytest.approx(0.5 * cut, abs=1e-6)


def test_a_model_with_a_degree_gets_that_form_alone_and_one_without_the_years() -> None:
    def variants(given: Mapping[str, float] | None) -> list[str]:
        return [variant for _, variant in forms("reference_epoch", replace(scene(), given=given))]

    assert variants({"degree": 7.0}) == ["degree 7"]
    assert variants({}) == ["", "by decades"]
    assert variants(None) == ["", "by decades", *(f"degree {degree}" for degree in range(1, 13))]


def test_the_ring_current_adds_along_the_dipoles_axis_with_what_it_induces() -> None:
    """A uniform field, and 0.27 of it as a dipole's at the ground's equator, falling with r^3 (Olsen 2006).

    Its induced part adds at the equator and takes away over the pole: what conducts lets less through its surface.
    """
    assert scene().dipole_eci is not None
    assert scene().position_eci_km is not None
    assert scene().reference_eci_nt is not None
    found = ring_current(scene())
    assert found is not None
    axis, place = scene().dipole_eci, scene().position_eci_km
    radius = np.linalg.norm(place, axis=1)[:, None]
    # potential: -(m . r) of the ring and -0.27 a^3 (m . r) / r^3 of what it induces; the field is minus the gradient
    up = place / radius
    along = np.einsum("ni,ni->n", axis, up)[:, None]
    outward = (1.0 - 2.0 * 0.27 * (6371.2 / radius) ** 3) * along
    tangential = (1.0 + 0.27 * (6371.2 / radius) ** 3) * (axis - along * up)
    direction = scene().reference_eci_nt / scene().magnitude_nt[:, None]
    assert found == pytest.approx(np.einsum("ni,ni->n", outward * up + tangential, direction))
    nowhere = ring_current(replace(scene(), position_ecef_km=None))
    assert nowhere == pytest.approx(np.einsum("ni,ni->n", axis, direction))
    assert ring_current(replace(scene(), reference_eci_nt=None)) is None
    placeless = forms("external_field", replace(scene(), position_ecef_km=None))
    assert {variant.split(",")[0] for _, variant in placeless} == {"uniform"}


def test_a_storm_is_a_polynomial_in_time_that_ends_with_its_recording() -> None:
    """Legendre's polynomials over the recording; applied beyond it, the ends hold."""
    found = forms("external_field")
    ring = ring_current(scene())
    assert ring is not None
    middle, span = float(TIME_S.mean()), SPAN_S
    t = (TIME_S - middle) / span * 2.0
    legendre = [np.ones(COUNT), t, (3 * t**2 - 1) / 2, (5 * t**3 - 3 * t) / 2, (35 * t**4 - 30 * t**2 + 3) / 8]
    for variant, order in (("", 0), ("changing", 1), ("curved", 2), ("storm", 4)):
        amplitudes = np.arange(1.0, order + 2.0)
        expected = ring * sum(a * p for a, p in zip(amplitudes, legendre[: order + 1], strict=True))
        assert grown(found["none", variant], amplitudes) == pytest.approx(expected), variant
        course = {"middle_s": middle, "span_s": span} if order else {}
        assert found["none", variant].constants == {**course, "induced": 0.27}
    axis = scene().dipole_eci
    assert axis is not None
    assert scene().reference_eci_nt is not None
    bare = np.einsum("ni,ni->n", axis, scene().reference_eci_nt) / scene().magnitude_nt
    assert grown(found["none", "uniform, changing"], [1.0, 2.0]) == pytest.approx(bare * (1.0 + 2.0 * t))
    given = forms("external_field", replace(scene(), given={"middle_s": 1000.0, "span_s": 2000.0}))
    share = np.clip((TIME_S - 1000.0) / 1000.0, -1.0, 1.0)
    assert grown(given["none", "changing"], [1.0, 1.0]) == pytest.approx(ring * (1.0 + share))


# The direct form of a recorded driver


def term(**changes: object) -> SimpleNamespace:
    made = {
        "driver": "channel:board",
        "variant": "column 2",
        "amplitudes": {"nt_per_k": np.array([1.0, 2.0, 3.0])},
        "nonlinear": {},
        "constants": {"zero_degc": 20.0, "column": 1.0},
    }
    return SimpleNamespace(**made | changes)


def test_a_temperature_has_a_direct_form() -> None:
    found = direct_by_temperature(term(), "nt_per_k")  # type: ignore[arg-type]
    assert found is not None
    assert (found.channel, found.quantity, found.columns, found.zero) == ("board", "temperature", (1,), 20.0)
    assert found.field((0.0, 25.0), (1.0, 1.0, 1.0)) == [5.0, 10.0, 15.0]
    gain = direct_by_temperature(term(), "nt_per_k", is_gain=True)  # type: ignore[arg-type]
    assert gain is not None
    assert gain.field((0.0, 25.0), (10.0, 20.0, -30.0)) == [-50.0, -200.0, 450.0]
    plain = direct_by_temperature(term(variant="", constants={"zero_degc": 20.0}), "nt_per_k")  # type: ignore[arg-type]
    assert plain is not None
    assert plain.columns == (0,)


@pytest.mark.parametrize(
    "changes",
    [
        {"driver": "inferred:temperature"},
        {"variant": "answer to light"},
        {"constants": {}},
        {"constants": {"zero_degc": 20.0, "column": -1.0}},
        {"nonlinear": {"time_constant_s": 5.0}},
        {"amplitudes": {"per_k": np.ones(3)}},
        {"amplitudes": {"nt_per_k": np.ones(3), "more": np.ones(3)}},
        {"amplitudes": {"nt_per_k": np.ones((2, 3))}},
        {"amplitudes": {"nt_per_k": np.ones(2)}},
    ],
    ids=str,
)
def test_what_does_not_fit_has_no_direct_form(changes: dict[str, object]) -> None:
    assert direct_by_temperature(term(**changes), "nt_per_k") is None  # type: ignore[arg-type]


def test_circuits_have_a_direct_form_each_and_together() -> None:
    direct = effect_named("current_loop").direct
    both = term(
        variant="",
        amplitudes={"nt_per_a": np.arange(6.0).reshape(2, 3)},
        constants={"column_0": 2.0, "column_1": 0.0},
    )
    found = direct(both)  # type: ignore[arg-type]
    assert found is not None
    assert (found.quantity, found.columns, found.zero, found.is_gain) == ("current", (2, 0), 0.0, False)
    assert found.field((10.0, 5.0, 1.0), (0.0, 0.0, 0.0)) == [30.0, 41.0, 52.0]
    one = replace_amplitudes(both, np.ones((1, 3)), {"column_0": 1.0})
    assert direct(one) is not None  # type: ignore[arg-type]
    assert direct(replace_amplitudes(both, np.ones(3), {"column_0": 1.0})) is not None  # type: ignore[arg-type]
    assert direct(replace_amplitudes(both, np.ones(3), both.constants)) is None  # type: ignore[arg-type]
    both.driver = "channel:a+b"
    assert direct(both) is None  # type: ignore[arg-type]


def replace_amplitudes(of: SimpleNamespace, amplitudes: Array, constants: dict[str, float]) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(of), "amplitudes": {"nt_per_a": amplitudes}, "constants": constants})


@pytest.mark.parametrize(("mean_nt", "possible"), [(-400.0, True), (49.0, True), (51.0, False)])
def test_currents_above_add_little_to_the_north(mean_nt: float, possible: bool) -> None:
    """The ring current's field is southward, however large; how it changes has either sign."""
    for form in (h for (driver, _), h in forms("external_field", scene()).items() if driver == "none"):
        course = 200.0 * np.where(np.arange(form.size - 1) % 2, 1.0, -1.0)
        assert has_its_sign(form, np.concatenate([[mean_nt], course])) is possible


@pytest.mark.parametrize(
    ("course", "warmth"),
    [(np.sin(TIME_S / 900.0), True), (np.sign(np.sin(TIME_S / 900.0)), False), (np.sin(TIME_S / 40.0), False)],
)
def test_what_changes_as_slowly_as_warmth_in_counts_may_be_warmth(course: Array, warmth: bool) -> None:
    """A load switches, and a panel turns through the Sun; counts tell no heat from a current, ampere do."""
    for kind, expected in (("counts", warmth), ("current", False)):
        channels = {"one": Telemetry("one", kind, 500.0 + 80.0 * course[:, None])}
        found = forms("current_loop", replace(scene(), channels=channels))
        recorded = [form for (driver, _), form in found.items() if driver == "channel:one"]
        assert {form.as_well == ("thermal_bias",) for form in recorded} == {expected}
        assert {form.variant for form in recorded} == {"", "lagging", "recorded late"}


def test_a_drift_swings_by_what_a_warming_sensor_may_at_the_most() -> None:
    """3000 nT over the recording; a parabola that comes back has four times the slope; none where a model is given."""
    span_s = float(np.ptp(TIME_S))
    found = forms("bias_drift")
    assert found["none", ""].blocks[0].most * span_s == pytest.approx(3000.0)
    slope, bend = found["none", "quadratic"].blocks
    share = np.linspace(0.0, 1.0, 101)
    swing_nt = slope.most * span_s * share - bend.most * span_s**2 * share**2
    assert np.ptp(swing_nt) == pytest.approx(3000.0, rel=1e-3)
    assert found["none", "relaxing"].blocks[0].most == pytest.approx(3000.0)
    given = forms("bias_drift", replace(scene(), given={}))
    assert {block.most for form in given.values() for block in form.blocks} == {math.inf}


@pytest.mark.parametrize(
    ("faces", "quantity", "sun", "as_well"),
    [
        (4, "current", False, ("sun_disturbance",)),
        (4, "counts", False, ("sun_disturbance",)),
        (2, "current", False, ()),
        (4, "current", True, ()),
    ],
)
def test_cells_of_three_faces_and_more_may_stand_for_the_suns_direction(
    faces: int, quantity: str, sun: bool, as_well: tuple[str, ...]
) -> None:
    """A field that turns with the Sun follows them, too; where the Sun's direction is known, that one is told."""
    angle = 0.2 * TIME_S[:, None] + 0.5 * np.pi * np.arange(faces)
    cells = Telemetry("cells", quantity, 0.4 * np.maximum(np.cos(angle), 0.0))
    load = Telemetry("load", "current", 0.5 + 0.1 * np.sin(TIME_S / 700.0)[:, None])
    found = {"cells": cells, "load": load, **({"sun": scene().channels["sun"]} if sun else {})}
    blind = replace(scene(), channels=found, body_from_eci=None, position_ecef_km=None)
    by = [h for h in effect_named("current_loop").hypotheses(blind) if h.driver == "channel:cells"]
    assert by
    assert {h.as_well for h in by} == {as_well}
    assert {h.as_well for h in forms("current_loop", blind).values() if h.driver == "channel:load"} == {()}
