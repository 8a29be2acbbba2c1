"""Is a trusted vector ever wrong by more than it says?  Flights with one thing wrong, through the whole pipeline."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median
from typing import Final

import numpy as np

from magcal_service.many.pieces import Done, Piece
from magcal_service.model import Array
from magcal_service.studies.report import Cell, Findings, Grid, Line, Panel, Table
from magcal_service.studies.study import Request, Study
from magcal_service.studies.unseen.motion import Motion
from magcal_service.studies.unseen.scenarios import SCENARIOS, Group
from magcal_service.studies.unseen.score import (
    BEFORE_ALARM_S,
    COVERED_SIGMA,
    EDGES_NT,
    ORBIT_AND_HALF_S,
    WRONG_NT,
    WRONG_SIGMA,
    Asked,
    Fared,
    fly,
)

NOISES_NT: Final = (20.0, 100.0, 300.0, 1000.0)
"""Noise per axis [nT]: a good magnetoresistive part to a phone's."""

MOTIONS: Final = tuple(Motion)
"""How the craft turn."""

DURATION_S: Final = 9000
"""Length of a flight [s]: one and a half orbits, after which a clean one should be trusted."""

SHARP_NT: Final = 50.0
"""Bound on the bias, 3 sigma [nT], under which a clean flight should be trusted by then."""

CONFIDENCE: Final = 0.95
"""Of the upper limit of a rate."""

Flight = tuple[Asked, Fared]


def run(request: Request) -> Findings:
    """Every scenario at every noise and for every motion, so many times."""
    duration_s, noises = request.duration_s or DURATION_S, request.noises_nt or NOISES_NT
    motions = request.motions or tuple(map(str, MOTIONS))
    asked = [
        Asked(
            name, str(motion), noise, duration_s, (request.seed, zlib.crc32(name.encode()), int(noise), number, index)
        )
        for name in request.scenarios or SCENARIOS
        for noise in noises
        for index, motion in enumerate(MOTIONS)
        if motion in motions and (motion is Motion.SPIN or not SCENARIOS[name].spinning)
        for number in range(request.runs or STUDY.runs)
    ]
    pieces = [Piece(f"{one.scenario}, {one.motion}, {one.noise_nt:g} nT", fly, one) for one in asked]
    outcomes = request.executor.outcomes("flights", pieces)
    flights = [(one, outcome.value) for one, outcome in zip(asked, outcomes, strict=True) if isinstance(outcome, Done)]
    return Findings(
        tables=(
            _summary(flights),
            _scenarios(flights),
            _settings(flights),
            warnings(flights),
            _delays(flights),
            _worst(flights),
        ),
        figures=_figures(flights, len(asked)),
        settings={
            "scenarios": len(request.scenarios or SCENARIOS),
            "noises [nT]": ", ".join(f"{noise:g}" for noise in noises),
            "motions": ", ".join(motions),
            "flight [s]": duration_s,
        },
        notes=_NOTES,
        panels=_panels(flights),
        grids=_grids(flights),
    )


def observable(flights: Iterable[Flight]) -> list[Flight]:
    """Without the scenarios that nothing could show."""
    return [one for one in flights if not SCENARIOS[one[0].scenario].unobservable]


def promised(flights: Iterable[Flight]) -> list[Flight]:
    """Those that the protection level has to hold."""
    return [one for one in flights if SCENARIOS[one[0].scenario].promised]


def upper_limit(events: int) -> float:
    """Largest mean of a Poisson law under which so few events are not rarer than 1 - ``CONFIDENCE``."""
    low, high = 0.0, 10.0 + 10.0 * events
    for _ in range(80):
        middle = 0.5 * (low + high)
        log_terms = [-middle + k * math.log(max(middle, 1e-300)) - math.lgamma(k + 1.0) for k in range(events + 1)]
        below = math.fsum(math.exp(one) for one in log_terms)
        low, high = (middle, high) if below > 1.0 - CONFIDENCE else (low, middle)
    return 0.5 * (low + high)


def _sum(flights: Iterable[Flight], value: Callable[[Fared], float]) -> float:
    return math.fsum(value(fared) for _, fared in flights)


def _median(values: Iterable[float]) -> float | None:
    known = [value for value in values if math.isfinite(value)]
    return median(known) if known else None


def _counts(flights: Sequence[Flight]) -> tuple[Cell, ...]:
    trusted = _sum(flights, lambda one: one.trusted_s)
    return (
        len(flights),
        round(trusted / 3600.0, 1),
        _sum(flights, lambda one: one.wrong_s),
        sum(one.wrong_s > 0.0 for _, one in flights),
        _sum(flights, lambda one: one.misled_s),
        sum(one.misled_s > 0.0 for _, one in flights),
        _sum(flights, lambda one: one.unprotected_s),
        max((one.worst_nt for _, one in flights), default=None),
    )


_COUNTED: Final = (
    "flights", "trusted [h]", "trusted and wrong [s]", "in flights", "misled [s]", "in flights ", "unprotected [s]",
    "largest error while trusted [nT]",
)  # fmt: skip


def _summary(flights: Sequence[Flight]) -> Table:
    seen = observable(flights)
    clean = [one for one in seen if SCENARIOS[one[0].scenario].group is Group.CLEAN]
    hidden = [one for one in flights if SCENARIOS[one[0].scenario].unobservable]
    parts = {
        "clean": clean,
        "what protection promises to hold": promised(flights),
        "all that can be seen": seen,
        "what nothing can show": hidden,
    }
    rows = tuple((name, *_counts(part)) for name, part in parts.items())
    return Table("Trusted and wrong", ("scenarios", *_COUNTED), rows)


def _scenarios(flights: Sequence[Flight]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, scenario in SCENARIOS.items():
        own = [one for one in flights if one[0].scenario == name]
        if own:
            warned = [fared.alarm_s for _, fared in own if math.isfinite(fared.alarm_s)]
            share = None if scenario.group is Group.CLEAN else round(len(warned) / len(own), 3)
            ratio = _median(fared.near_ratio for _, fared in own)
            rows.append((name, scenario.says, *_counts(own), share, _median(warned), ratio, _named(own)))
    columns = (
        "scenario",
        "what is done",
        *_COUNTED,
        "warned",
        "after, median [s]",
        "protection / error before it",
        "reasons",
    )
    return Table("By scenario", columns, tuple(rows))


def _named(flights: Sequence[Flight]) -> str | None:
    """The reasons that came first, in most flights."""
    first = [fared.reasons[0] for _, fared in flights if fared.reasons]
    return ", ".join(sorted(set(first), key=lambda name: -first.count(name))[:2]) or None


def _noises(flights: Iterable[Flight]) -> list[float]:
    return sorted({asked.noise_nt for asked, _ in flights})


def warnings(flights: Sequence[Flight]) -> Table:
    """How soon each hazard is warned of at each noise: minutes, and in how many of the flights."""
    noises, rows = _noises(flights), []
    for name, scenario in SCENARIOS.items():
        own = [one for one in flights if one[0].scenario == name]
        if own and scenario.group is not Group.CLEAN:
            cells = [_warned([fared for asked, fared in own if asked.noise_nt == noise]) for noise in noises]
            rows.append((name, scenario.says, *cells))
    columns = ("scenario", "what is done", *(f"{noise:g} nT of noise" for noise in noises))
    return Table("Minutes from the hazard's beginning to a doubt, median", columns, tuple(rows))


def _warned(fared: Sequence[Fared]) -> str | None:
    after = [one.alarm_s for one in fared if math.isfinite(one.alarm_s)]
    if not fared:
        return None
    if not after:
        return f"not, of {len(fared)}"
    return f"{median(after) / 60.0:.0f}" + ("" if len(after) == len(fared) else f" in {len(after)} of {len(fared)}")


def _settings(flights: Sequence[Flight]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for motion in MOTIONS:
        for noise in _noises(flights):
            own = [one for one in observable(flights) if (one[0].motion, one[0].noise_nt) == (str(motion), noise)]
            clean = [fared for asked, fared in own if asked.scenario == "clean"]
            rows.append((str(motion), noise, *_counts(own), _median(one.trusted_at_s for one in clean)))
    return Table(
        "By motion and noise", ("motion", "noise [nT]", *_COUNTED, "clean ones trusted after [s]"), tuple(rows)
    )


def _delays(flights: Sequence[Flight]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name in ("late_5", "late_10", "late_30"):
        for noise in _noises(flights):
            own = [one for one in flights if (one[0].scenario, one[0].noise_nt) == (name, noise)]
            own = [one for one in own if one[0].motion == str(Motion.SPIN)]
            if not own:
                continue
            warned = [fared.alarm_s for _, fared in own if math.isfinite(fared.alarm_s)]
            worst = max((fared.worst_nt for _, fared in own), default=None)
            trusted, misled = _sum(own, lambda one: one.trusted_s), _sum(own, lambda one: one.misled_s)
            rows.append((name, noise, len(own), len(warned), _median(warned), trusted, worst, misled))
    columns = (
        "reference", "noise [nT]", "flights", "warned", "after, median [s]", "trusted [s]",
        "largest error while trusted [nT]", "misled [s]",
    )  # fmt: skip
    return Table("A late reference, spinning craft", columns, tuple(rows))


def _worst(flights: Sequence[Flight]) -> Table:
    """Every flight that misled, the longest first."""
    misled = sorted((one for one in flights if one[1].misled_s > 0.0), key=lambda one: -one[1].misled_s)
    rows = [
        (
            asked.scenario, "yes" if SCENARIOS[asked.scenario].promised else "no",
            asked.motion, asked.noise_nt, ", ".join(map(str, asked.seed)), fared.misled_s,
            fared.worst_nt, fared.worst_beyond_nt, "yes" if SCENARIOS[asked.scenario].unobservable else "no",
        )
        for asked, fared in misled[:_MOST_LISTED]
    ]  # fmt: skip
    columns = (
        "scenario", "promised", "motion", "noise [nT]", "seed", "misled [s]", "largest error while trusted [nT]",
        "beyond protection and sigma by [nT]", "unobservable",
    )  # fmt: skip
    return Table(f"Flights that misled ({len(misled)})", columns, tuple(rows))


_MOST_LISTED: Final = 40  # a page of them; the JSON of a smaller run has the rest


def _figures(flights: Sequence[Flight], asked: int) -> dict[str, Cell]:
    seen = observable(flights)
    trusted_s = _sum(seen, lambda one: one.trusted_s)
    protected_s = trusted_s - _sum(seen, lambda one: one.unprotected_s)
    held = promised(flights)
    held_s = _sum(held, lambda one: one.trusted_s - one.unprotected_s)
    events, broken = (sum(one.misled_s > 0.0 for _, one in part) for part in (seen, held))
    clean = [fared for one, fared in flights if one.scenario == "clean" and fared.bound_nt < SHARP_NT]
    ratios = _median(fared.near_ratio for _, fared in seen)
    return {
        "flights": len(flights),
        "flights that failed": asked - len(flights),
        "trusted [s]": trusted_s,
        "trusted and wrong [s]": _sum(seen, lambda one: one.wrong_s),
        "misled [s]": _sum(seen, lambda one: one.misled_s),
        "flights that misled": events,
        "trusted with a protection level [s]": protected_s,
        "share of that time that misled": _sum(seen, lambda one: one.misled_s) / protected_s if protected_s else None,
        "flights that misled, per second of that time": events / protected_s if protected_s else None,
        f"the same, at most ({CONFIDENCE:.0%})": upper_limit(events) / protected_s if protected_s else None,
        "of what protection promises to hold: such time [s]": held_s,
        "of it misled [s]": _sum(held, lambda one: one.misled_s),
        "flights that misled against the promise": broken,
        "of those, per second of such time": broken / held_s if held_s else None,
        f"that rate, at most ({CONFIDENCE:.0%})": upper_limit(broken) / held_s if held_s else None,
        "protection over error before an alarm, median": ratios,
        f"clean, bound under {SHARP_NT:g} nT: flights": len(clean),
        "of them trusted by 1.5 orbits": (
            sum(one.trusted_at_s <= ORBIT_AND_HALF_S for one in clean) / len(clean) if clean else None
        ),
    }


def _panels(flights: Sequence[Flight]) -> tuple[Panel, ...]:
    """Error over protection while trusted (a Stanford diagram by its quantiles), for each motion."""
    return tuple(
        _diagram(motion, [fared for asked, fared in observable(flights) if asked.motion == str(motion)])
        for motion in MOTIONS
    )


def _grids(flights: Sequence[Flight]) -> tuple[Grid, ...]:
    """Trusted time by error and protection, for each motion."""
    return tuple(
        Grid(f"{motion}, all noises", "error [nT]", "protection [nT]", _cells(_seconds(fared)))
        for motion in MOTIONS
        if (fared := [one for asked, one in observable(flights) if asked.motion == str(motion)])
    )


def _cells(seconds: Array) -> tuple[tuple[float, float, float, float, float], ...]:
    edges = [float(edge) for edge in EDGES_NT]
    return tuple(
        (edges[row], edges[row + 1], edges[column], edges[column + 1], float(seconds[row, column]))
        for row, column in np.argwhere(seconds > 0.0)
    )


def _seconds(fared: Sequence[Fared]) -> Array:
    """Trusted time by class of error (rows) and of protection (columns) [s]."""
    return np.asarray(np.sum([one.diagram for one in fared], axis=0) if fared else np.zeros((len(EDGES_NT) - 1,) * 2))


def _diagram(motion: Motion, fared: Sequence[Fared]) -> Panel:
    seconds = _seconds(fared)
    middle = np.sqrt(np.maximum(EDGES_NT[:-1], 0.5) * EDGES_NT[1:])
    lines = [
        _quantile(f"{share:.1%} of the trusted time below", share, seconds, middle) for share in (0.5, 0.95, 0.999)
    ]
    lines += [_quantile("largest error", 1.0, seconds, middle)]
    limit = Line("error = protection", (1.0, 1e5), (1.0, 1e5), limit=True)
    return Panel(f"{motion}, all noises", "protection [nT]", "error [nT]", (*lines, limit), True, True)


def _quantile(label: str, share: float, seconds: Array, middle: Array) -> Line:
    """Upper edge of the class that a share of the trusted time in a class of protection stays within."""
    points: Iterator[tuple[float, float]] = (
        (float(middle[column]), float(EDGES_NT[1:][np.searchsorted(np.cumsum(own), share * own.sum() * (1.0 - 1e-12))]))
        for column, own in enumerate(seconds.T)
        if own.sum() > 0.0
    )
    x, y = zip(*points, strict=True) if seconds.sum() > 0.0 else ((), ())
    return Line(label, tuple(x), tuple(y))


_NOTES: Final = (
    f"Trusted and wrong: the verdict is trusted, and the vector's error, without the sample's own noise, is beyond "
    f"{WRONG_NT:g} nT and {WRONG_SIGMA:g} sigma of the estimate.  Misled: trusted, and the error beyond the published "
    f"protection and {COVERED_SIGMA:g} sigma.  Unprotected: trusted without a protection level.",
    "Every flight counts as one event at the most: its seconds are not independent.  Rates are of the time that is "
    "trusted and has a protection level; their upper limit is Poisson's, one-sided.  What protection promises to hold "
    "is one hazard of docs/integrity.md, no larger than told there, and clean flights.  What nothing can show (a "
    "reference that is scaled) is listed and counts for no promise.",
    "Warned: a doubtful verdict after the hazard's beginning, whatever its reason.  Protection over error is the "
    f"median of the last {BEFORE_ALARM_S:g} s before it, while trusted: the hazard is just below detection then.",
    "Hazards are plain arithmetic of studies/unseen/scenarios.py and share no code with the catalogue of effects.",
)

STUDY = Study(
    "integrity",
    f"{sum(one.group is not Group.CLEAN for one in SCENARIOS.values())} things that go wrong, and clean flights: "
    "how long is a wrong vector trusted?",
    2,
    run,
    tuple(SCENARIOS),
    tuple(map(str, MOTIONS)),
)
