"""What the rules draw: times, vectors and values at every edge, messages of every kind, commands."""

from __future__ import annotations

import math
from typing import Any, Final

from hypothesis import strategies as st

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.daemon.command_table import COMMANDS
from magcal_service.ticks.time_window import EARLIEST_NS, FURTHEST_NS, LATEST_NS, LONGEST_NS
from magcal_service.wire.kinds import MAX_POSITION_KM, MAX_SAMPLE_FIELD_NT, MAX_TELEMETRY, MAX_VALUES
from magcal_service.wire.messages import Clock, Frame, Vector
from tests.fuzz.rules.crafts import SECOND_NS, START_NS

FIRST_NS, LAST_NS = -(1 << 63), (1 << 63) - 1
"""What the wire carries."""

_SEQUENCES: Final = (0, 1, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
_SMALL: Final = (0.0, -0.0, 5e-324, 1e-300, 1e-9, 1.0)
_EDGES_NS: Final = (
    *(FIRST_NS, LAST_NS, EARLIEST_NS, LATEST_NS, FURTHEST_NS, LONGEST_NS, -FURTHEST_NS, START_NS),
    *(0, 1 << 31, 1 << 32, 1 << 53, -(1 << 53), EARLIEST_NS + FURTHEST_NS, EARLIEST_NS + LONGEST_NS),
)
_NEAR_NS: Final = (0, 1, -1, 500_000_000, SECOND_NS, -SECOND_NS, 3 * SECOND_NS, -3 * SECOND_NS)
_STEPS_NS: Final = tuple(
    sign * seconds * SECOND_NS + more
    for sign in (-1, 1)
    for seconds in (0, 1, 2, 3, 10, 30, 60, 120, 600, 3600, 6000, 604_800)
    for more in (0, 1)
)


def _held(time_ns: int) -> int:
    return min(max(time_ns, FIRST_NS), LAST_NS)


edges_ns = st.builds(lambda edge, near: _held(edge + near), st.sampled_from(_EDGES_NS), st.sampled_from(_NEAR_NS))
"""Source times at the edges of everything [ns]."""

clocks = st.sampled_from([Clock.UTC, Clock.UTC, Clock.UTC, Clock.ELAPSED])
sequences = st.one_of(st.integers(0, 1000), st.sampled_from(_SEQUENCES))
steps_ns = st.sampled_from(_STEPS_NS)
"""From the newest time, at the limits of the tick stage [ns]."""


def times_ns(now_ns: int) -> st.SearchStrategy[int]:
    """Source times near the newest, at edges, or anywhere [ns]."""
    near = steps_ns.map(lambda step: _held(now_ns + step))
    return st.one_of(near, near, edges_ns, st.integers(FIRST_NS, LAST_NS))


def numbers(limit: float) -> st.SearchStrategy[float]:
    """Numbers within a limit, the odd ones first."""
    odd = [sign * one for sign in (1.0, -1.0) for one in (*_SMALL, limit, limit * (1.0 - 1e-15), limit * 1e-3)]
    return st.one_of(st.sampled_from(odd), st.floats(-limit, limit))


def _within(vector: Vector, limit: float) -> Vector:
    length = math.sqrt(sum(one * one for one in vector))
    if length <= limit:
        return vector
    x, y, z = (one / length * limit * (1.0 - 1e-12) for one in vector)
    return (x, y, z)


def vectors(limit: float, usual: float) -> st.SearchStrategy[Vector]:
    """Vectors within a length, of the usual size or of any."""
    parts = st.tuples(numbers(limit), numbers(limit), numbers(limit))
    common = st.tuples(*[st.floats(-usual, usual)] * 3)
    return st.one_of(common, parts).map(lambda vector: _within(vector, limit))


fields_nt = vectors(MAX_SAMPLE_FIELD_NT, 4e4)
turns = st.tuples(*[numbers(MAX_TELEMETRY)] * 3)
positions_km = vectors(MAX_POSITION_KM, 7e3)
frames = st.sampled_from(list(Frame))
magnitudes_nt = st.one_of(st.floats(2e4, 6e4), numbers(MAX_SAMPLE_FIELD_NT).map(abs))
channels = st.sampled_from(["temperature", "current", "gyro", "sun", "coil", "x" * 32, *map(str, range(20))])
units = st.sampled_from([*CHANNEL_UNITS, "furlong", "°C"])
values = st.lists(numbers(MAX_TELEMETRY), min_size=1, max_size=MAX_VALUES).map(tuple)

_texts = st.sampled_from(["", "before", "a", "physics.toml", "strange.toml", "../physics.toml", "x" * 33, "ä"])
_numbers = st.one_of(
    st.sampled_from([0, 1, -1, 0.01, 1000.0, 1001.0, LAST_NS, FIRST_NS, 1.7e308, -1.7e308, 5e-324, True]),
    st.floats(0.0, 1000.0),
)
commands = st.sampled_from([*(name for name in COMMANDS if name != "shutdown"), "format"])


def arguments(command: str) -> st.SearchStrategy[dict[str, Any]]:
    """Arguments of a command: its own, mostly, and what it never takes."""
    spec = COMMANDS.get(command)
    own = [] if spec is None else [*spec.arguments]
    names = st.sampled_from([*own, *own, "bias_nt", "D", "name", "other"])
    return st.dictionaries(names, st.one_of(_numbers, _texts), max_size=3)
