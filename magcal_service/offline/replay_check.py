"""Does this version, fed what a session received, say what was said then?  A replay beside the recorded estimates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.offline.replay import craft_of, replay
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.session import decoded
from magcal_service.recordings.session_arrays import session_recording
from magcal_service.wire.messages import Estimate, Message

_ESTIMATES: Final = frozenset({"estimate"})


@dataclass(frozen=True, slots=True)
class Check:
    """How a replay compares with what was recorded.

    Parameters
    ----------
    craft: whose.
    recorded, replayed: estimates there were, and are.
    equal: recorded ones that the replay gives again at their place, to the last bit.
    difference: the first that it does not, in words; empty where there is none.
    """

    craft: str
    recorded: int
    replayed: int
    equal: int
    difference: str

    @property
    def same(self) -> bool:
        """Whether every recorded estimate came again."""
        return 0 < self.recorded == self.equal

    def __str__(self) -> str:
        told = f"{self.craft}: {self.equal} of {self.recorded} recorded estimates came again, to the last bit"
        return f"{told}\nfirst difference: {self.difference}" if self.difference else told


def check_session(path: Path, craft: str | None = None) -> Check:
    """Replay one craft of a session under its recorded configuration and compare.

    The service numbers its estimates and status messages together, and how many of the latter there are is a matter of
    wall time: sequence numbers are not compared.  A replay closes the last ticks, so it may have more at the end.

    Raises ``RecordingError`` as ``read_recording``, and where the session does not hold its configuration.
    """
    recording = session_recording(path, craft=craft)
    if recording.craft is None:
        accepted = "a session with its configuration is accepted; give one with: magcal replay --config"
        raise RecordingError([Fault(str(path), "no configuration", accepted)])
    name = recording.craft.name
    recorded = _recorded(path, name)
    replayed: list[Estimate] = []

    def keep(message: Message) -> None:
        if isinstance(message, Estimate):
            replayed.append(replace(message, sequence=0))

    replay(recording, craft_of(recording), sink=keep, as_recorded=True)
    pairs = list(zip(recorded, replayed, strict=False))
    differing = [number for number, (one, other) in enumerate(pairs) if repr(one) != repr(other)]
    difference = f"tick {pairs[differing[0]][0].tick}: {_difference(*pairs[differing[0]])}" if differing else ""
    if not difference and len(recorded) > len(replayed):
        difference = f"tick {recorded[len(replayed)].tick}: the replay has no estimate any more"
    return Check(name, len(recorded), len(replayed), len(pairs) - len(differing), difference)


def _recorded(path: Path, craft: str) -> Sequence[Estimate]:
    refused: dict[str, Counter[str]] = {}
    with path.open("rb") as file:
        found = list(decoded(McapReader(file, str(path)), refused, _ESTIMATES))
    return [replace(one, sequence=0) for name, one in found if name == craft and isinstance(one, Estimate)]


def _difference(recorded: Estimate, replayed: Estimate) -> str:
    """The first field that differs."""
    for field in fields(Estimate):
        one: Any = getattr(recorded, field.name)
        other: Any = getattr(replayed, field.name)
        if repr(one) != repr(other):
            return f"{field.name} was {one!r}, is {other!r}"
    return "nothing"
