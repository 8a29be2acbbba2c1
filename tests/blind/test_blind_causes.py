"""Single causes against closed forms: a late sensor, memory in iron and in noise, a frozen register, a full scale."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.blind import EFFECTS, draw_case
from tests.blind.attitude import RPM
from tests.blind.body import apparent_hz
from tests.blind.cause import Cause
from tests.blind.hysteresis import play
from tests.blind.motion import despun
from tests.blind.noise import remembering
from tests.blind.sensor import measure
from tests.blind.streams import Streams
from tests.blind.vectors import Floats, dot, turn
from tests.blind.world import World, draw_world


def _world(name: str, seconds: float = 3000.0) -> World:
    world = draw_world(Streams(17, name))
    return replace(world, time_s=np.arange(0.0, seconds, 1.0))


def _cause(name: str) -> Cause:
    return EFFECTS[name](_world(name), True)


def test_lag_weakens_and_turns_what_turns() -> None:
    """At rate w a lag tau leaves 1 / sqrt(1 + w^2 tau^2) of a turning field and turns it back by atan(w tau)."""
    cause, tau, rate = _cause("response_lag"), 0.3, 2.0
    sampling = cause.spoil(tau).sampling
    assert sampling is not None

    def turning(times: Floats) -> Floats:
        return np.stack([np.cos(rate * times), np.sin(rate * times), np.ones_like(times)], axis=-1)

    times = np.linspace(0.0, 10.0, 40)
    gain, late = 1.0 / math.hypot(1.0, rate * tau), math.atan(rate * tau)
    expected = turning(times - late / rate) * [gain, gain, 1.0]
    assert sampling(turning, times) == pytest.approx(expected, abs=1e-6)


def test_skewed_axis_shows_the_field_of_its_own_instant() -> None:
    """Each axis of a skewed sensor has the value it would have had, tagged later by its delay."""
    cause = _cause("axis_skew")
    delays = np.array(cause.parameters(0.02)["delay_s"])
    skewed = measure(cause.world, [cause.spoil(0.02)]).field_nt
    for axis, delay in enumerate(delays):
        later = measure(replace(cause.world, time_s=cause.world.time_s + delay)).field_nt
        assert skewed[:, axis] == pytest.approx(later[:, axis], abs=1e-6)
    assert sorted(delays) == pytest.approx([0.0, 0.02, 0.04])


def test_curved_response_is_in_the_measured_field() -> None:
    """(I + D) B - b - d(B) is the field in the body, d by the answer's cubic and transverse numbers."""
    for seed in range(20):
        world = replace(draw_world(Streams(seed, "cubic")), time_s=np.arange(500.0))
        cause = EFFECTS["cubic_response"](world, True)
        truth = cause.parameters(200.0)
        field = measure(world, [cause.spoil(200.0)]).field_nt
        curved = np.array(truth["per_nt2"]) * field**3 + field * (field**2 @ np.array(truth["transverse_per_nt2"]).T)
        body = field @ (np.eye(3) + world.scale) - world.bias_nt - curved
        assert body == pytest.approx(world.field_body(world.time_s), abs=1e-2)
        if np.any(truth["transverse_per_nt2"]):
            return
    raise AssertionError("no sensor of twenty has transverse terms")


def test_alias_is_the_distance_to_the_nearest_multiple() -> None:
    """Samples at 1 Hz show 0.7 Hz as 0.3 Hz, 1000.2 Hz as 0.2 Hz and 0.1 Hz as itself."""
    assert [apparent_hz(tone, 1.0) for tone in (0.7, 1000.2, 0.1)] == pytest.approx([0.3, 0.2, 0.1])


def test_late_sensors_come_with_a_despin() -> None:
    """A lag or a skew is drawn in a craft that loses at least half of its rate, and the answer says so."""
    world = despun(_world("despin"), Streams(1, "despin").rng("despin"))
    first, last = np.abs(world.motion.rate.rate(np.array([0.0, world.duration_s])))
    assert 0.09 < last / first < 0.51
    assert draw_case(3, "axis_skew").answer.also == ("spin_rate",)
    assert draw_case(3, "axis_skew").spin_rpm is None


def test_cone_has_its_angle() -> None:
    """Under nutation the body's axis keeps the answer's angle to the momentum."""
    cause = _cause("nutation")
    motion = cause.spoil(4.0).motion
    assert motion is not None
    axis_eci = turn(np.swapaxes(motion.body_from_eci(cause.world.time_s), 1, 2), motion.axis_body)
    angle = np.degrees(np.arccos(dot(axis_eci, motion.momentum_eci)))
    assert angle == pytest.approx(np.full_like(angle, 4.0), abs=1e-5)


def test_spin_that_is_not_as_stated() -> None:
    """The answer's rates are the craft's at both ends of the recording, and not the stated one throughout."""
    cause = _cause("spin_rate")
    motion = cause.spoil(1.0).motion
    assert motion is not None
    truth = cause.parameters(1.0)
    rates = motion.rate.rate(np.array([0.0, cause.world.duration_s])) / RPM
    assert rates.tolist() == pytest.approx([truth["rate_rpm"], truth["rate_rpm_at_end"]])
    assert np.abs(rates - cause.world.motion.rate.start_rad_s / RPM).max() > 1e-4


def test_play_has_a_loop_of_its_width() -> None:
    """Under a swing of amplitude A a play of half width r swings by A - r and loses 4 r (A - r) a turn."""
    angle = np.linspace(0.0, 8.0 * np.pi, 40001)
    applied = 5.0 * np.sin(angle)
    state = play(applied, [2.0], [1.0])
    turns = slice(20000, 40001)  # two whole turns, settled
    assert np.abs(state[turns]).max() == pytest.approx(3.0, abs=1e-6)
    loss = abs(float(np.sum(0.5 * (state[turns][1:] + state[turns][:-1]) * np.diff(applied[turns])))) / 2.0
    assert loss == pytest.approx(4.0 * 2.0 * 3.0, rel=1e-3)


def test_hysteresis_is_no_function_of_the_field() -> None:
    """At equal fields the disturbance has two values, one for each way the field goes."""
    cause = _cause("hysteresis")
    world = cause.world
    hook = cause.spoil(100.0).disturbance
    assert hook is not None
    field = world.field_body(world.time_s)
    added = hook(world.time_s, field)
    smooth = np.concatenate([field, field**2, field**3], axis=1) / np.abs(field).max() ** np.repeat([1, 2, 3], 3)
    columns = np.concatenate([smooth, np.ones((len(field), 1))], axis=1)
    rest = added - columns @ np.linalg.lstsq(columns, added, rcond=None)[0]
    assert np.sqrt(np.mean(rest**2)) > 0.3 * np.sqrt(np.mean(added**2))


def test_remembering_keeps_the_variance() -> None:
    """A first-order process driven by white noise of one variance has that variance and the correlation it keeps."""
    white = np.random.default_rng(2).normal(0.0, 2.0, (40001, 3))
    course = remembering(white[1:], 0.7, white[0])
    assert course.std() == pytest.approx(2.0, rel=0.02)
    assert np.corrcoef(course[1:, 0], course[:-1, 0])[0, 1] == pytest.approx(0.7, abs=0.015)


@pytest.mark.parametrize("seed", range(6))
def test_coloured_noise_has_the_correlation_of_its_answer(seed: int) -> None:
    """Whatever its form, coloured noise has the world's variance and the answer's correlation of neighbours."""
    world = replace(draw_world(Streams(seed, "colour")), time_s=np.arange(18000.0))
    cause = EFFECTS["coloured_noise"](world, True)
    assert cause.noise is not None
    noise = cause.noise(1.0, np.random.default_rng(seed).normal(0.0, world.noise_nt, (18000, 3)))
    assert noise.std() == pytest.approx(world.noise_nt, rel=0.08)
    neighbours = [float(np.corrcoef(axis[1:], axis[:-1])[0, 1]) for axis in noise.T]
    assert np.mean(neighbours) == pytest.approx(cause.parameters(1.0)["correlation"], abs=0.03)


def test_frozen_axis_repeats_itself_and_no_other_does() -> None:
    """In its spells the stuck axis shows one value, to the last digit; the other axes go on."""
    case = draw_case(8, "stuck_axis")
    truth = case.answer.effects[0].parameters
    axis, spans = truth["axis"], truth["spans_s"]
    for first, last in spans:
        spell = case.field_nt[(case.time_s >= first) & (case.time_s < last)]
        assert np.ptp(spell[:, axis]) == 0.0
        assert np.ptp(spell, axis=0)[[other for other in range(3) if other != axis]].min() > 100.0


def test_quantised_values_are_multiples_of_the_step() -> None:
    """Every value is a multiple of the answer's step, to the written digits."""
    case = draw_case(8, "quantisation")
    steps = case.field_nt / case.answer.effects[0].parameters["lsb_nt"]
    assert np.abs(steps - np.round(steps)).max() < 1e-3


def test_saturated_axis_ends_at_its_limit() -> None:
    """A hard limit is reached often and never passed; with a soft knee the values stay below it."""
    for seed in range(4):
        case = draw_case(seed, "saturation")
        truth = case.answer.effects[0].parameters
        axis, limit = truth["axis"], truth["limit_nt"]
        size = np.abs(case.field_nt[:, axis])
        assert size.max() < limit + 0.01
        if truth["knee_nt"] == 0.0:
            assert np.count_nonzero(size > limit - 0.01) >= 5
