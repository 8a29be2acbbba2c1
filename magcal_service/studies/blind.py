"""Concealed cases: recordings with one thing wrong, made by a simulator that shares nothing with the catalogue."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.errors import ConfigError, Fault
from magcal_service.physics.catalogue import catalogue
from magcal_service.studies.report import Cell, Findings, Table
from magcal_service.studies.study import Request, Study

LEAST_DETECTABILITY: Final = 12.0
"""Detectability from which a case is scored: what it adds is 12 sigmas in all, 72 nats before any choice.

As the generator draws them (tests/blind/draw.py); below, missing it is no fault of the diagnosis.
"""

_CLEAN_SHARE: Final = 0.2
"""Of all cases, those with nothing wrong: a fifth, so that 300 cases have 60 chances of a false alarm."""

_OUTSIDE_SHARE: Final = 0.12
"""With something that is in no catalogue; choice: enough of each kind to know a share within a tenth or so."""

_PAIR_SHARE: Final = 0.12
"""With two effects; the same choice."""

_HIDDEN_SHARE: Final = 0.16
"""With the driver left out of the recording; choice: more than of the others, since craft seldom record all."""


@dataclass(frozen=True, slots=True)
class Job:
    """One case: its seed, its kind, and whether the channel that drives it is in the recording."""

    seed: int
    kind: str
    recorded: bool


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one case.

    Parameters
    ----------
    truth: names that were put in; ``also`` those that are true besides.
    verdict, named, members: what the diagnosis said: verdict, effects in order, and the first one's class.
    sigmas: of parameters that have a true value, the distance of each component from it in sigmas, by name.
    excess, taken: sum of squares on held-out blocks beyond the true noise, before, and how much of it the effects took
        away [in noise variances].
    """

    job: Job
    expected: str
    truth: tuple[str, ...]
    also: tuple[str, ...]
    detectability: float
    verdict: str
    named: tuple[str, ...]
    members: tuple[str, ...]
    sigmas: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    excess: float = 0.0
    taken: float = 0.0
    seconds: float = 0.0

    @property
    def score(self) -> float:
        """1 for the right answer, a half where a class of several holds it, else 0."""
        if self.expected != "named":
            false = [name for name in self.named if name not in self.also]
            right = self.verdict == self.expected or (self.expected == "none" and not false)
            return float(right)
        if self.verdict == "unknown" or not self.named:  # noise with a memory is named under the verdict none
            return 0.0
        first = next((name for name in self.named if name not in self.also or name in self.truth), "")
        if first in self.truth:
            return 1.0
        return 0.5 if set(self.truth) & set(self.members) else 0.0


def run_job(job: Job) -> Outcome:
    """Draw, write, read back, diagnose, compare; the answer never lies beside the recording."""
    from magcal_service.diagnosis import result
    from magcal_service.diagnosis.diagnose import diagnose
    from magcal_service.recordings.reader import read_recording

    cases = _cases()
    case = cases.draw_case(job.seed, job.kind, driver_recorded=job.recorded)
    answer = case.answer
    with tempfile.TemporaryDirectory(prefix="magcal-blind-") as folder:
        recording = read_recording(cases.write_case(case, Path(folder) / "case"))
        diagnosis = diagnose(recording)
    found = result.entries(diagnosis)
    level = result.held_out_rms(diagnosis)
    count, sigma2 = len(diagnosis.prepared.problem.scene), answer.noise_nt**2
    return Outcome(
        job=job,
        expected=answer.verdict,
        truth=tuple(effect.effect for effect in answer.effects),
        also=tuple(answer.also),
        detectability=min((effect.detectability for effect in answer.effects), default=0.0),
        verdict=str(diagnosis.verdict),
        named=tuple(entry.effect for entry in found),
        members=found[0].members if found else (),
        sigmas=_distances(found, answer),
        excess=count * (level["recalibrated"] ** 2 / sigma2 - 1.0),
        taken=count * (level["recalibrated"] ** 2 - level["with_effects"] ** 2) / sigma2,
        seconds=diagnosis.seconds,
    )


def _cases() -> Any:
    """The generator, which is part of the checkout and not of the package."""
    root = str(Path.cwd())
    if (Path.cwd() / "tests" / "blind").is_dir() and root not in sys.path:
        sys.path.insert(0, root)
    try:
        return importlib.import_module("tests.blind")
    except ImportError:
        accepted = "run it in a checkout of the project, from its root: the concealed cases are not installed"
        raise ConfigError([Fault("study", "blind", accepted)]) from None


COMPARED: Final = [
    "nt_per_k",
    "per_k",
    "offset_s",
    "drift_ppm",
    "years",
    "radial_km",
    "along_km",
    "cross_km",
    "step_nt",
    "at_s",
    "step",
    "nt_per_s",
    "per_s",
    "frequency_hz",
    "amplitude_nt",
    "lsb_nt",
    "tau_s",
    "rate_rpm",
    "rate_rpm_per_s",
    "angle_deg",
]
"""Parameters that answers and diagnoses give under one name, in one convention."""


def _distances(found: Sequence[Any], answer: Any) -> dict[str, tuple[float, ...]]:
    """(value - truth) / sigma of every component that can be compared, for effects that were found."""
    distances: dict[str, tuple[float, ...]] = {}
    for effect in answer.effects:
        entry = next((entry for entry in found if entry.effect == effect.effect), None)
        if entry is None:
            continue
        for name in COMPARED:
            value, truth = entry.parameters.get(name), effect.parameters.get(name)
            if value is None or truth is None:
                continue
            expected = np.asarray(truth, dtype=np.float64)
            if expected.shape != value.value.shape or not np.all(value.sigma > 0.0):
                continue
            z = np.abs(value.value - expected) / value.sigma
            distances[f"{effect.effect}.{name}"] = tuple(float(part) for part in np.atleast_1d(z))
    return distances


def jobs_of(seed: int, runs: int) -> list[Job]:
    """The cases of a study: every effect in turn, drivers left out, clean ones, pairs, and what is in no catalogue."""
    cases = _cases()
    shares = (_CLEAN_SHARE, _OUTSIDE_SHARE, _PAIR_SHARE, _HIDDEN_SHARE)
    clean, outside, pairs, hidden = (max(1, round(share * runs)) for share in shares)
    effects, driven = sorted(cases.EFFECTS), sorted(cases.DRIVEN)
    strange = sorted(cases.OUTSIDE)
    kinds = [("none", True)] * clean
    kinds += [(f"outside:{strange[i % len(strange)]}", True) for i in range(outside)]
    kinds += [("pair", True)] * pairs
    kinds += [(driven[i % len(driven)], False) for i in range(hidden)]
    kinds += [(effects[i % len(effects)], True) for i in range(max(1, runs - clean - outside - pairs - hidden))]
    return [Job(seed * 100_000 + index, kind, recorded) for index, (kind, recorded) in enumerate(kinds)]


def run(request: Request) -> Findings:
    """Diagnose every case and compare with the answers."""
    jobs = jobs_of(request.seed, request.runs or STUDY.runs)
    sources = sorted(Path(_cases().__file__).parent.glob("*.py"))
    outcomes = list(request.executor.map(run_job, jobs, "concealed cases", inputs=sources))
    scored = [o for o in outcomes if o.expected == "none" or o.detectability >= LEAST_DETECTABILITY]
    return Findings(
        tables=(_summary(scored), _by_effect(scored), _confusion(scored), _misses(scored)),
        figures=_figures(scored),
        settings={"cases": len(jobs), "scored": len(scored), "least detectability": LEAST_DETECTABILITY},
        notes=_NOTES,
    )


def _groups(outcomes: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        kind = outcome.job.kind
        if kind == "none" or kind.startswith("outside") or kind == "pair":
            name = kind.partition(":")[0]
        else:
            name = "driver recorded or none needed" if outcome.job.recorded else "driver not recorded"
        groups.setdefault(name, []).append(outcome)
    return groups


def _rate(outcomes: Sequence[Outcome]) -> float:
    return sum(outcome.score for outcome in outcomes) / max(len(outcomes), 1)


def _false(outcome: Outcome) -> bool:
    """Whether something was named that is not there."""
    return any(name not in (*outcome.truth, *outcome.also, "unknown") for name in outcome.named)


def _both(outcomes: Sequence[Outcome]) -> float:
    return sum(set(o.truth) <= set(o.named) for o in outcomes) / max(len(outcomes), 1)


def _summary(outcomes: Sequence[Outcome]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, group in _groups(outcomes).items():
        both = _both(group) if name == "pair" else None
        false = sum(map(_false, group)) / len(group)
        seconds = float(np.median([outcome.seconds for outcome in group]))
        rows.append((name, len(group), round(_rate(group), 4), both, round(false, 4), round(seconds, 1)))
    columns = ("cases", "number", "right (a class counts half)", "both named", "with a false name", "median time [s]")
    return Table("What was asked and what was answered", columns, tuple(rows))


def _by_effect(outcomes: Sequence[Outcome]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    kinds = sorted({(o.job.kind, o.job.recorded) for o in outcomes if o.job.kind not in ("none", "pair")})
    for kind, recorded in kinds:
        group = [o for o in outcomes if (o.job.kind, o.job.recorded) == (kind, recorded)]
        taken, excess = sum(o.taken for o in group), sum(o.excess for o in group)
        share = taken / excess if excess > 100.0 else None
        z = [value for o in group for values in o.sigmas.values() for value in values]
        inside = sum(value < 3.0 for value in z) / len(z) if z else None
        name = kind if recorded else f"{kind}, driver left out"
        rows.append((name, len(group), round(_rate(group), 3), share, inside, len(z)))
    columns = ("kind", "number", "right", "share of the held-out excess taken away", "parameters within 3 sigma", "of")
    return Table("By kind", columns, tuple(rows))


def _confusion(outcomes: Sequence[Outcome]) -> Table:
    """Truth against the first name."""
    counts: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        truth = outcome.job.kind if outcome.job.kind in ("none", "pair") else outcome.job.kind.partition(":")[0]
        if outcome.job.kind == "pair":
            first = "both" if set(outcome.truth) <= set(outcome.named) else outcome.verdict
        elif outcome.verdict == "unknown":
            first = "unknown"
        else:
            first = next((n for n in outcome.named if n not in outcome.also or n in outcome.truth), "none")
        counts.setdefault(truth, Counter())[first] += 1
    rows = [(truth, ", ".join(f"{name} {n}" for name, n in c.most_common())) for truth, c in sorted(counts.items())]
    return Table("Confusion: what was put in, and what was named first", ("put in", "named"), tuple(rows))


def _misses(outcomes: Sequence[Outcome]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for o in outcomes:
        if o.score < 1.0:
            said = f"{o.verdict}: {', '.join(o.named[:3])}"
            kind = o.job.kind if o.job.recorded else f"{o.job.kind}, driver left out"
            rows.append((o.job.seed, kind, ", ".join(o.truth), round(o.detectability, 1), said, ", ".join(o.members)))
    columns = ("seed", "kind", "truth", "detectability", "answer", "class")
    return Table("Every case that was not answered fully right", columns, tuple(rows))


def _figures(outcomes: Sequence[Outcome]) -> dict[str, Cell]:
    groups = _groups(outcomes)
    figures: dict[str, Cell] = {f"right: {name}": _rate(group) for name, group in groups.items()}
    if "none" in groups:
        figures["false alarms on clean data"] = 1.0 - _rate(groups["none"])
    if "pair" in groups:
        figures["pairs with both named"] = _both(groups["pair"])
    z = [v for o in outcomes if o.score == 1.0 for values in o.sigmas.values() for v in values]
    figures["parameters within 3 sigma"] = sum(v < 3.0 for v in z) / max(len(z), 1)
    figures["parameters compared"] = len(z)
    no_field = {effect.name for effect in catalogue() if not effect.acts_on.is_live}
    fields = [o for o in outcomes if o.expected == "named" and o.score == 1.0 and not set(o.truth) & no_field]
    excess = sum(o.excess for o in fields)
    figures["share of the held-out excess taken away"] = sum(o.taken for o in fields) / max(excess, 1e-9)
    figures["median time of a diagnosis [s]"] = float(np.median([o.seconds for o in outcomes]))
    return figures


_NOTES: Final = (
    "Every case is simulated from causes by tests/blind, which shares no code with the catalogue; its README has the "
    "conventions.  The answer is compared after the diagnosis and never lies beside the recording.",
    "Scored are clean cases and those whose effects have a detectability of at least 12: norm of the noise-free change "
    "of the scalar residual, with the nine errors' columns projected out, over the noise.",
    "Right: the effect is named first; half where it is named in the first one's class.  Clean: nothing is named.  "
    "Outside: the verdict is unknown.  What is true beside the effect (a despin) counts neither way.",
)

STUDY = Study("blind", "Concealed cases: is the right physics named, and nothing where there is nothing?", 400, run)
