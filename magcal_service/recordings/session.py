"""A recorded session (MCAP) as a recording: the messages as they came in, and the arrays that offline work needs.

A replay takes the messages, so it is the live run again, with the configuration that the session was recorded under.
Offline work takes the arrays: one row a magnetometer sample, in the order of recording, and what has its own rate
interpolated to it by the rules of ``series``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import ConfigError, DecodeError, Fault, FileFault, RecordingError
from magcal_service.base.typed_toml import nearest
from magcal_service.config.settings import CraftConfig
from magcal_service.config.text import craft_from_toml
from magcal_service.recordings.json_form import from_json
from magcal_service.recordings.mcap import CRAFT, DROPPED, MOST_MISSING, PROFILE, STATE, dropped_messages
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.state_text import state_from_text
from magcal_service.wire.kinds import FIRST_RESULT, KINDS
from magcal_service.wire.messages import Command, CommandReply, Message

_KINDS: Final = {kind.name: kind for kind in KINDS}
_INPUTS: Final = frozenset(kind.name for kind in KINDS if kind.code < FIRST_RESULT or kind.name == "command")
"""What comes in: samples, and commands, which change what becomes of them."""


@dataclass(frozen=True, slots=True)
class Session:
    """What one file holds of one craft.

    Parameters
    ----------
    craft: its name.
    configuration: as it was while the session was recorded; None where the file does not say.
    messages: everything that came in, in the order in which it did, but for commands that were refused.
    refused: records that are no acceptable message, by reason.
    dropped: messages that the recorder had to leave out, and those that are gone where the file is damaged.
    damage: why the file could not be read to its end, empty where it could.
    state: what the craft began with, as ``Pipeline.export_state`` gives it; None where that was nothing.
    beside: the same of magnetometers beside the craft's own, by source.
    """

    craft: str
    configuration: CraftConfig | None
    messages: tuple[Message, ...]
    refused: Counter[str]
    dropped: int
    damage: str
    state: dict[str, Any] | None
    beside: dict[str, dict[str, Any]]


@dataclass(slots=True)
class _Found:
    """What was read so far."""

    limits: RowLimits
    messages: dict[str, list[Message]] = field(default_factory=dict)
    refused: dict[str, Counter[str]] = field(default_factory=dict)
    states: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    held: int = 0

    def take(self, craft: str, message: Message, reader: McapReader) -> None:
        """Keep what came in, but for commands that were refused: they would not be where checkpoints are other ones."""
        if isinstance(message, CommandReply):
            came = self.messages.get(craft, [])
            if came and _refused(came[-1], message):
                came.pop()
            return
        if craft not in self.messages:
            self.states[craft] = _states(reader, craft)
        self.messages.setdefault(craft, []).append(message)
        self.held += 1
        self.limits.check_messages(reader.name, self.held)


def _refused(command: Message, reply: CommandReply) -> bool:
    """Whether this is the answer to this command, which it follows at once, and says no."""
    answers = (command.source, command.sequence) == (reply.command_source, reply.command_sequence)
    return isinstance(command, Command) and answers and not reply.accepted


def read_session(
    path: Path, craft: str | None = None, prefer: str | None = None, limits: RowLimits | None = None
) -> Session:
    """Read one craft's part of a session file.

    Parameters
    ----------
    craft: whose; may be left out where the file has one craft.
    prefer: whose where none is named and the file has several.
    limits: the most messages that are taken; those of a log in rows where not given.

    Raises ``RecordingError`` where the file cannot be read, was not made by this service, has nothing of that craft,
    is beyond the limits, or where it has several craft and none is named.
    """
    try:
        with path.open("rb") as file:
            reader = McapReader(file, str(path))
            found = _Found(limits or RowLimits())
            for name, message in decoded(reader, found.refused, _INPUTS | {"reply"}):
                found.take(name, message, reader)
    except OSError as error:
        raise RecordingError([FileFault(str(path), error, "give a readable recording")]) from None
    name = _chosen(path, list(found.messages), craft, prefer)
    configurations, dropped = _metadata(reader)
    dropped = min(dropped + reader.gone, MOST_MISSING)
    damage = reader.damage
    if reader.bad_chunks or reader.bad_records:
        damage = ", ".join(
            filter(None, (damage, f"{reader.bad_chunks} chunks and {reader.bad_records} records spoilt"))
        )
    return Session(
        craft=name,
        configuration=configurations.get(name),
        messages=tuple(found.messages[name]),
        refused=found.refused.get(name, Counter()),
        dropped=dropped,
        damage=damage,
        state=found.states[name].get(""),
        beside={source: state for source, state in found.states[name].items() if source},
    )


def decoded(
    reader: McapReader, refused: dict[str, Counter[str]], kinds: frozenset[str] = frozenset(_KINDS)
) -> Iterator[tuple[str, Message]]:
    """Craft and message of every record of some kinds, in order; those that are none are counted in ``refused``."""
    for raw in reader.messages():
        if reader.profile != PROFILE:
            accepted = "a recording made by magcal is accepted; describe another program's log as .csv"
            raise RecordingError([Fault(reader.name, f"profile {reader.profile!r}", accepted)])
        craft, kind = raw.topic.craft, _KINDS.get(raw.topic.kind)
        if kind is None or kind.name not in kinds:
            continue
        try:
            message = from_json(kind, raw.data)
            if message.craft != craft:
                raise DecodeError("wrong_craft", f"{message.craft!r} on the channel of {craft!r}")
        except DecodeError as error:
            refused.setdefault(craft, Counter())[error.reason] += 1
            continue
        yield craft, message


def _chosen(path: Path, names: Sequence[str], craft: str | None, prefer: str | None) -> str:
    if not names:
        raise RecordingError([Fault(str(path), "no samples", "a recording with samples is accepted")])
    if craft is None and len(names) == 1:
        return names[0]
    wanted = prefer if craft is None else craft
    if wanted is not None and wanted in names:
        return wanted
    if craft is None:
        accepted = f"choose one with --craft NAME or samples.craft: {', '.join(sorted(names))}"
        raise RecordingError([Fault(str(path), f"{len(names)} craft", accepted)])
    raise RecordingError([Fault(f"{path}: craft", craft, nearest(craft, names))])


def _metadata(reader: McapReader) -> tuple[dict[str, CraftConfig], int]:
    """The crafts' configurations and the messages dropped; a configuration that cannot be read says nothing."""
    configurations: dict[str, CraftConfig] = {}
    dropped = 0
    for name, content in reader.metadata:
        if name == CRAFT:
            craft = _configuration(content)
            if craft is not None:
                configurations[craft.name] = craft
        elif name == DROPPED:
            dropped += dropped_messages(content)
    return configurations, dropped


def _states(reader: McapReader, craft: str) -> dict[str, dict[str, Any]]:
    """The states that stand before the craft's first message, by source; those further on are of a later session."""
    texts: dict[str, str] = {}
    for name, content in reader.metadata:
        if name == STATE and content.get("craft") == craft:
            texts.setdefault(content.get("source", ""), content.get("state", ""))
    states = {source: state_from_text(text) for source, text in texts.items()}
    return {source: state for source, state in states.items() if state is not None}


def _configuration(content: dict[str, str]) -> CraftConfig | None:
    try:
        craft = craft_from_toml(content.get("configuration", ""), "recorded configuration")
    except ConfigError:  # of another version
        return None
    return craft
