"""What effects of a temperature, a current or the Sun add, worked out here from their equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.effects.sun_disturbance import harmonics
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.effect_forms import FIELD, TIME_S, added, forms
from tests.physics.scenes import COUNT, scene


def sizes(form: Hypothesis) -> dict[str, tuple[int, ...]]:
    return {block.name: block.shape for block in form.blocks}


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


def test_a_column_is_a_part_of_a_forms_name_like_others() -> None:
    found = [variant for driver, variant in forms("thermal_scale", two_boards(0.06)) if driver == "channel:boards"]
    assert {"column 2", "one gain, column 2", "of the field alone, column 2"} <= set(found)


def test_a_temperature_that_is_inferred_has_odds_against_it_where_one_was_recorded() -> None:
    """It answers to light behind a skin; what it began with decays by itself."""
    found = forms("thermal_bias")["inferred:temperature", "answer to light"]
    bare = forms("thermal_bias", replace(scene(), channels={}))["inferred:temperature", "answer to light"]
    assert (found.odds, bare.odds) == (5.0, 0.0)
    assert (found.exactly_alike, bare.exactly_alike) == (("unknown",), ())
    assert "a battery's charge" in found.imitated_by
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
