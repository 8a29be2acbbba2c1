"""Concealed cases of any simulators: is the right physics named, and are claimed probabilities and sigmas true?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from typing import Final

from magcal_service.many.pieces import Piece
from magcal_service.offline.each import inputs_of
from magcal_service.studies.cases.ask import UNKNOWN, ask, said_of
from magcal_service.studies.cases.folders import cases_of
from magcal_service.studies.cases.score import Bin, Scored, all_distances, claims_of, reliability, share
from magcal_service.studies.cases.truth import GROUPS, LEAST_DETECTABILITY
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study

SURE: Final = 0.95
"""Claimed probability from which a name may be trusted (docs/diagnosis.md)."""

_ALL: Final = "all"
_MOST_ODDS: Final = 1e4
"""Where a claim is drawn that is nearer to 1; choice: a tenth of the last bin's width."""

_SHORT: Final = 60  # letters of a reason in a table


def run(request: Request) -> Findings:
    """Diagnose every case of the folders, one piece each, and compare with the answers.

    Raises ``ConfigError`` for a folder that holds no cases with their answers.
    """
    cases = cases_of(request.recordings)
    pieces = [Piece(f"{one.simulator}/{one.name}", ask, one.path, inputs_of(one.path)) for one in cases]
    outcomes = request.executor.outcomes("concealed cases", pieces)
    said = [
        Scored(case.simulator, case.name, case.truth, said_of(outcome, case.path))
        for case, outcome in zip(cases, outcomes, strict=True)
    ]
    scored = [one for one in said if one.truth.counts]
    return Findings(
        tables=tables(scored),
        figures=figures(scored),
        settings={
            "simulators": ", ".join(dict.fromkeys(one.simulator for one in cases)),
            "cases": len(cases),
            "scored": len(scored),
            "least detectability": LEAST_DETECTABILITY,
        },
        notes=_NOTES,
        panels=panels(scored),
    )


def tables(scored: Sequence[Scored]) -> tuple[Table, ...]:
    """Everything that is counted."""
    return (
        _asked(scored),
        _grouped("By regime", ("simulator", "regime"), scored, lambda one: (one.simulator, one.truth.regime)),
        _grouped("By what was put in", ("put in",), scored, lambda one: (one.truth.put_in,)),
        _false_names(scored),
        _reliability(scored),
        _parameters(scored),
        _times(scored),
        _misses(scored),
    )


def _asked(scored: Sequence[Scored]) -> Table:
    table = _grouped(
        "By simulator and what was asked",
        ("simulator", "asked"),
        scored,
        lambda one: (one.simulator, one.truth.group),
    )
    simulators = list(_simulators(scored))
    rows = sorted(table.rows, key=lambda row: (simulators.index(str(row[0])), GROUPS.index(str(row[1]))))
    return Table(table.title, table.columns, tuple(rows))


def _grouped(
    title: str, heads: tuple[str, ...], scored: Sequence[Scored], key: Callable[[Scored], tuple[str, ...]]
) -> Table:
    counted = ("cases", "right", "or in its class", "unknown", "with a false name", "trusted", "trusted, false name")
    groups: dict[tuple[str, ...], list[Scored]] = {}
    for one in scored:
        groups.setdefault(key(one), []).append(one)
    rows: list[tuple[Cell, ...]] = [(*name, *_counts(group)) for name, group in sorted(groups.items())]
    return Table(title, (*heads, *counted), tuple(rows))


def _counts(group: Sequence[Scored]) -> tuple[int, ...]:
    trusted = [one for one in group if one.said.trusted]
    return (
        len(group),
        sum(one.is_right for one in group),
        sum(one.is_in_class for one in group),
        sum(one.said.verdict == UNKNOWN for one in group),
        sum(bool(one.false) for one in group),
        len(trusted),
        sum(bool(one.false) for one in trusted),
    )


def _simulators(scored: Sequence[Scored]) -> dict[str, list[Scored]]:
    groups: dict[str, list[Scored]] = {}
    for one in scored:
        groups.setdefault(one.simulator, []).append(one)
    return groups


def _together(scored: Sequence[Scored]) -> dict[str, Sequence[Scored]]:
    """All cases, then each simulator's; one simulator alone is all there is."""
    each = _simulators(scored)
    return {_ALL: scored, **(each if len(each) > 1 else {})}


def _false_names(scored: Sequence[Scored]) -> Table:
    """Names that are false: of clean cases, of all, and of those that may be acted on (the command ends with 0)."""
    rows: list[tuple[Cell, ...]] = []
    for simulator, every in _together(scored).items():
        parts = {
            "clean": [one for one in every if one.truth.kind == "clean"],
            "all": every,
            "exit 0": [one for one in every if one.said.trusted],
        }
        for name, group in parts.items():
            names, false = sum(len(one.said.names) for one in group), sum(len(one.false) for one in group)
            rows.append((simulator, name, len(group), sum(bool(one.false) for one in group), names, false))
    columns = ("simulator", "of", "cases", "with a false name", "names", "false names")
    return Table("False names", columns, tuple(rows))


def _reliability(scored: Sequence[Scored]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (simulator, f"{one.low:g} to {one.high:g}", one.names, one.mean, one.share, *(one.interval or (None, None)))
        for simulator, group in _together(scored).items()
        for one in reliability(group)
    ]
    columns = ("simulator", "claimed", "names", "mean claim", "true", "from (95 %)", "to (95 %)")
    return Table("Reliability: claimed probability against share true", columns, tuple(rows))


def _parameters(scored: Sequence[Scored]) -> Table:
    """Components within 1, 2 and 3 sigma (a right sigma has 0.683, 0.954 and 0.997), by effect and parameter."""
    rows: list[tuple[Cell, ...]] = [
        (name, len(z), *(share(_within(z, limit), len(z)) for limit in (1.0, 2.0, 3.0)), max(z, default=None))
        for name, z in all_distances(scored).items()
    ]
    columns = ("parameter", "components", "within 1 sigma", "within 2 sigma", "within 3 sigma", "largest [sigma]")
    return Table("Parameters of right names", columns, tuple(rows))


def _within(z: Sequence[float], limit: float) -> int:
    return sum(value < limit for value in z)


def _times(scored: Sequence[Scored]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for simulator, group in _together(scored).items():
        used = sorted(
            (one.said.processor_s, f"{one.simulator}/{one.case}") for one in group if one.said.processor_s is not None
        )
        if used:
            rows.append((simulator, median(seconds for seconds, _ in used), used[-1][0], used[-1][1]))
    return Table("Processor time of a diagnosis [s]", ("simulator", "median", "worst", "of"), tuple(rows))


def _misses(scored: Sequence[Scored]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for one in scored:
        if not one.is_right or one.false:
            put = " + ".join(effect.effect for effect in one.truth.effects) or "nothing"
            named = ", ".join(f"{e.effect} {e.probability:.4f}" for e in one.said.named if e.effect != UNKNOWN)
            reason = f" ({one.said.reasons[0][:_SHORT]})" if one.said.reasons else ""
            asked = (one.truth.regime, put, round(one.truth.detectability, 1), one.truth.group)
            said = (f"{one.said.verdict}{reason}", named or None, _exit(one))
            rows.append((one.simulator, one.case, *asked, *said))
    columns = ("simulator", "case", "regime", "put in", "detectability", "asked", "said", "named", "exit")
    return Table("Every case that is not right, or has a false name", columns, tuple(rows))


def _exit(one: Scored) -> int:
    """What the command would have ended with."""
    return {"refused": 2, "failed": 1}.get(one.said.verdict, 0 if one.said.trusted else 3)


def panels(scored: Sequence[Scored]) -> tuple[Panel, ...]:
    """The reliability of all cases and of each simulator's, where anything is named."""
    drawn = [
        (simulator, [one for one in reliability(group) if one.names]) for simulator, group in _together(scored).items()
    ]
    return tuple(_diagram(simulator, bins) for simulator, bins in drawn if bins)


def _diagram(simulator: str, bins: Sequence[Bin]) -> Panel:
    """Share true over the claim in odds, on which 0.9 and 0.99 lie as far apart as 0.99 and 0.999."""
    x = tuple(_odds(one.mean or 0.0) for one in bins)
    ends = [one.interval or (0.0, 1.0) for one in bins]
    steps = [10.0 ** (k / 10.0) for k in range(-10, 41)]
    return Panel(
        f"{simulator} (names: {sum(one.names for one in bins)})",
        "claimed probability, in odds to one (9 is 0.9, 99 is 0.99)",
        "share true",
        (
            Line("as claimed", tuple(steps), tuple(odds / (1.0 + odds) for odds in steps), limit=True),
            Line("true", x, tuple(one.share or 0.0 for one in bins)),
            Line("95 % interval, from", x, tuple(low for low, _ in ends)),
            Line("95 % interval, to", x, tuple(high for _, high in ends)),
        ),
        log_x=True,
    )


def _odds(p: float) -> float:
    """Odds to one, within what is drawn."""
    least = 1.0 / (1.0 + _MOST_ODDS)
    p = min(max(p, least), 1.0 - least)
    return p / (1.0 - p)


def figures(scored: Sequence[Scored]) -> dict[str, Cell]:
    """The few numbers that the study is for, over all simulators; every share is of what was counted there."""
    found: dict[str, Cell] = {}
    for name in GROUPS:
        group = [one for one in scored if one.truth.group == name]
        if group:
            found[f"right: {name}"] = share(sum(one.is_right for one in group), len(group))
    trusted = [one for one in scored if one.said.trusted]
    sure = [true for p, true in claims_of(scored) if p >= SURE]
    z = all_distances(scored)[_ALL]
    return {
        **found,
        "exit 0: cases": len(trusted),
        "exit 0: share with a false name": share(sum(bool(one.false) for one in trusted), len(trusted)),
        f"claimed at {SURE:g} or more: names": len(sure),
        f"claimed at {SURE:g} or more: share true": share(sum(sure), len(sure)),
        "parameters: components": len(z),
        "parameters: share within 1 sigma": share(_within(z, 1.0), len(z)),
        "parameters: share within 2 sigma": share(_within(z, 2.0), len(z)),
    }


_NOTES: Final = (
    "A simulator is a folder of cases, by its name; none shares code with the catalogue.  The answers lie beside the "
    "cases and are no input of the diagnosis.",
    "Counted are clean cases, and those whose effects have a detectability of at least 12: norm of the noise-free "
    "change of the scalar residual, with the nine errors' columns projected out, over the noise.",
    "Right: of clean cases no false name; in no catalogue: the verdict unknown; otherwise a right name first, and of "
    "several effects all of them.  Or in its class: right, or the effect is in the class of the first name.",
    "A false name is one that was neither put in nor is true besides (a despin makes spin_rate true).  Trusted is a "
    "diagnosis that ends with 0.  Parameters of right sigmas are within 1, 2 and 3 of them in 0.683, 0.954 and 0.997.",
)

STUDY = Study("concealed", "Concealed cases: is what is named true, and as probable as it claims?", 0, run)
