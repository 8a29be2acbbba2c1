"""``python -m tests.regimes.score DIR [--workers 2]``: diagnose a folder of cases and compare with its answers.

Reads folders that ``python -m tests.regimes`` wrote, and those with one flat answer a case (``effect``,
``driver_concealed``, ``detectability`` and numbers).  What is true is opened once the cases have been diagnosed.
Prints tables and writes all of it as JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.cli.common import add_executor, executor_of
from magcal_service.diagnosis.answer import diagnose
from magcal_service.errors import MagcalError
from magcal_service.many.executor import Executor
from magcal_service.many.pieces import Done, Piece
from magcal_service.offline.each import inputs_of

LEAST_DETECTABILITY: Final = 12.0
"""Below it nobody can be asked to find an effect; cases below are diagnosed and counted in no table."""

PROBABILITIES: Final = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 1.0)
"""Edges of the bins of the reliability table; the last bin holds 1."""

SAID: Final = "said.jsonl"
"""File of a folder with each answer of the diagnosis, a line each."""

_UNKNOWN: Final = "unknown"
_NOTHING: Final = ("none", "clean")
_OUTSIDE: Final = "off_catalogue"
_NEARLY_STRUCTURE: Final = ("coloured_noise",)
"""Of flat answers: noise so slow that ``unknown`` is as right an answer as its name."""

_NO_ANSWER: Final = ("refused", "failed")


@dataclass(frozen=True, slots=True)
class Put:
    """One effect that was put in: name, parameters, and whether its driver was left out and can be guessed then."""

    effect: str
    parameters: Mapping[str, Any]
    concealed: bool = False
    inferable: bool = True


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of a case; ``kind`` is ``clean``, ``effect``, ``several`` or ``outside``.

    ``also`` are names that are true besides; ``unknown_is_right`` where that is what ought to be said,
    ``unknown_is_fair`` where structure without a name is there as well.
    """

    regime: str
    kind: str
    effects: tuple[Put, ...]
    also: tuple[str, ...]
    detectability: float
    unknown_is_right: bool = False
    unknown_is_fair: bool = False

    @property
    def names(self) -> set[str]:
        """What may be named."""
        return {effect.effect for effect in self.effects} | set(self.also)

    @property
    def group(self) -> str:
        """The row of the main table that the case belongs to."""
        if self.kind != "effect":
            return {"several": "three effects", "outside": "in no catalogue", "clean": "clean"}[self.kind]
        if not any(effect.concealed for effect in self.effects):
            return "driver recorded or none needed"
        guessed = all(effect.inferable for effect in self.effects)
        return "driver left out" if guessed else "driver left out, not to be guessed"


@dataclass(frozen=True, slots=True)
class Named:
    """One name of a diagnosis, with its claimed probability, its class, and parameters as value, sigma and unit."""

    effect: str
    probability: float
    members: tuple[str, ...]
    parameters: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Said:
    """What a diagnosis said of a case; ``trusted``: the command would have ended with 0.

    ``verdict`` is ``refused`` or ``failed`` where there is none, with the reason in ``reasons``.
    """

    case: str
    verdict: str
    trusted: bool
    reasons: tuple[str, ...]
    named: tuple[Named, ...] = ()
    processor_s: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that were named, in order."""
        return tuple(entry.effect for entry in self.named if entry.effect != _UNKNOWN)


@dataclass(frozen=True, slots=True)
class Scored:
    """A case with what is true and what was said of it."""

    truth: Truth
    said: Said

    @property
    def _true(self) -> set[str]:
        return {effect.effect for effect in self.truth.effects}

    @property
    def false(self) -> tuple[str, ...]:
        """Names that are not true."""
        return tuple(name for name in self.said.names if name not in self.truth.names)

    @property
    def first(self) -> Named | None:
        """The first name that is not merely true besides."""
        true, entries = self._true, [entry for entry in self.said.named if entry.effect != _UNKNOWN]
        return next((entry for entry in entries if entry.effect in true or entry.effect not in self.truth.also), None)

    @property
    def is_right(self) -> bool:
        """Clean: no false name.  Outside: ``unknown``.  Otherwise: a right name first, and all of them if several."""
        if self.said.verdict == _UNKNOWN and self.truth.unknown_is_right:
            return True
        if self.said.verdict in _NO_ANSWER or (self.said.verdict == _UNKNOWN and not self.truth.unknown_is_fair):
            return False
        if self.truth.kind == "clean":
            return not self.false
        return self.first is not None and self.first.effect in self._true and self._true <= set(self.said.names)

    @property
    def is_in_class(self) -> bool:
        """Right, or one effect was put in and is in the class of the first name."""
        if self.is_right or self.truth.kind != "effect" or self.said.verdict != "named" or self.first is None:
            return self.is_right
        return not self._true.isdisjoint(self.first.members)

    def distances(self) -> dict[str, list[float]]:
        """|value - truth| / sigma of each component of parameters that both give, by effect and parameter."""
        found: dict[str, list[float]] = {}
        for effect in self.truth.effects:
            entry = next((one for one in self.said.named if one.effect == effect.effect), None)
            for name, expected in {} if entry is None else effect.parameters.items():
                z = _distance(entry.parameters.get(name), expected) if entry is not None else []
                if z:
                    found[f"{effect.effect}.{name}"] = z
        return found


def _distance(given: Mapping[str, Any] | None, expected: Any) -> list[float]:
    if given is None:
        return []
    value = np.array(given["value"], dtype=np.float64)
    sigma, truth = np.array(given["sigma"], dtype=np.float64), np.array(expected, dtype=np.float64)
    if value.shape != truth.shape or sigma.shape != truth.shape or not np.all(sigma > 0.0):
        return []
    return [float(z) for z in np.ravel(np.abs(value - truth) / sigma)]


def read_answers(folder: Path) -> dict[str, Truth]:
    """The truth of each case of a folder, from either form of ``answers.json``."""
    answers = json.loads((folder / "answers.json").read_text(encoding="utf-8"))
    return {name: _own(answer) if "effects" in answer else _flat(answer) for name, answer in answers.items()}


def _own(answer: Mapping[str, Any]) -> Truth:
    effects = tuple(
        Put(one["effect"], one["parameters"], one["driver_concealed"], one["is_inferable"]) for one in answer["effects"]
    )
    off = answer["model_detectability"] >= LEAST_DETECTABILITY
    also = tuple(answer["also"])
    kind = answer["kind"]
    return Truth(answer["regime"], kind, effects, also, answer["detectability"], kind == "outside", off)


_FLAT: Final[Mapping[str, tuple[str, Callable[[Any], Any]]]] = {
    "nT_per_K": ("nt_per_k", lambda value: value),
    "nT_per_A": ("nt_per_a", lambda value: value),
    "reference_late_s": ("offset_s", lambda value: value),
    "at_s": ("at_s", lambda value: value),
    "period_s": ("frequency_hz", lambda value: 1.0 / value),
}
"""Numbers of flat answers: the product's name for each, and how it is worked out."""


def _flat(answer: Mapping[str, Any]) -> Truth:
    name = answer["effect"]
    kind = "clean" if name in _NOTHING else "outside" if name == _OUTSIDE else "effect"
    numbers = {_FLAT[key][0]: _FLAT[key][1](value) for key, value in answer.items() if key in _FLAT}
    if name == "bias_step":
        numbers["step_nt"] = answer["nT"]
    effects = () if kind == "clean" else (Put(name, numbers, _leaves_out(answer)),)
    structure = name in (_OUTSIDE, *_NEARLY_STRUCTURE)
    return Truth(answer.get("regime", "flat"), kind, effects, (), answer["detectability"], structure)


def _leaves_out(answer: Mapping[str, Any]) -> bool:
    driven = ("thermal_bias", "thermal_scale", "current_loop", "torquer")
    return bool(answer["driver_concealed"]) and answer["effect"] in driven


def diagnose_case(folder: Path) -> Said:
    """Diagnose one case as the command would; a refusal or a fault of the diagnosis is an answer, too."""
    began = time.process_time()
    try:
        content = diagnose(folder / "recording.toml").to_dict()
    except MagcalError as exc:
        return Said(folder.name, "refused", False, (str(exc),), processor_s=time.process_time() - began)
    except Exception as exc:  # one case that fails must not lose the others
        return Said(folder.name, "failed", False, (repr(exc),), processor_s=time.process_time() - began)
    named = tuple(
        Named(entry["effect"], entry["probability"], tuple(entry["class"]), entry["parameters"])
        for entry in content["effects"]
    )
    used = time.process_time() - began
    return Said(folder.name, content["verdict"], content["trusted"], tuple(content["reasons"]), named, used)


def scored_of(truths: Mapping[str, Truth], said: Iterable[Said]) -> list[Scored]:
    """The cases that count: clean ones, and those that can be found."""
    paired = [Scored(truths[one.case], one) for one in said if one.case in truths]
    return [one for one in paired if one.truth.kind == "clean" or one.truth.detectability >= LEAST_DETECTABILITY]


@dataclass(slots=True)
class Summary:
    """Tables of a score: rows of cells under a header, by title."""

    tables: dict[str, list[list[Any]]] = field(default_factory=dict)

    def text(self) -> str:
        """All tables as aligned text."""
        parts = []
        for title, rows in self.tables.items():
            cells = [
                ["-" if v is None else f"{v:.3g}" if isinstance(v, float) else str(v) for v in row] for row in rows
            ]
            widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
            lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in cells]
            parts.append("\n".join([title, *(f"  {line}" for line in lines)]))
        return "\n\n".join(parts)


def summarise(scored: Sequence[Scored]) -> Summary:
    """Everything that is counted."""
    return Summary(
        {
            "By what was asked": _grouped(scored, lambda one: one.truth.group),
            "By regime": _grouped(scored, lambda one: one.truth.regime),
            "By what was put in": _grouped(scored, _put_in),
            "False names": _false_names(scored),
            "Reliability: claimed probability against share true": reliability(scored),
            "Parameters of right names": _parameters(scored),
            "Processor time [s]": _times(scored),
            "Not right": _misses(scored),
        }
    )


def _put_in(one: Scored) -> str:
    return "+".join(effect.effect for effect in one.truth.effects) or "nothing"


def _grouped(scored: Sequence[Scored], key: Callable[[Scored], str]) -> list[list[Any]]:
    rows: list[list[Any]] = [["", "cases", "right", "or in its class", "unknown", "with a false name"]]
    groups: dict[str, list[Scored]] = {}
    for one in scored:
        groups.setdefault(key(one), []).append(one)
    for name, group in sorted(groups.items()):
        unknown = sum(one.said.verdict == _UNKNOWN for one in group)
        counts = (sum(one.is_right for one in group), sum(one.is_in_class for one in group), unknown)
        rows.append([name, len(group), *counts, sum(bool(one.false) for one in group)])
    return rows


def _false_names(scored: Sequence[Scored]) -> list[list[Any]]:
    """Names that are false: of clean cases, of all, and of those that may be acted on (the command ends with 0)."""
    rows: list[list[Any]] = [["", "cases", "with a false name", "names", "false names"]]
    clean = [one for one in scored if one.truth.kind == "clean"]
    trusted = [one for one in scored if one.said.trusted]
    for name, group in (("clean", clean), ("all", scored), ("exit 0", trusted)):
        names, false = (sum(map(len, part)) for part in ([o.said.names for o in group], [o.false for o in group]))
        rows.append([name, len(group), sum(bool(one.false) for one in group), names, false])
    return rows


def reliability(scored: Sequence[Scored]) -> list[list[Any]]:
    """Bins of the probability that names claim: how many, their mean claim, and the share that is true."""
    claims = [
        (entry.probability, entry.effect in one.truth.names)
        for one in scored
        for entry in one.said.named
        if entry.effect != _UNKNOWN
    ]
    rows: list[list[Any]] = [["claimed", "names", "mean claim", "true"]]
    for low, high in pairwise(PROBABILITIES):
        inside = [(p, true) for p, true in claims if low <= p < high or (high == 1.0 and p >= 1.0)]
        mean = float(np.mean([p for p, _ in inside])) if inside else None
        rows.append([f"{low:g} to {high:g}", len(inside), mean, _share([true for _, true in inside])])
    return rows


def _share(true: Sequence[bool]) -> float | None:
    return sum(true) / len(true) if true else None


def _parameters(scored: Sequence[Scored]) -> list[list[Any]]:
    """Components within 1 and 2 sigma (a right sigma has 0.683 and 0.954), by effect and parameter."""
    groups: dict[str, list[float]] = {"all": []}
    for one in scored:
        for name, z in one.distances().items():
            groups["all"] += z
            groups.setdefault(name, []).extend(z)
    rows: list[list[Any]] = [["", "components", "within 1 sigma", "within 2 sigma", "largest [sigma]"]]
    for name, z in groups.items():
        shares = (_share([value < limit for value in z]) for limit in (1.0, 2.0))
        rows.append([name, len(z), *shares, max(z, default=None)])
    return rows


def _times(scored: Sequence[Scored]) -> list[list[Any]]:
    used = sorted((one.said.processor_s, one.said.case) for one in scored)
    rows: list[list[Any]] = [["median", "worst", "of"]]
    if used:
        rows.append([used[len(used) // 2][0], used[-1][0], used[-1][1]])
    return rows


def _misses(scored: Sequence[Scored]) -> list[list[Any]]:
    rows: list[list[Any]] = [["case", "regime", "put in", "detectability", "asked", "said", "named", "exit"]]
    for one in scored:
        if not one.is_right or one.false:
            named = ", ".join(f"{e.effect} {e.probability:.3g}" for e in one.said.named if e.effect != _UNKNOWN)
            said = one.said.verdict if not one.said.reasons else f"{one.said.verdict} ({one.said.reasons[0][:60]})"
            asked = (one.truth.regime, _put_in(one), one.truth.detectability, one.truth.group)
            rows.append([one.said.case, *asked, said, named or "-", 0 if one.said.trusted else 3])
    return rows


def diagnose_all(folder: Path, executor: Executor) -> Iterator[Said]:
    """Diagnose the cases of a folder, in their order; each answer is yielded once it is in ``SAID`` there."""
    recordings = sorted(folder.absolute().glob("case-*/recording.toml"))
    pieces = [Piece(one.parent.name, diagnose_case, one.parent, inputs_of(one)) for one in recordings]
    with (folder / SAID).open("w", encoding="utf-8") as file:
        for piece, outcome in zip(pieces, executor.outcomes("cases", pieces), strict=True):
            said = outcome.value if isinstance(outcome, Done) else Said(piece.name, "failed", False, (outcome.text,))
            file.write(json.dumps(asdict(said)) + "\n")
            file.flush()
            yield said


def said_in(folder: Path) -> list[Said]:
    """What has been said of the cases of a folder so far, in their order."""
    path = folder / SAID
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return sorted((_said(json.loads(line)) for line in lines), key=lambda one: one.case)


def _said(kept: Mapping[str, Any]) -> Said:
    named = (Named(**one | {"members": tuple(one["members"])}) for one in kept["named"])
    return Said(**{**kept, "reasons": tuple(kept["reasons"]), "named": tuple(named)})


def main() -> None:
    """Diagnose, score, print, write."""
    parser = argparse.ArgumentParser(prog="python -m tests.regimes.score", description=__doc__)
    parser.add_argument("folder", type=Path, metavar="DIR")
    add_executor(parser)
    parser.add_argument("--stored", action="store_true", help=f"diagnose nothing, score what DIR/{SAID} holds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the score here (default: DIR/score.json)")
    options = parser.parse_args()
    options.out = options.folder
    if not options.stored:
        for said in diagnose_all(options.folder, executor_of(options)):
            print(f"{said.case}: {said.verdict} {', '.join(said.names)}", file=sys.stderr, flush=True)
    truths, said_of_all = read_answers(options.folder), said_in(options.folder)
    scored = scored_of(truths, said_of_all)
    summary = summarise(scored)
    print(f"{len(said_of_all)} of {len(truths)} cases diagnosed, {len(scored)} scored\n\n{summary.text()}")
    content = {"tables": summary.tables, "cases": [asdict(one) | {"distances": one.distances()} for one in scored]}
    path = options.json or options.folder / "score.json"
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
