"""All that has been heard of every craft, as state that pages and terminals show: messages in, plain data out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from magcal_service.config.magnetometers import label_of
from magcal_service.views.field import FieldView, ReferenceField
from magcal_service.views.pulse import Pulse
from magcal_service.views.result import Replayed, ResultView
from magcal_service.wire.messages import (
    CalibratedVector,
    Command,
    CommandReply,
    Estimate,
    MagnetometerSample,
    Message,
    ReferenceSample,
    Status,
)

_MOST_CRAFT: Final = 64  # choice: what a list on a page holds
_MOST_SOURCES: Final = 8  # magnetometers of one craft; each takes about 1.5 MB
_BACK_S: Final = 60.0  # vectors that lie so far before the newest one are a new beginning, such as a restarted node


class CraftView:
    """One craft: its reference, the samples of each source, the results of each magnetometer."""

    def __init__(self, name: str, recording: Replayed | None) -> None:
        self.name = name
        self.start_ns: int | None = None
        self.reference = ReferenceField()
        self.fields: dict[str, FieldView] = {}
        self.results: dict[str, ResultView] = {}
        self.pulse = Pulse()
        self.recording = recording

    def take(self, message: Message, now_s: float) -> None:
        """Take a message of this craft, heard at ``now_s`` [s] of the reader's own clock."""
        if isinstance(message, CalibratedVector | Estimate | Status):
            self.pulse.beat(now_s)
        match message:
            case MagnetometerSample():
                if field := self._field(message):
                    field.sample(message)
            case CalibratedVector():
                self._begin_anew(message)
                if field := self._field(message):
                    field.vector(message)
                    field.pulse.beat(now_s)
            case ReferenceSample():
                self.reference.add(message)
                for field in self.fields.values():
                    field.settle()
            case Estimate() | Status():
                self._result(label_of(message), message)
            case CommandReply():
                self._result(self.name, message)

    def _begin_anew(self, vector: CalibratedVector) -> None:
        """Forget samples and reference where time has gone back: a plot of two times would show neither."""
        field = self.fields.get(vector.source)
        if field is not None and field.newest_ns - vector.time_ns > _BACK_S * 1e9:
            self.reference, self.fields, self.start_ns = ReferenceField(), {}, None

    def _field(self, message: MagnetometerSample | CalibratedVector) -> FieldView | None:
        if message.source not in self.fields and len(self.fields) < _MOST_SOURCES:
            if self.start_ns is None:
                self.start_ns = message.time_ns
            self.fields[message.source] = FieldView(self.reference, self.start_ns)
        return self.fields.get(message.source)

    def _result(self, label: str, message: Estimate | Status | CommandReply) -> None:
        if label not in self.results and len(self.results) < _MOST_SOURCES:
            self.results[label] = ResultView(self.recording)
        if label in self.results:
            self.results[label].take(message)

    def field_of(self, label: str) -> FieldView | None:
        """The samples of a magnetometer; those of the craft's own are the first that no other's results name."""
        source = label.removeprefix(self.name).removeprefix("/")
        if source:
            return self.fields.get(source)
        return next((field for name, field in self.fields.items() if f"{self.name}/{name}" not in self.results), None)


@dataclass(frozen=True, slots=True)
class Magnetometer:
    """One magnetometer that can be looked at: its label, the craft it is on, its results."""

    label: str
    craft: CraftView
    result: ResultView


class Views:
    """Every craft that has been heard.

    Parameters
    ----------
    recordings: what is being replayed, by the name of the craft; empty for a live link.

    Anybody may call on the link, so craft and sources are counted: beyond a limit, new names are left out.
    """

    def __init__(self, recordings: Mapping[str, Replayed] = MappingProxyType({})) -> None:
        self.crafts: dict[str, CraftView] = {}
        self._recordings = recordings

    def take(self, message: Message, now_s: float) -> None:
        """Take a message that was heard at ``now_s`` [s] of the reader's own clock; commands of others are no news."""
        if isinstance(message, Command):
            return
        craft = self.crafts.get(message.craft)
        if craft is None:
            if len(self.crafts) >= _MOST_CRAFT:
                return
            craft = CraftView(message.craft, self._recordings.get(message.craft))
            self.crafts[message.craft] = craft
        craft.take(message, now_s)

    def magnetometers(self) -> list[Magnetometer]:
        """All that can be looked at, by label; a craft of which only samples were heard is one without results."""
        found = []
        for name, craft in self.crafts.items():
            results = craft.results or {name: ResultView(craft.recording)}
            found += [Magnetometer(label, craft, result) for label, result in results.items()]
        return sorted(found, key=lambda one: one.label)

    def find(self, label: str) -> Magnetometer | None:
        """The magnetometer of a label, else the first one; None before any is heard."""
        every = self.magnetometers()
        return next((one for one in every if one.label == label), every[0] if every else None)

    def listed(self, now_s: float) -> list[dict[str, Any]]:
        """Label, craft, verdict and freshness of the results of every magnetometer."""
        return [
            {
                "label": one.label,
                "craft": one.craft.name,
                "verdict": str(one.result.verdict),
                **one.craft.pulse.shown(now_s),
            }
            for one in self.magnetometers()
        ]
