"""Random errors, orbits, spins and axes through the daemon's pipeline: is anything trusted that is wrong?

Every run is a ``Pipeline`` with its trust monitor, fed message by message; the verdict looked at is the one published.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.config.settings import DEFAULT_METHOD, FilterConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators.interface import InformationSet
from magcal_service.model import BIAS, STATE_SIZE, Array
from magcal_service.studies.bounds import bound_sigma
from magcal_service.studies.flights import CRAFT, START_UTC_NS, FlightPlan, Flown, Nine, fly
from magcal_service.studies.montecarlo import seeds_of
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study
from magcal_service.wire.messages import Estimate, Frame, MagnetometerSample, Message, ReferenceSample, Vector, Verdict

LARGEST_BIAS_NT: Final = 60_000.0
"""Largest length of the bias [nT]: as much as the strongest field at the ground."""

LARGEST_D: Final = 0.3
"""Largest eigenvalue of D, either way: beyond data sheets, and within the gates of the start (0.4 to 2.5)."""

ORBITS: Final = 1.5
"""Length of a flight in orbits: one shows all directions that will come, half of one more is for settling."""

WRONG_SIGMAS: Final = 5.0
"""Trusted and wrong is what is off by more than so many formal sigmas, by chance once in 2 million."""

WRONG_BIAS_NT: Final = 50.0
"""And by more than this, a bias [nT].

Choice: a thousandth of the field; a filter in little noise is many of its sigmas off by less, which does no harm.
"""

WRONG_D: Final = 1e-3
"""Or an element of D by more than this: 1e-3 of the field is 50 nT, too."""

LARGEST_BOUND_NT: Final = 50.0
"""Runs with a Cramer-Rao bound (1 sigma, one and a half orbits) below this on every axis should be trusted by then."""

_YEAR_NS: Final = 365 * 86_400 * 10**9
"""A year [ns], within which a flight may start: every angle of the Earth to the orbit."""

_SLOWEST_RPM, _FASTEST_RPM = 0.5, 25.0
"""Spins that are drawn, evenly by their logarithm: to just below where 1 Hz aliases (28 rpm, docs/studies.md)."""

_QUIETEST_NT, _NOISIEST_NT = 20.0, 500.0
"""Noise that is drawn, evenly by its logarithm: around the paper's 300 nT; the study `noise` goes further."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run: the method, the run's seed, and the longest flight [s] (None: one and a half orbits)."""

    number: int
    method: str
    seed: np.random.SeedSequence
    duration_s: int | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one run.

    Parameters
    ----------
    number: of the run, counted from 0; the first runs are the same however many there are.
    plan: what was drawn.
    noise_known: whether the craft knew its noise.
    bound_nt: bound of the worst bias axis at the end, 1 sigma [nT].
    verdict, reasons: at the end.
    first_trusted_s, last_wrong_s: when it was first trusted, and last trusted and wrong [s]; nan for never.
    trusted_ticks, wrong_ticks: ticks that were trusted, and trusted and wrong.
    worst_sigmas, worst_nt: largest error of a bias axis while trusted, in formal sigmas and in nT.
    final_nt, final_sigma_nt: worst bias error and largest formal sigma of a bias axis at the end [nT].
    """

    number: int
    plan: FlightPlan
    noise_known: bool
    bound_nt: float
    verdict: Verdict
    reasons: tuple[str, ...]
    first_trusted_s: float
    last_wrong_s: float
    trusted_ticks: int
    wrong_ticks: int
    worst_sigmas: float
    worst_nt: float
    final_nt: float
    final_sigma_nt: float


def draw(rng: np.random.Generator) -> FlightPlan:
    """A random flight: errors up to 60 uT and |D| 0.3, any low orbit, any steady spin about any axis."""
    altitude_km = rng.uniform(350.0, 1000.0)
    return FlightPlan(
        start_utc_ns=START_UTC_NS + int(rng.integers(0, _YEAR_NS, endpoint=True)),
        altitude_km=altitude_km,
        inclination_deg=rng.uniform(0.0, 110.0),
        node_deg=rng.uniform(0.0, 360.0),
        argument_deg=rng.uniform(0.0, 360.0),
        spin_eci=_direction(rng),
        spin_body=_direction(rng),
        rate_rpm=math.exp(rng.uniform(math.log(_SLOWEST_RPM), math.log(_FASTEST_RPM))) * rng.choice([-1.0, 1.0]),
        phase_rad=rng.uniform(0.0, 2.0 * math.pi),
        duration_s=round(ORBITS * FlightPlan(altitude_km=altitude_km).period_s),
        noise_nt=math.exp(rng.uniform(math.log(_QUIETEST_NT), math.log(_NOISIEST_NT))),
        x=_errors(rng),
    )


def _direction(rng: np.random.Generator) -> Vector:
    x, y, z = rng.standard_normal(3).tolist()
    return x, y, z


def _errors(rng: np.random.Generator) -> Nine:
    """Bias of any direction and length up to 60 uT; D with eigenvalues up to 0.3 about any axes."""
    direction = rng.standard_normal(3)
    bias = rng.uniform(0.0, LARGEST_BIAS_NT) * direction / np.linalg.norm(direction)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    d = (axes * rng.uniform(-LARGEST_D, LARGEST_D, 3)) @ axes.T
    bx, by, bz = bias.tolist()
    return bx, by, bz, float(d[0, 0]), float(d[1, 1]), float(d[2, 2]), float(d[0, 1]), float(d[0, 2]), float(d[1, 2])


def fly_one(job: Job) -> Outcome:
    """One run from drawing to verdict; the work of a worker process."""
    rng = np.random.default_rng(job.seed)
    plan = draw(rng)
    if job.duration_s is not None:
        plan = replace(plan, duration_s=job.duration_s)
    noise_known = bool(rng.random() < 0.5)
    flown = fly(plan)
    pipeline = Pipeline(plan.craft(FilterConfig(method=job.method), noise_known=noise_known))
    watch = _Watch(flown)
    for message in _messages(flown, flown.measured(job.seed.spawn(1)[0])):
        watch.observe(pipeline.handle(message))
    watch.observe(pipeline.flush())
    bound = bound_sigma(flown.for_bounds(), InformationSet.SCALAR_SPIN)
    return watch.outcome(job.number, noise_known, float(bound[BIAS].max()))


def _messages(flown: Flown, measured_nt: Array) -> Sequence[Message]:
    """Sample and reference of every second, as they would come over a link."""
    messages: list[Message] = []
    for index, (field, reference) in enumerate(zip(measured_nt.tolist(), flown.reference_eci_nt.tolist(), strict=True)):
        time_ns = flown.plan.start_utc_ns + index * 10**9
        bx, by, bz = field
        hx, hy, hz = reference
        messages.append(
            ReferenceSample(
                craft=CRAFT, source="igrf", sequence=index, time_ns=time_ns, field_nt=(hx, hy, hz), frame=Frame.ECI
            )
        )
        messages.append(
            MagnetometerSample(craft=CRAFT, source="mag", sequence=index, time_ns=time_ns, field_body_nt=(bx, by, bz))
        )
    return messages


class _Watch:
    """Compares what is published with the truth.

    Parameters
    ----------
    flown: the flight.
    """

    def __init__(self, flown: Flown) -> None:
        self._plan = flown.plan
        self._truth = flown.truth(0.0)
        self._last: Estimate | None = None
        self._first_trusted_s = self._last_wrong_s = math.nan
        self._trusted = self._wrong = 0
        self._worst_sigmas = self._worst_nt = 0.0
        self._final_nt = self._final_sigma_nt = math.nan

    def observe(self, published: Sequence[Message]) -> None:
        """Take what came out of the pipeline."""
        for message in published:
            if isinstance(message, Estimate):
                self._estimate(message)

    def _estimate(self, estimate: Estimate) -> None:
        self._last = estimate
        error = np.abs(np.array(estimate.bias_nt + estimate.D) - self._truth)
        sigma = np.sqrt(np.array(estimate.covariance)[_VARIANCES])
        self._final_nt, self._final_sigma_nt = float(error[BIAS].max()), float(sigma[BIAS].max())
        if estimate.verdict is not Verdict.TRUSTED:
            return
        now_s = (estimate.time_ns - self._plan.start_utc_ns) * 1e-9
        if not self._trusted:
            self._first_trusted_s = now_s
        self._trusted += 1
        self._worst_sigmas = max(self._worst_sigmas, float((error / sigma)[BIAS].max()))
        self._worst_nt = max(self._worst_nt, float(error[BIAS].max()))
        if ((error > WRONG_SIGMAS * sigma) & (error > _WRONG)).any():
            self._wrong += 1
            self._last_wrong_s = now_s

    def outcome(self, number: int, noise_known: bool, bound_nt: float) -> Outcome:
        """The account of the run."""
        last = self._last
        return Outcome(
            number=number,
            plan=self._plan,
            noise_known=noise_known,
            bound_nt=bound_nt,
            verdict=last.verdict if last is not None else Verdict.NOT_STARTED,
            reasons=last.reasons if last is not None else (),
            first_trusted_s=self._first_trusted_s,
            last_wrong_s=self._last_wrong_s,
            trusted_ticks=self._trusted,
            wrong_ticks=self._wrong,
            worst_sigmas=self._worst_sigmas,
            worst_nt=self._worst_nt,
            final_nt=self._final_nt,
            final_sigma_nt=self._final_sigma_nt,
        )


_VARIANCES: Final = np.flatnonzero(np.equal(*np.triu_indices(STATE_SIZE)))
_WRONG: Final = np.repeat([WRONG_BIAS_NT, WRONG_D], [3, 6])


def run(request: Request) -> Findings:
    """Random flights through the pipeline, for each method asked for."""
    names = request.methods or (DEFAULT_METHOD,)
    seeds = seeds_of(request.seed, request.runs or STUDY.runs)
    tables: list[Table] = []
    figures: dict[str, Cell] = {}
    panels: list[Panel] = []
    for name in names:
        jobs = [Job(number, name, seed, request.duration_s) for number, seed in enumerate(seeds)]
        outcomes = list(request.executor.map(fly_one, jobs, f"convergence, {name}"))
        tables += _tables(name, outcomes)
        figures.update(_figures(name, outcomes))
        panels.append(_panel(name, outcomes))
    return Findings(tuple(tables), figures, dict(_SETTINGS), _NOTES, tuple(panels))


def _figures(name: str, outcomes: list[Outcome]) -> dict[str, Cell]:
    able = [outcome for outcome in outcomes if outcome.bound_nt < LARGEST_BOUND_NT]
    trusted = [outcome for outcome in outcomes if outcome.verdict is Verdict.TRUSTED]
    times = [outcome.first_trusted_s for outcome in outcomes if not math.isnan(outcome.first_trusted_s)]
    silent = [outcome for outcome in outcomes if outcome.verdict is not Verdict.TRUSTED and not outcome.reasons]
    good = [outcome for outcome in able if outcome.verdict is Verdict.TRUSTED]
    return {
        f"{name}: runs ever trusted and wrong": sum(outcome.wrong_ticks > 0 for outcome in outcomes),
        f"{name}: trusted at the end": len(trusted),
        f"{name}: own bound under {LARGEST_BOUND_NT:g} nT": len(able),
        f"{name}: of those, trusted at the end": len(good),
        f"{name}: share of those": len(good) / len(able) if able else None,
        f"{name}: not trusted without a reason": len(silent),
        f"{name}: median time to trust [s]": float(np.median(times)) if times else None,
        f"{name}: largest error while trusted [sigma]": max(outcome.worst_sigmas for outcome in outcomes),
    }


def _tables(name: str, outcomes: list[Outcome]) -> list[Table]:
    able = [outcome for outcome in outcomes if outcome.bound_nt < LARGEST_BOUND_NT]
    unable = [outcome for outcome in outcomes if outcome.bound_nt >= LARGEST_BOUND_NT]
    why = Counter((", ".join(outcome.reasons) or "trusted") for outcome in able)
    why_not = Counter((", ".join(outcome.reasons) or "trusted") for outcome in unable)
    rows = tuple((reason, why[reason], why_not[reason]) for reason, _ in (why + why_not).most_common())
    columns = ("verdict or reasons at the end", f"own bound under {LARGEST_BOUND_NT:g} nT", "own bound above")
    doubtful = [each for each in outcomes if each.wrong_ticks or (each in able and each.verdict != Verdict.TRUSTED)]
    listed = tuple(_row(outcome) for outcome in doubtful)
    return [
        Table(f"{name}: {len(outcomes)} runs after {ORBITS:g} orbits", columns, rows),
        Table(f"{name}: runs that were trusted and wrong, or not trusted though they could be", _COLUMNS, listed),
    ]


_COLUMNS: Final = (
    "run", "spin [rpm]", "noise [nT]", "noise known", "inclination [deg]", "|b| [nT]", "bound [nT]", "own sigma [nT]",
    "final error [nT]", "trusted ticks", "wrong ticks", "last wrong [s]", "verdict", "reasons",
)  # fmt: skip


def _row(outcome: Outcome) -> tuple[Cell, ...]:
    plan = outcome.plan
    drawn = (
        plan.rate_rpm,
        plan.noise_nt,
        outcome.noise_known,
        plan.inclination_deg,
        float(np.linalg.norm(plan.x[BIAS])),
    )
    result = (outcome.bound_nt, outcome.final_sigma_nt, outcome.final_nt, outcome.trusted_ticks, outcome.wrong_ticks)
    return (outcome.number, *drawn, *result, outcome.last_wrong_s, str(outcome.verdict), ", ".join(outcome.reasons))


def _panel(name: str, outcomes: list[Outcome]) -> Panel:
    """Share of the runs that had been trusted by a time."""
    times = sorted(outcome.first_trusted_s for outcome in outcomes if not math.isnan(outcome.first_trusted_s))
    share = [(i + 1) / len(outcomes) for i in range(len(times))]
    able = sum(outcome.bound_nt < LARGEST_BOUND_NT for outcome in outcomes) / len(outcomes)
    lines = [Line("trusted for the first time", tuple(times), tuple(share))]
    if times:
        lines.append(Line("own bound low enough at the end", (times[0], times[-1]), (able, able), limit=True))
    return Panel(f"{name}: time to trust", "time [s]", "share of runs", tuple(lines))


_SETTINGS: Final[dict[str, Cell]] = {
    "bias up to [nT]": LARGEST_BIAS_NT,
    "|D| up to": LARGEST_D,
    "orbits": ORBITS,
    "altitude [km]": "350 to 1000",
    "inclination [deg]": "0 to 110",
    "spin [rpm]": f"{_SLOWEST_RPM:g} to {_FASTEST_RPM:g}, both senses, logarithmic",
    "noise [nT]": f"{_QUIETEST_NT:g} to {_NOISIEST_NT:g}, logarithmic, told to the craft in half of the runs",
}

_NOTES: Final = (
    f"Trusted and wrong: at a tick, the verdict is `trusted` and one of the nine is off by more than {WRONG_SIGMAS:g} "
    f"of its own sigmas and by more than {WRONG_BIAS_NT:g} nT (b) or {WRONG_D:g} (D).",
    "Own bound: Cramer-Rao for magnitude and spin windows, 1 sigma of the worst bias axis at the end.",
    "Run number n of seed s can be flown alone: `convergence.fly_one(Job(n, method, seeds_of(s, n + 1)[n], None))`.",
)

STUDY = Study(
    "convergence", "Random errors, orbits, spins and axes: never trusted and wrong, and why not trusted.", 1000, run
)
