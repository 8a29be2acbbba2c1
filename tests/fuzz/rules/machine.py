"""The rules: whatever comes, in whatever order, the daemon goes on, and no craft pays for another.

Each rule is a step; ``Rules`` is for one method, ``rules_of`` makes it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar, Final

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from magcal_service.wire.messages import (
    Clock,
    Command,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Vector,
)
from tests.fuzz import inputs
from tests.fuzz.rules import drawn
from tests.fuzz.rules.crafts import CALM, OTHER, SECOND_NS, SHORT_S, START_NS, WILD, crafts, flight
from tests.fuzz.rules.world import World

_driven: Final = st.sampled_from([WILD, WILD, WILD, OTHER])
_PLACES: Final = {
    "estimator": lambda pipeline: (pipeline.estimator, "handle"),
    "ticks": lambda pipeline: (pipeline.ticks, "rejection"),
    "monitor": lambda pipeline: (pipeline.monitor, "judge"),
    "watch": lambda pipeline: (pipeline.watch, "push"),
    "summary": lambda pipeline: (pipeline, "summary"),
    "state": lambda pipeline: (pipeline, "export_state"),
}
"""Where a defect is planted: a part of a craft and its method."""


class Rules(RuleBasedStateMachine):
    """Drives one world."""

    method: ClassVar[str] = "ukf"
    total: ClassVar[Counter[str]] = Counter()
    """What was done in all worlds of the class."""

    flights_s: ClassVar[tuple[int, int, int]] = SHORT_S
    """How long the craft has flown when a world begins [s], one of them."""

    line: ClassVar[str] = "loop"
    """The link, one of ``lines.LINES``."""

    world: World

    @initialize(number=st.integers(0, 5), flown_s=st.integers(0, 2), writes=st.integers(0, 9))
    def begin(self, number: int, flown_s: int, writes: int) -> None:
        """Open a world with one of the method's configurations, at rest or after a flight."""
        choices = crafts(self.method)
        seconds = self.flights_s[flown_s]
        self.world = World(choices[number % len(choices)], flown_s=seconds, writes=writes == 9, line=self.line)
        self.now_ns = {WILD: START_NS + seconds * SECOND_NS, OTHER: START_NS, CALM: START_NS}
        self.seconds = {WILD: seconds, OTHER: 0, CALM: 0}
        self.steps_since_start = 0

    @invariant()
    def counted(self) -> None:
        """A step is done; what has to hold after it was asserted in it."""
        if hasattr(self, "world"):
            self.world.done["steps"] += 1
            self.steps_since_start += 1

    def _common(self, craft: str, time_ns: int, sequence: int, clock: Clock, source: str) -> dict[str, Any]:
        return {"craft": craft, "source": source, "sequence": sequence, "time_ns": time_ns, "clock": clock}

    def _fly(self, craft: str, count: int) -> list[Message]:
        sent = list(flight(craft, self.now_ns[craft], self.seconds[craft], count))
        self.now_ns[craft] = min(self.now_ns[craft] + count * SECOND_NS, drawn.LAST_NS - 100 * SECOND_NS)
        self.seconds[craft] += count
        return sent

    @rule(craft=st.sampled_from([WILD, WILD, OTHER, CALM, CALM]), count=st.integers(1, 25))
    def fly(self, craft: str, count: int) -> None:
        """Sound seconds, from the craft's time on."""
        self.world.send(self._fly(craft, count))

    @rule(craft=_driven, edge_ns=drawn.edges_ns, count=st.integers(1, 4))
    def hop(self, craft: str, edge_ns: int, count: int) -> None:
        """The craft's clock is somewhere else from now on."""
        self.now_ns[craft] = min(edge_ns, drawn.LAST_NS - 100 * SECOND_NS)
        self.world.send(self._fly(craft, count))

    @rule(craft=_driven, step_ns=drawn.steps_ns, count=st.integers(1, 4))
    def step(self, craft: str, step_ns: int, count: int) -> None:
        """The craft's clock steps, at the limits of what is believed."""
        moved_ns = self.now_ns[craft] + step_ns
        self.now_ns[craft] = min(max(moved_ns, drawn.FIRST_NS), drawn.LAST_NS - 100 * SECOND_NS)
        self.world.send(self._fly(craft, count))

    @rule(craft=_driven, data=st.data(), fields=st.lists(drawn.fields_nt, min_size=1, max_size=4))
    def samples(self, craft: str, data: st.DataObject, fields: list[Vector]) -> None:
        """Vectors of any size, at rising times from one of any kind."""
        time_ns = data.draw(drawn.times_ns(self.now_ns[craft]))
        common = self._common(craft, time_ns, data.draw(drawn.sequences), data.draw(drawn.clocks), "mag0")
        sent = [MagnetometerSample(**common, field_body_nt=field) for field in fields]
        self.world.send(_rising(sent))

    @rule(craft=_driven, field=drawn.fields_nt, magnitude_nt=drawn.magnitudes_nt, count=st.integers(1, 8))
    def strange_seconds(self, craft: str, field: Vector, magnitude_nt: float, count: int) -> None:
        """Sound times with vectors and references that no sensor gives."""
        x, y, z = field
        sent: list[Message] = []
        for number, message in enumerate(self._fly(craft, count)):
            if isinstance(message, MagnetometerSample):
                message = replace(message, field_body_nt=(x * (1.0 - 1e-6 * number), y, z) if number % 3 else (y, z, x))
            if isinstance(message, ReferenceSample):
                message = replace(message, field_nt=None, frame=None, magnitude_nt=magnitude_nt)
            sent.append(message)
        self.world.send(sent)

    @rule(craft=_driven, turn=drawn.turns, place=drawn.positions_km, count=st.integers(1, 8))
    def strange_surroundings(self, craft: str, turn: Vector, place: Vector, count: int) -> None:
        """Sound times, vectors and references with channels and places that no craft has."""
        sent: list[Message] = []
        for message in self._fly(craft, count):
            if isinstance(message, TelemetrySample):
                message = replace(message, values=turn[: len(message.values)])
            if isinstance(message, PositionSample):
                message = replace(message, position_km=place)
            sent.append(message)
        self.world.send(sent)

    @rule(craft=_driven, data=st.data(), field=st.one_of(st.none(), drawn.fields_nt), count=st.integers(1, 4))
    def references(self, craft: str, data: st.DataObject, field: Vector | None, count: int) -> None:
        """References of any size, at rising times from one of any kind."""
        time_ns = data.draw(drawn.times_ns(self.now_ns[craft]))
        common = self._common(craft, time_ns, data.draw(drawn.sequences), data.draw(drawn.clocks), "igrf")
        if field is None:
            sent = [ReferenceSample(**common, magnitude_nt=data.draw(drawn.magnitudes_nt))]
        else:
            sent = [ReferenceSample(**common, field_nt=field, frame=data.draw(drawn.frames))]
        self.world.send(_rising(sent * count))

    @rule(craft=_driven, data=st.data(), place=drawn.positions_km, frame=st.sampled_from([Frame.ECI, Frame.ECEF]))
    def position(self, craft: str, data: st.DataObject, place: Vector, frame: Frame) -> None:
        """A place anywhere at any time."""
        time_ns = data.draw(drawn.times_ns(self.now_ns[craft]))
        common = self._common(craft, time_ns, data.draw(drawn.sequences), data.draw(drawn.clocks), "gps")
        self.world.send([PositionSample(**common, position_km=place, frame=frame)])

    @rule(craft=_driven, data=st.data(), channel=drawn.channels, unit=drawn.units, values=drawn.values)
    def telemetry(self, craft: str, data: st.DataObject, channel: str, unit: str, values: tuple[float, ...]) -> None:
        """A channel of any unit and size at any time."""
        time_ns = data.draw(drawn.times_ns(self.now_ns[craft]))
        common = self._common(craft, time_ns, data.draw(drawn.sequences), data.draw(drawn.clocks), "bus")
        sent = [TelemetrySample(**common, channel=channel, unit=unit, values=values)]
        self.world.send(_rising(sent * data.draw(st.integers(1, 3))))

    @rule(craft=_driven, name=drawn.commands, data=st.data())
    def command(self, craft: str, name: str, data: st.DataObject) -> None:
        """A command with arguments that it takes, or does not."""
        common = self._common(craft, data.draw(drawn.edges_ns), data.draw(drawn.sequences), Clock.UTC, "desk")
        self.world.send([Command(**common, name=name, arguments=data.draw(drawn.arguments(name)))])

    @rule(craft=st.sampled_from([WILD, OTHER, "nobody"]), number=st.integers(0, 20), time_ns=drawn.edges_ns)
    def any_kind(self, craft: str, number: int, time_ns: int) -> None:
        """A message of each kind, results among them, as of any craft."""
        kinds = _kinds()
        self.world.send([replace(kinds[number % len(kinds)], craft=craft, time_ns=time_ns)])

    @rule(data=st.binary(max_size=40))
    def garbage(self, data: bytes) -> None:
        """Bytes that are no message."""
        self.world.inject(data)

    @rule(saves=st.booleans())
    def tend(self, saves: bool) -> None:
        """The checkpoint is due, or status, metrics and summary are."""
        if saves:
            self.world.save()
        else:
            self.world.status()

    @precondition(lambda self: self.steps_since_start >= 10)
    @rule(craft=_driven, how=st.sampled_from(["stop", "kill", "save", "cut", "flip"]), at=st.integers(0, 1 << 20))
    def restart(self, craft: str, how: str, at: int) -> None:
        """The daemon is stopped, killed, or killed right after a checkpoint, which a failing disk may have changed."""
        self.steps_since_start = 0
        if how == "stop":
            self.world.stop()
            return
        if how != "kill":
            self.world.save()
        if how in ("cut", "flip"):
            self.world.spoil_newest(craft, lambda raw: _spoilt(raw, at, cut=how == "cut"))
        self.world.kill()

    @rule(craft=_driven, place=st.sampled_from(sorted(_PLACES)))
    def plant(self, craft: str, place: str) -> None:
        """A defect in one craft's work: it alone begins anew."""
        self.world.plant(craft, _PLACES[place])

    def teardown(self) -> None:
        """Count what was done."""
        if hasattr(self, "world"):
            self.total.update(self.world.done)
            self.world.close()


@cache
def _kinds() -> tuple[Message, ...]:
    return inputs.one_of_each()


def _rising(messages: list[Any]) -> list[Any]:
    """Messages a second apart, no further than the wire carries."""
    return [
        replace(
            message,
            time_ns=min(message.time_ns + number * SECOND_NS, drawn.LAST_NS),
            sequence=(message.sequence + number) % (1 << 32),
        )
        for number, message in enumerate(messages)
    ]


def _spoilt(raw: bytes, at: int, *, cut: bool) -> bytes:
    """Bytes that end early, or of which one bit is another."""
    place = at % len(raw)
    return raw[:place] if cut else raw[:place] + bytes([raw[place] ^ 1 << at % 8]) + raw[place + 1 :]


def rules_of(method: str, flights_s: tuple[int, int, int] = SHORT_S, line: str = "loop") -> type[Rules]:
    """The machine of one method, over one link."""
    own = {"method": method, "total": Counter(), "flights_s": flights_s, "line": line}
    return type(f"Rules_{method.replace('-', '_')}", (Rules,), own)
