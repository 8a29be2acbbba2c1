"""A stream cut anywhere, stored, and taken up by another process goes on to the last bit, for every method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.config.settings import CraftConfig, FilterConfig, PhysicsConfig, SensorConfig, SpinConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators import methods
from magcal_service.wire.messages import (
    Clock,
    Command,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from tests.daemon.pipeline_streams import START_NS, paper
from tests.daemon.restart_worker import Worker, published

SECONDS = 300
AFTER_S = 110  # what is compared after the cut: whole spin windows, a start, the verdict's memory
FULL_SCALE_NT = 80_000.0

PHYSICS = """
version = 1
[recording]
name = "a flight"
origin_ns = 1750000000000000000
clock = "utc"
[errors]
bias_nt = [4000.0, 2000.0, 3000.0]
D = [0.05, 0.1, 0.05, 0.05, 0.05, 0.05]
[[effect]]
name = "thermal_bias"
driver = "channel:t"
[effect.amplitudes]
nt_per_k = [4.0, -3.0, 5.0]
[effect.constants]
zero_degc = 20.0
column = 0.0
[[effect]]
name = "torquer"
driver = "channel:m"
[effect.amplitudes]
nt_per_am2 = [[300.0, 10.0, 0.0], [0.0, 200.0, 20.0], [30.0, 0.0, 400.0]]
[effect.nonlinear]
decay_s = 1.0
[effect.constants]
column_0 = 0.0
column_1 = 1.0
column_2 = 2.0
"""

COMMANDS = {
    "freeze": {},
    "resume": {},
    "reset": {},
    "process_noise": {"bias_nt": 0.5, "D": 1e-6},
    "status": {},
}


@cache
def flown() -> tuple[np.ndarray, np.ndarray]:
    """B and H (n, 3) [nT] of the paper's craft."""
    block = paper(23, float(SECONDS)).arrays()
    return block.measured_nt, block.true_eci_nt


def second(k: int, trouble: str) -> Iterator[Message]:
    """All that comes in one second, with what goes wrong in it."""
    B, H = flown()
    stamp = {"craft": "paper", "sequence": k, "time_ns": START_NS + k * 10**9, "clock": Clock.UTC}
    field = tuple(B[k].tolist())
    if trouble == "gap":
        return
    if trouble in COMMANDS:
        yield Command(**stamp, source="operator", name=trouble, arguments=COMMANDS[trouble])
    angle = 0.9 * k
    gyro = (0.01 * float(np.sin(angle)), 0.01 * float(np.cos(angle)), 0.785)
    yield TelemetrySample(**stamp, source="imu", channel="gyro", unit="rad/s", values=gyro)
    if k % 5 == 0 and trouble != "no telemetry":
        warm = (20.0 + float(np.sin(0.02 * k)),)
        yield TelemetrySample(**stamp, source="obc", channel="t", unit="degC", values=warm)
        moment = (0.1 * float(np.sign(np.sin(0.1 * k))), 0.0, 0.05)
        yield TelemetrySample(**stamp, source="obc", channel="m", unit="A m2", values=moment)
        place = (6900.0 * float(np.cos(0.001 * k)), 6900.0 * float(np.sin(0.001 * k)), 100.0)
        yield PositionSample(**stamp, source="gps", position_km=place, frame=Frame.ECI)
    if trouble == "spike":
        field = (field[0] + 20_000.0, field[1], field[2])
    elif trouble == "saturated":
        field = (FULL_SCALE_NT, field[1], field[2])
    elif trouble == "stuck":
        field = tuple(B[k - k % 40].tolist())
    if trouble != "no reference":
        yield ReferenceSample(**stamp, source="model", field_nt=tuple(H[k].tolist()), frame=Frame.ECI)
    yield MagnetometerSample(**stamp, source="mag", field_body_nt=field)  # type: ignore[arg-type]


def stream(troubles: list[tuple[str, int, int]]) -> list[Message]:
    """The flight with troubles: what, from which second, for how many (a command: once)."""
    at = {
        k: what
        for what, first, length in troubles
        for k in range(first, min(first + (1 if what in COMMANDS else length), SECONDS))
    }
    return [message for k in range(SECONDS) for message in second(k, at.get(k, ""))]


def carried_on(
    elsewhere: Worker, config: CraftConfig, whole: Pipeline, messages: list[Message], at: int
) -> tuple[list[bytes], list[bytes]]:
    """What two publish of ``AFTER_S`` after a cut: one elsewhere from the stored state, and ``whole``, that goes on."""
    state = msgpack.packb(whole.export_state())
    until_ns = messages[at].time_ns + AFTER_S * 10**9
    later = [message for message in messages[at:] if message.time_ns < until_ns]
    return elsewhere(config, state, later), published(whole, later)


def craft(method: str, *, physics: bool, adaptive: bool, told: bool) -> CraftConfig:
    return CraftConfig(
        "paper",
        sensor=SensorConfig(noise_nt=300.0 if told else None, range_nt=FULL_SCALE_NT),
        spin=SpinConfig(rate_rpm=7.5),
        filter=FilterConfig(method=method, start_s=40.0, adaptive=adaptive and method == "ukf"),
        physics=PhysicsConfig(Path("physics.toml"), PHYSICS) if physics else None,
    )


TROUBLES = st.tuples(
    st.sampled_from(["gap", "spike", "saturated", "stuck", "no reference", "no telemetry", *COMMANDS]),
    st.integers(0, SECONDS - 1),
    st.integers(1, 90),
)


@pytest.fixture(scope="module")
def elsewhere():  # type: ignore[no-untyped-def]
    """A process of its own."""
    worker = Worker()
    yield worker
    worker.close()


@pytest.mark.parametrize("method", [method.name for method in methods()])
def test_a_stream_cut_anywhere_goes_on_to_the_last_bit_in_a_fresh_process(method: str, elsewhere: Worker) -> None:
    @settings(max_examples=4, deadline=None)
    @given(
        cut=st.floats(0.02, 0.98),
        troubles=st.lists(TROUBLES, max_size=5),
        physics=st.booleans(),
        adaptive=st.booleans(),
        told=st.booleans(),
    )
    def goes_on(cut: float, troubles: list[tuple[str, int, int]], physics: bool, adaptive: bool, told: bool) -> None:
        config = craft(method, physics=physics, adaptive=adaptive, told=told)
        messages = stream(troubles)
        at = int(cut * len(messages))
        whole = Pipeline(config)
        published(whole, messages[:at])
        theirs, ours = carried_on(elsewhere, replace(config), whole, messages, at)
        assert theirs == ours

    goes_on()


def test_a_cut_between_a_command_and_the_next_tick_goes_on_to_the_last_bit(elsewhere: Worker) -> None:
    """What a freeze has left to the first tick after it is carried over."""
    config = craft("ukf", physics=False, adaptive=False, told=True)
    messages = stream([("freeze", 110, 1), ("resume", 190, 1)])
    at = 1 + next(i for i, one in enumerate(messages) if isinstance(one, Command) and one.name == "resume")
    whole = Pipeline(config)
    published(whole, messages[:at])
    theirs, ours = carried_on(elsewhere, config, whole, messages, at)
    assert theirs == ours


@pytest.mark.parametrize("what", ["freeze", "process_noise", "stuck", "saturated", "gap", "no telemetry", "spike"])
def test_a_cut_in_the_midst_of_a_trouble_goes_on_to_the_last_bit(what: str, elsewhere: Worker) -> None:
    """Each trouble a minute before the cut, an end of it after: what is only kept while it lasts must not be lost."""
    config = craft("ukf", physics=True, adaptive=True, told=True)
    messages = stream([(what, 120, 80), ("resume", 220, 1)])
    whole = Pipeline(config)
    early, late = (
        next(i for i, message in enumerate(messages) if message.time_ns >= START_NS + at_s * 10**9)
        for at_s in (125, 182)
    )
    published(whole, messages[:early])
    state = msgpack.packb(whole.export_state())
    between = published(whole, messages[early:late])
    later = [message for message in messages[late:] if message.time_ns < START_NS + (182 + AFTER_S) * 10**9]
    from_late = elsewhere(config, msgpack.packb(whole.export_state()), later)
    ours = published(whole, later)
    assert from_late == ours
    assert elsewhere(config, state, [*messages[early:late], *later]) == between + ours
