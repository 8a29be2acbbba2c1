"""Real recordings: what the diagnosis says of each, held against what is known of it from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from magcal_service.many.pieces import Done, Outcome, Piece, Refused
from magcal_service.offline.each import inputs_of
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.catalogue import catalogue
from magcal_service.studies.real.ask import Answer, Named, SharedNumber, answer
from magcal_service.studies.real.plan import Known, Question, questions_of
from magcal_service.studies.report import Cell, Findings, Table
from magcal_service.studies.study import Request, Study


@dataclass(frozen=True, slots=True)
class Row:
    """A question with its answer, or with the text of what came in its place."""

    question: Question
    answer: Answer | None
    text: str = ""

    @property
    def trusted(self) -> bool:
        """Whether the diagnosis ended with 0."""
        return self.answer is not None and self.answer.trusted

    @property
    def names(self) -> tuple[str, ...]:
        """The physics that was named; noise with a memory explains nothing and is no name."""
        noise = {effect.name for effect in catalogue() if effect.acts_on is ActsOn.NOISE}
        named = () if self.answer is None else self.answer.named
        return tuple(one.effect for one in named if one.effect not in noise)

    @property
    def false(self) -> tuple[str, ...]:
        """Names that are trusted and known to be false."""
        return tuple(name for name in self.names if self.trusted and self.question.known.is_false(name))


def run(request: Request) -> Findings:
    """Ask everything of the recordings in the folders; one piece a question.

    Raises ``ConfigError`` for a folder that is not there or holds no descriptor.
    """
    questions = questions_of(request.recordings)
    pieces = [
        Piece(_called(one), answer, one, tuple(file for path in one.paths for file in inputs_of(path)), len(one.paths))
        for one in questions
    ]
    outcomes = request.executor.outcomes("real recordings", pieces)
    rows = [_row(question, outcome) for question, outcome in zip(questions, outcomes, strict=True)]
    together = [row for row in rows if row.answer is not None and row.answer.predicted]
    return Findings(
        tables=(_every(rows), *([_shared(together), _predicted(together)] if together else [])),
        figures=_figures(rows),
        settings={"questions": len(rows), "recordings": len({path for one in questions for path in one.paths})},
        notes=_NOTES,
    )


def _called(question: Question) -> str:
    return f"{question.name} without {', '.join(question.hidden)}" if question.hidden else question.name


def _row(question: Question, outcome: Outcome) -> Row:
    if isinstance(outcome, Done):
        return Row(question, outcome.value)
    text = outcome.text.partition("\n")[0]
    for path in question.paths:  # where it lies is said by the name
        text = text.replace(f"{path.parent}/", "")
    return Row(question, None, f"{'refused' if isinstance(outcome, Refused) else 'failed'}: {text}")


def _every(rows: Sequence[Row]) -> Table:
    """Every recording: what was said, and what is known."""
    columns = (
        "recording",
        "hidden",
        "verdict",
        "trusted, or the doubts",
        "effects (driver, probability)",
        "recalibrated [nT]",
        "with effects [nT]",
        "known cause",
        "witness",
        "false name",
        "processor [s]",
    )
    cells = [
        (row.question.name, ", ".join(row.question.hidden) or None, *_said(row), *_held_against(row), _seconds(row))
        for row in rows
    ]
    return Table("What is said of each recording, and what is known of it", columns, tuple(cells))


def _said(row: Row) -> tuple[Cell, ...]:
    found = row.answer
    if found is None:
        return row.text, None, None, None, None
    return (
        found.verdict,
        "trusted" if found.trusted else ", ".join(found.reasons),
        "; ".join(map(_named, found.named)) or None,
        round(found.recalibrated_nt, 1),
        round(found.with_effects_nt, 1),
    )


def _named(one: Named) -> str:
    from magcal_service.diagnosis.words import chance

    return f"{one.effect} ({'' if one.driver == 'none' else f'{one.driver}, '}{chance(one.probability)})"


def _held_against(row: Row) -> tuple[Cell, ...]:
    known = row.question.known
    return _known(known), known.witness, _false(row)


def _known(known: Known) -> str:
    return "not known" if known.causes is None else ", ".join(known.causes) or "nothing acts"


def _false(row: Row) -> str:
    if row.trusted and row.names and row.question.known.causes is None:
        return "not known"
    return ", ".join(row.false) or "no"


def _seconds(row: Row) -> Cell:
    return None if row.answer is None else round(row.answer.processor_s, 1)


def _shared(rows: Sequence[Row]) -> Table:
    """Numbers of recordings that were diagnosed together."""
    cells: list[tuple[Cell, ...]] = [
        (row.question.name, ", ".join(row.question.hidden) or None, one.effect, one.parameter, *_sized(one))
        for row in rows
        for one in (row.answer.shared if row.answer is not None else ())
    ]
    columns = ("recordings", "hidden", "effect", "number", "value", "1 sigma", "unit", "shared?")
    return Table("Recordings together: which numbers they share", columns, tuple(cells))


def _sized(one: SharedNumber) -> tuple[Cell, ...]:
    """Value and sigma, of a block their ranges, unit and agreement."""
    return _range(one.value), _range(one.sigma), one.unit, one.agreement


def _range(values: Sequence[float]) -> Cell:
    low, high = min(values), max(values)
    return low if low == high else f"{low:.3g} to {high:.3g}"


def _predicted(rows: Sequence[Row]) -> Table:
    """Each of the recordings that were diagnosed together, predicted from the others."""
    cells: list[tuple[Cell, ...]] = []
    for row in rows:
        for one in row.answer.predicted if row.answer is not None else ():
            levels = (round(level, 1) for level in (one.recalibrated_nt, one.predicted_nt, one.own_nt))
            kept = None if one.kept is None else round(100.0 * one.kept, 1)
            cells.append((one.recording, ", ".join(row.question.hidden) or None, *levels, kept))
    columns = ("recording", "hidden", "recalibrated [nT]", "predicted [nT]", "its own fit [nT]", "kept of its gain [%]")
    return Table("Recordings together: each predicted from the others", columns, tuple(cells))


def _figures(rows: Sequence[Row]) -> dict[str, Cell]:
    answered = [row for row in rows if row.answer is not None]
    caused = [row for row in answered if row.question.known.causes]
    first = [row for row in caused if row.names[:1] and row.names[0] in (row.question.known.causes or ())]
    unsure = [row for row in answered if _false(row) == "not known"]
    return {
        "no diagnosis": len(rows) - len(answered),
        "trusted": sum(row.trusted for row in rows),
        "false names with exit 0": sum(bool(row.false) for row in rows),
        "trusted names where no cause is known": len(unsure),
        "with a known cause": len(caused),
        "of these, known cause named first": len(first),
        "and trusted": sum(row.trusted for row in first),
        "most processor time of one recording [s]": max(
            (round(row.answer.processor_s, 1) for row in answered if row.answer and len(row.question.paths) == 1),
            default=None,
        ),
    }


_NOTES: Final = (
    "rms on blocks that took no part: with the nine errors fitted anew, and with the effects beside them; of several "
    "recordings together, over the rows of all.",
    "A false name is one that is trusted (exit 0) and not the known cause; where no cause is known, a trusted name is "
    "neither true nor false.  Noise with a memory explains nothing and counts as no name.",
    "Known causes and witnesses are written down in studies/real/plan.py, from what the recordings' publishers say and "
    "from channels that are hidden.",
)

STUDY = Study("reality", "Real recordings: is the name true where a cause is known, and how far does it go?", 0, run)
