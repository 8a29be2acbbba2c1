"""The bias of one axis jumps by 200 nT: how fast is each method back, and what does that cost in the quiet?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig, FilterConfig
from magcal_service.estimators.sliding_batch import SlidingBatch
from magcal_service.model import Array
from magcal_service.studies.flights import FlightPlan
from magcal_service.studies.montecarlo import Ensemble, seeds_of, simulate
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study

STEP_NT: Final = 200.0
"""How far the bias jumps [nT]: twice the noise of a sample, so that no sample alone shows it."""

SHARE_BEFORE: Final = 0.5
"""Share of the flight before the jump: the filter has settled, and as much is left to follow in."""

NOISE_NT: Final = 100.0
"""Noise per axis [nT]: a third of the paper's; choice: a jump of 200 nT is worth following at that level."""

WALKS_NT: Final = (0.3, 1.0, 3.0)
"""Process noise of each bias axis [nT/sqrt(s)]: 1 nT/sqrt(s) grows to 60 nT in an hour."""

WALK_D: Final = 1e-9
"""Process noise of each element of D [1/sqrt(s)]: none to speak of, 6e-8 in an hour; only the bias jumps."""

CLOSE_NT: Final = 50.0
"""Back: within this of the truth [nT], a quarter of the jump; or within three formal sigmas."""

HOLD_S: Final = 300.0
"""Back: inside the limit from then on for this long."""

_EVERY_S: Final = 20.0
"""Between two estimates that are looked at [s]: the resolution of the times to be back."""


@dataclass(frozen=True, slots=True)
class Follower:
    """A method with a setting that decides how fast it follows."""

    label: str
    config: CraftConfig


def run(request: Request) -> Findings:
    """The jump in the axis across the spin and in the one along it, for every follower."""
    duration_s = request.duration_s or FlightPlan().duration_s
    at_s = np.append(np.arange(0.3 * duration_s, duration_s - 1.0, _EVERY_S), duration_s - 1.0)
    tables: list[Table] = []
    panels: list[Panel] = []
    figures: dict[str, Cell] = {}
    for axis, name in ((0, "bx, across the spin axis"), (2, "bz, along the spin axis")):
        jump = (STEP_NT if axis == 0 else 0.0, 0.0, STEP_NT if axis == 2 else 0.0)
        at = SHARE_BEFORE * duration_s
        plan = FlightPlan(duration_s=duration_s, step_at_s=at, step_nt=jump, noise_nt=NOISE_NT)
        rows, lines = [], []
        for follower in _followers(plan, request.methods):
            seeds = seeds_of(request.seed, request.runs or STUDY.runs)
            label = f"step in {name[:2]}, {follower.label}"
            ensemble = simulate(plan, follower.config, seeds, request.executor, at_s.tolist(), label)
            row = _row(follower.label, ensemble, plan.step_at_s, axis)
            rows.append(row)
            figures[f"{name[:2]}: {follower.label}: time to be back, median [s]"] = row[1]
            lines.append(Line(follower.label, tuple(at_s.tolist()), tuple(_rms(ensemble, axis).tolist())))
        tables.append(Table(f"{STEP_NT:g} nT in {name}", _COLUMNS, tuple(rows)))
        panels.append(Panel(f"{STEP_NT:g} nT in {name}", "time [s]", "rms error [nT]", tuple(lines), log_y=True))
    settings: dict[str, Cell] = {
        "duration [s]": duration_s, "step at [s]": SHARE_BEFORE * duration_s, "noise [nT]": NOISE_NT,
        "estimates every [s]": _EVERY_S,
    }  # fmt: skip
    return Findings(tuple(tables), figures, settings, _NOTES, tuple(panels))


def _followers(plan: FlightPlan, methods: tuple[str, ...]) -> list[Follower]:
    """``ukf`` with no, adaptive and fixed process noise, and the sliding batch; or the methods that are named."""
    if methods:
        return [Follower(name, plan.craft(FilterConfig(method=name))) for name in methods]
    followers = [
        Follower("ukf, no process noise", plan.craft(FilterConfig())),
        Follower("ukf, adaptive", plan.craft(FilterConfig(adaptive=True))),
    ]
    for walk in WALKS_NT:
        settings = FilterConfig(process_noise_bias_nt=(walk, walk, walk), process_noise_D=(WALK_D,) * 6)
        followers.append(Follower(f"ukf, {walk:g} nT/sqrt(s)", plan.craft(settings)))
    return [*followers, Follower(SlidingBatch.name, plan.craft(FilterConfig(method=SlidingBatch.name)))]


_COLUMNS: Final = (
    "method", "back within 3 own sigma, median [s]", "share that was", f"back within {CLOSE_NT:g} nT, median [s]",
    "share that was", "rms error before [nT]", "rms error at the end [nT]", "own sigma at the end [nT]", "restarts",
)  # fmt: skip


def _row(label: str, ensemble: Ensemble, step_at_s: float, axis: int) -> tuple[Cell, ...]:
    error, sigma = np.abs(ensemble.error[:, :, axis]), ensemble.sigma[:, :, axis]
    after = ensemble.at_s >= step_at_s
    since = ensemble.at_s[after] - step_at_s
    own = [_back(row, since) for row in (error <= 3.0 * sigma)[:, after] & ensemble.started[:, after]]
    close = [_back(row, since) for row in (error <= CLOSE_NT)[:, after] & ensemble.started[:, after]]
    rms = _rms(ensemble, axis)
    quiet = float(rms[np.flatnonzero(~after)[-1]])
    own_sigma = float(np.sqrt(np.mean(sigma[:, -1] ** 2)))
    restarts = int(ensemble.restarts.sum())
    return (label, *_median(own), *_median(close), quiet, float(rms[-1]), own_sigma, restarts)


def _back(inside: NDArray[np.bool_], since_s: Array) -> float:
    """First time from which on it stays inside for ``HOLD_S`` [s]; inf where it never does."""
    outside_s = since_s[~inside]
    for i in np.flatnonzero(inside).tolist():
        until_s = since_s[i] + HOLD_S
        if until_s <= since_s[-1] and not ((outside_s > since_s[i]) & (outside_s <= until_s)).any():
            return float(since_s[i])
    return float("inf")


def _median(times_s: list[float]) -> tuple[Cell, Cell]:
    """Median time, None where less than half came back, and the share that did."""
    share = float(np.isfinite(times_s).mean())
    return (float(np.median(times_s)) if share > 0.5 else None), share


def _rms(ensemble: Ensemble, axis: int) -> Array:
    """rms error of one axis over the runs at each time (k,) [nT]."""
    rms: Array = np.sqrt(np.mean(ensemble.error[:, :, axis] ** 2, axis=0))
    return rms


_NOTES: Final = (
    f"Back: the error of that axis is inside the limit at a time and stays there for {HOLD_S:g} s. A dash: less than "
    "half of the runs came back before the end. Within 3 own sigma asks for consistency, within a fixed distance for "
    "use.",
    "A filter without process noise has a sigma that only shrinks; what brings it back is a restart, where it notices. "
    "The adaptive one looks for jumps and gives process noise at the jump alone.",
)

STUDY = Study("step", "A step of 200 nT: time to be back, with process noise, without, and by sliding batch.", 50, run)
