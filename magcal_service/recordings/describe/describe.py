"""A raw log described: read a sample of it, conclude what names and numbers agree on, ask the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from magcal_service.base.errors import Fault, InputRefusedError, RecordingError, printable
from magcal_service.base.typed_toml import nearest
from magcal_service.base.typed_toml.parse import parse_toml
from magcal_service.recordings.describe.attitude import find_attitude
from magcal_service.recordings.describe.columns import Log, read_log, triples
from magcal_service.recordings.describe.contradictions import doubt_model, warn_of_unit
from magcal_service.recordings.describe.draft import Answers, Draft, Question
from magcal_service.recordings.describe.expected import expected_nt
from magcal_service.recordings.describe.layout import Layout, find_layout
from magcal_service.recordings.describe.magnetometer import find_magnetometers
from magcal_service.recordings.describe.order_by_field import doubt_order
from magcal_service.recordings.describe.place import Place, find_place
from magcal_service.recordings.describe.reference import find_reference
from magcal_service.recordings.describe.sample import read_sample
from magcal_service.recordings.describe.spin import find_spin
from magcal_service.recordings.describe.telemetry import find_channels, left_out
from magcal_service.recordings.describe.times import find_times
from magcal_service.recordings.describe.untold import tell
from magcal_service.recordings.descriptor import descriptor_of
from magcal_service.recordings.specs import DESCRIPTOR_NAME

_SHOWN = 12  # columns that are named where many are left out
_ORDER = ("time", "magnetometer", "reference", "position", "platform", "spin", "channels")


@dataclass(frozen=True, slots=True)
class Described:
    """What became of a log.

    Parameters
    ----------
    said: what was concluded, each with its evidence.
    questions: what is open; those that are ``needed`` have to be answered first.
    text: the descriptor; None where something has to be answered first.
    """

    said: tuple[str, ...]
    questions: tuple[Question, ...]
    text: str | None

    @property
    def needed(self) -> tuple[Question, ...]:
        """Questions without whose answers there is no descriptor."""
        return tuple(question for question in self.questions if question.needed)

    def lines(self) -> list[str]:
        """Conclusions and questions, as comments of the descriptor."""
        text = [*self.said, *(line for question in self.questions for line in question.lines())]
        return [f"# {printable(line)}" for line in text]


def describe(log: Path, answers: Mapping[str, str], beside: Path | None = None) -> Described:
    """Describe a raw log.

    Parameters
    ----------
    log: a text file of rows, ``.gz`` or not.
    answers: by key, as questions name them; an answer outweighs what was concluded.
    beside: the folder that the descriptor will lie in; the log's own where None.

    Raises
    ------
    RecordingError: the log is no text of rows.
    InputRefusedError: an answer is not understood, or not to a question of this log.
    """
    given = Answers(answers)
    sample = read_sample(log)
    layout = find_layout(sample, _delimiter(given), _decimal(given))
    table = read_log(sample, layout)
    if table.rows < 2:
        accepted = "two rows of numbers at least are accepted"
        raise InputRefusedError([Fault(str(log), f"{table.rows} rows", accepted)])
    draft = Draft(table, given, beside or log.parent)
    _samples(draft)
    _fill(draft)
    unused = given.unused()
    if unused:
        accepted = "nothing of this log asks for it; leave it out"
        raise InputRefusedError([Fault("--answer", key, accepted) for key in unused])
    needed = any(question.needed for question in draft.questions)
    text = None if needed else _text(draft)
    if text is not None:  # an answer may be none that a descriptor can hold
        out = draft.folder / DESCRIPTOR_NAME
        descriptor_of(parse_toml(text.encode(), str(log), "the descriptor by these answers", RecordingError), out)
    return Described(tuple(draft.said), tuple(draft.questions), text)


def _fill(draft: Draft) -> None:
    groups = triples(draft.log)
    times = find_times(draft)
    draft.reserved |= set(times.columns) if times else set()
    place = find_place(draft, times, groups)
    draft.reserved |= set(place.columns) if place else set()
    model_nt = expected_nt(times, place)
    magnetometers = find_magnetometers(draft, groups, model_nt)
    field = magnetometers[0].field_nt if magnetometers else None
    draft.reserved |= {c.number for one in magnetometers for c in one.triple.columns}
    find_reference(draft, groups, magnetometers, times, place)
    warn_of_unit(draft, magnetometers, model_nt)
    doubt_model(draft, magnetometers, place, model_nt)
    doubt_order(draft, times, place, magnetometers)
    _leave_out_position(draft, place)
    tell(draft)
    find_spin(draft, field, times)
    draft.reserved |= find_attitude(draft, field, place)
    find_channels(draft, groups, field, times)
    rest = left_out(draft)
    if rest:
        shown = ", ".join(rest[:_SHOWN]) + (f" and {len(rest) - _SHOWN} more" if len(rest) > _SHOWN else "")
        draft.said.append(f"not described: {shown}; --answer channels.NAME.columns=... takes one up")


def _leave_out_position(draft: Draft, place: Place | None) -> None:
    """A position without its altitude is none to the reader; where the reference does not need it, it may stay out."""
    pending = {question.key for question in draft.questions if question.needed}
    if place is None or not place.altitude_open or pending & {"position.altitude_km", "position.altitude.unit"}:
        return
    if draft.sections.pop("position", None) is not None:
        asks = "no column says how high it was, and a position needs that"
        draft.ask(Question("position.altitude_km", asks, (), "0.2", needed=False))


def _delimiter(given: Answers) -> str | None:
    answer = given.get("samples.delimiter")
    known = {"\\t": "\t", "tab": "\t", "comma": ",", "semicolon": ";", "pipe": "|", "blanks": "whitespace"}
    answer = known.get(answer or "", answer)
    if answer is not None and answer not in {",", ";", "\t", "|", "whitespace"}:
        accepted = nearest(answer, ("comma", "semicolon", "tab", "pipe", "whitespace"))
        raise InputRefusedError([Fault("--answer samples.delimiter", answer, accepted)])
    return answer


def _decimal(given: Answers) -> str | None:
    answer = given.get("samples.decimal")
    if answer is not None and answer not in {".", ","}:
        raise InputRefusedError([Fault("--answer samples.decimal", answer, '"." or "," is accepted')])
    return answer


def _samples(draft: Draft) -> None:
    """``[samples]``: only what differs from a plain CSV file."""
    log, layout = draft.log, draft.log.layout
    draft.put("samples", "file", draft.beside(log.sample.path))
    if layout.delimiter != ",":
        draft.put("samples", "delimiter", layout.delimiter)
    if layout.decimal != ".":
        draft.put("samples", "decimal", layout.decimal)
    if layout.comment:
        draft.put("samples", "comment", layout.comment)
    if layout.skip_lines:
        draft.put("samples", "skip_lines", layout.skip_lines)
    if not layout.header:
        draft.put("samples", "header", False)
    draft.said.append(_form(log, layout))
    draft.said += [f"samples: {remark}" for remark in layout.remarks]


def _form(log: Log, layout: Layout) -> str:
    read = "all" if log.sample.whole else "a part"
    cut = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "|", "whitespace": "blanks"}[layout.delimiter]
    text = f"samples: {len(layout.names)} columns cut by {cut}, decimal {layout.decimal!r}"
    if layout.comment:
        text += f", comments after {layout.comment!r}"
    if layout.skip_lines:
        text += f", {layout.skip_lines} lines before them"
    return f"{text} ({log.rows} rows looked at, {read} of {log.sample.size} bytes read)"


def _text(draft: Draft) -> str:
    """The descriptor as TOML."""
    lines = ["version = 1", "", "[samples]", *draft.sections["samples"]]
    for name in _ORDER:
        for section, content in draft.sections.items():
            if section == name:
                lines += ["", f"[{name}]", *content]
            elif section.startswith(f"[{name}]"):
                lines += ["", f"[[{name}]]", *content]
    return "\n".join(lines) + "\n"
