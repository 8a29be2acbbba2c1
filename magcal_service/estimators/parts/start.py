"""A safe start: a batch solution that cannot fall into the mirror, handed over with an inflated covariance.

The scalar cost has false minima (half-collapsed I + D, the mirror 1 + D33 < 0), so a filter with a wide prior must not
begin on it.  In theta = (E, c, s) with E = 2D + D^2, c = (I + D) b, s = |b|^2 equation (4) is linear, with one minimum:

    |B|^2 - |H|^2 - 3 s^2 = -B'E B + 2 B'c - s

Solved with the prior as a weak tie, turned into (b, D) by the positive square root of I + E, refined by Gauss-Newton on
noise-projected vectors together with the spin windows, and accepted only when it passes the gates.

Source: Alonso & Shuster 2002 (TWO-STEP: E and c, Gauss-Newton); the gates and the projection are original to this
project.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig, FilterConfig
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.spin_window import Window
from magcal_service.estimators.parts.start_gates import BAD_FIT, Proposal, handover_sigma, stopped_by, vector_sigma
from magcal_service.estimators.parts.start_problem import BatchProblem, WindowMeans, gauss_newton, linear_states
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array
from magcal_service.residuals import MEDIAN_TO_SIGMA, white_floor
from magcal_service.ticks.assembler import Tick

Entry = TypeVar("Entry")

_AMBIGUOUS: Final = 25.0
"""Advantage below which two distinct minima can't be distinguished (odds of e^12)."""

_OUTLIER: Final = 6.0
"""Sigmas beyond which a sample is left out of the start: Gaussian noise exceeds them twice in 10^9."""

_OUTLIER_PASSES: Final = 4
"""Passes of leaving samples out.

Choice: each costs a solution; the last counts even where one more would change what is left out.
"""

_FEWEST_KEPT: Final = 0.6
"""Least share of the samples that has to be left; choice: below it the fit is bad, whichever samples are blamed."""

_NOISE_PASSES: Final = 4
"""Passes of weighting by the residual that is left, until its level changes by less than 5 %.

Choice: most end after one or two; one that would go on is accepted as it is, and more passes would only cost solutions.
"""

_MAX_SAMPLES: Final = 4096
"""Samples kept for the start; beyond that every second one is dropped, again and again."""

_RETRY: Final = 1.15
"""Each attempt waits until there is this much more sample time than at the one before."""


@dataclass(frozen=True, slots=True)
class BatchSolution:
    """A batch estimate: state (9,), covariance (9, 9) for residuals of ``sigma_nt``, of which ``noise_nt`` is white."""

    x: Array
    covariance: Array
    sigma_nt: float
    noise_nt: float
    residual_rms_nt: float


def prior_sigma(config: FilterConfig) -> Array:
    """1 sigma of the nine states before any sample (9,) [nT, -]."""
    sigma = np.empty(STATE_SIZE)
    sigma[BIAS], sigma[D_ALL] = config.prior_bias_nt, config.prior_D
    return sigma


def batch_start(
    field_nt: Array,
    magnitude_nt: Array,
    windows: Sequence[Window],
    noise_nt: float | None,
    config: FilterConfig,
    thinned: int = 1,
) -> BatchSolution | StartGate:
    """A batch solution that passed every gate, or the gate that stopped it.

    A solution that is not sure enough is not given out at all: along a badly observed direction the cost is a curved
    valley, and its covariance there is too small by orders of magnitude.  Samples that arithmetic cannot be done with
    (zeros, one direction only) don't converge.

    Parameters
    ----------
    field_nt: measured vectors B (n, 3) [nT].
    magnitude_nt: |H| (n,) [nT].
    windows: finished spin windows, possibly none.
    noise_nt: 1 sigma per axis [nT]; None: taken from the residual, in two passes.
    config: prior and limits.
    thinned: each sample stands for this many, of which the others were dropped.
    """
    solution = batch_solution(field_nt, magnitude_nt, windows, noise_nt, config)
    if isinstance(solution, StartGate):
        return solution
    return gated(solution, field_nt, magnitude_nt, noise_nt, thinned)


def batch_solution(
    field_nt: Array, magnitude_nt: Array, windows: Sequence[Window], noise_nt: float | None, config: FilterConfig
) -> BatchSolution | StartGate:
    """A batch solution before it is put to the gates, or why there is none; parameters as ``batch_start``."""
    means = WindowMeans.of(windows)
    problem = BatchProblem(field_nt, magnitude_nt, means, prior_sigma(config), noise_nt or 0.0, noise_nt or 0.0)
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return _solve_without_outliers(problem, noise_nt is None)
    except np.linalg.LinAlgError:
        return StartGate.NO_CONVERGENCE


def gated(
    solution: BatchSolution, field_nt: Array, magnitude_nt: Array, noise_nt: float | None, thinned: int
) -> BatchSolution | StartGate:
    """The solution with the covariance of all samples, or the gate that stops it; parameters as ``batch_start``."""
    solution = replace(solution, covariance=solution.covariance / thinned)
    gate = stopped_by(
        Proposal(
            solution.x,
            solution.covariance,
            residual_rms_nt=solution.residual_rms_nt,
            largest_rms_nt=np.inf if noise_nt is None else BAD_FIT * noise_nt,
            is_unsure=lambda: (
                vector_sigma(solution.covariance, field_nt)
                > handover_sigma(solution.sigma_nt, float(magnitude_nt.mean()))
            ),
        )
    )
    return solution if gate is None else gate


def _solve_without_outliers(problem: BatchProblem, noise_unknown: bool) -> BatchSolution | StartGate:
    """The solution, less the samples and windows far outside its residual scatter, in passes.

    The scatter is taken from the median, so that spikes don't hide behind themselves.  Samples whose |B| alone stands
    far outside are left out from the beginning: a few of them would spoil the linear start.  Windows are of use when
    most of them agree; otherwise the running filter will find out why they don't.
    """
    length = np.linalg.norm(problem.field_nt, axis=1)
    keep = _within(length - np.median(length))
    windows = np.full(len(problem.windows.weight), bool(keep.all()))
    solution: BatchSolution | StartGate = StartGate.BAD_FIT
    for _ in range(_OUTLIER_PASSES):
        if np.count_nonzero(keep) < _FEWEST_KEPT * len(keep):
            return StartGate.BAD_FIT
        part = problem.only(keep, windows)
        solution = _solve_with_unknown_noise(part) if noise_unknown else _solve(part)
        if isinstance(solution, StartGate):
            return solution
        sound = _within(problem.residuals(solution.x))
        residual = problem.windows.residuals(solution.x, solution.sigma_nt)
        passed = (residual**2).sum(axis=1) < _OUTLIER**2
        if (sound == keep).all() and ((passed == windows).all() or not windows.any()):
            break
        keep = sound
        windows = passed if np.count_nonzero(passed) >= _FEWEST_KEPT * len(passed) else np.zeros_like(passed)
    return solution


def _within(values: Array) -> NDArray[np.bool_]:
    """Which values (..., n) lie within 6 sigma of zero, sigma taken from their median."""
    size = np.abs(values)
    inside: NDArray[np.bool_] = size <= _OUTLIER * MEDIAN_TO_SIGMA * np.median(size, axis=-1, keepdims=True)
    return inside


def without_outliers(problem: BatchProblem) -> NDArray[np.bool_]:
    """Which problems of a stack (r,) have no |B| that stands far outside."""
    length = np.linalg.norm(problem.field_nt, axis=2)
    return np.asarray(_within(length - np.median(length, axis=1, keepdims=True)).all(axis=1))


def fits_all(problem: BatchProblem, x: Array) -> bool:
    """Whether a solution (9,) leaves no sample and no window out."""
    passed = (problem.windows.residuals(x, problem.sigma_nt) ** 2).sum(axis=1) < _OUTLIER**2
    return bool(_within(problem.residuals(x)).all() and passed.all())


def _solve(problem: BatchProblem) -> BatchSolution | StartGate:
    """The lower of the minima reached from the linear start and from zero; ambiguous ones are poor coverage."""
    linear, positive = linear_states(problem)
    starts = [linear, np.zeros(STATE_SIZE)] if positive else [np.zeros(STATE_SIZE)]
    found = [result for start in starts if (result := gauss_newton(problem, start)) is not None]
    if not found:
        return StartGate.NO_CONVERGENCE if positive else StartGate.NOT_POSITIVE
    return lowest(problem, found)


def lowest(problem: BatchProblem, found: Sequence[tuple[Array, Array]]) -> BatchSolution | StartGate:
    """The best of one or two minima (state, covariance) of a problem, unless they are distinct and as good."""
    x, covariance = found[0]
    for other, its_covariance in found[1:]:
        step = x - other
        apart = max(float(step @ np.linalg.solve(each, step)) for each in (covariance, its_covariance))
        if apart <= _AMBIGUOUS:  # two roads to one minimum: the one that came nearer to it
            better = bool(problem.normal_equations(other)[2] < problem.normal_equations(x)[2])
        else:
            better = problem.advantage(other, x) >= _AMBIGUOUS
            if not better and problem.advantage(x, other) < _AMBIGUOUS:
                return StartGate.POOR_COVERAGE
        if better:
            x, covariance = other, its_covariance
    rms = float(np.sqrt(np.mean(problem.residuals(x) ** 2)))
    return BatchSolution(x, covariance, problem.sigma_nt, min(problem.noise_nt, problem.sigma_nt), rms)


def _solve_with_unknown_noise(problem: BatchProblem) -> BatchSolution | StartGate:
    """Weight by the residual that is left, in passes; only its white part counts as sensor noise."""
    scale = float(problem.magnitude_nt.mean())
    problem = replace(problem, sigma_nt=0.03 * scale)
    for _ in range(_NOISE_PASSES):
        solution = _solve(problem)
        if isinstance(solution, StartGate):
            return solution
        residual = problem.residuals(solution.x)
        sigma_nt = max(solution.residual_rms_nt, 1e-4 * scale)
        if abs(sigma_nt / problem.sigma_nt - 1.0) < 0.05:
            break
        problem = replace(problem, sigma_nt=sigma_nt, noise_nt=min(sigma_nt, white_floor(residual)))
    return solution


@dataclass(init=False, repr=False, eq=False)
class StartBufferMemory(Generic[Entry]):
    """What of ``StartBuffer`` outlives a restart, saved and restored whole."""

    stride: int
    samples: int
    seconds: float
    _kept: list[tuple[int, Entry]]
    _seen: int
    _last_s: float | None
    _attempt_at_s: float


class StartBuffer(Stateful, StartBufferMemory[Entry]):
    """What is kept towards a start, one entry a tick, and when a start is due.

    Parameters
    ----------
    start_s: sample time after which a start is first tried [s].
    """

    def __init__(self, start_s: float) -> None:
        self.stride = 1
        self.samples = 0
        self.seconds = 0.0
        self._kept = []
        self._seen = 0
        self._last_s = None
        self._attempt_at_s = start_s

    @property
    def entries(self) -> list[Entry]:
        """Those kept, in order; every ``stride``-th of those added."""
        return [entry for _, entry in self._kept]

    def add(self, tick: Tick, entry: Entry) -> None:
        """Take what is to be kept of a tick; with too many samples every second entry goes."""
        self._seen += 1
        now_s = float(tick.times_s[-1])
        if self._last_s is not None and not tick.after_gap:
            self.seconds += now_s - self._last_s
        self._last_s = now_s
        if self._seen % self.stride == 0:
            self._kept.append((len(tick.times_s), entry))
            self.samples += len(tick.times_s)
        if self.samples > _MAX_SAMPLES:
            self._kept = self._kept[::2]
            self.stride *= 2
            self.samples = sum(count for count, _ in self._kept)

    def due(self) -> bool:
        """Whether a start is to be tried now; the next attempt is put off by as much as this one has seen."""
        if self.seconds < self._attempt_at_s or self.samples <= 2 * STATE_SIZE:
            return False
        self._attempt_at_s = max(self.seconds * _RETRY, self.seconds + 10.0)
        return True


@dataclass(init=False, repr=False, eq=False)
class StartCollectorMemory:
    """What of ``StartCollector`` outlives a restart, saved and restored whole."""

    gate: StartGate | None
    spin_contradicted: bool
    noise_contradicted: bool
    _ticks: StartBuffer[Tick]
    _windows: list[Window]


class StartCollector(Stateful, StartCollectorMemory):
    """Collects ticks until a batch solution passes every gate.

    Parameters
    ----------
    config: the craft's configuration.  ``filter.start_s`` is when a start is first tried; when the residual still
        contradicts ``sensor.noise_nt`` after ``filter.start_max_s``, the noise is taken from the residual instead.

    Attributes
    ----------
    gate: what stopped the last attempt.
    spin_contradicted: the solution is one without the spin windows, because with them nothing fitted.
    noise_contradicted: the solution is one that takes the noise from the residual.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self.gate = None
        self.spin_contradicted = False
        self.noise_contradicted = False
        self._ticks = StartBuffer(config.filter.start_s)
        self._windows = []

    @property
    def samples(self) -> int:
        """Samples kept."""
        return self._ticks.samples

    def push(self, tick: Tick, window: Window | None) -> BatchSolution | None:
        """Add a tick and the window that ended in it; a solution once there is one to hand over."""
        self._ticks.add(tick, tick)
        if window is not None:
            self._windows.append(window)
        if not self._ticks.due():
            return None
        result = self._attempt()
        if isinstance(result, BatchSolution):
            return result
        self.gate = result
        return None

    def _attempt(self) -> BatchSolution | StartGate:
        """All samples and windows; without the windows where they contradict; at last without the given noise."""
        noise_nt = self.config.sensor.noise_nt
        result = self._solve(self._windows, noise_nt)
        if result is StartGate.BAD_FIT and self._windows:
            alone = self._solve((), noise_nt)
            self.spin_contradicted = isinstance(alone, BatchSolution)
            result = alone
        if result is StartGate.BAD_FIT and self._ticks.seconds > self.config.filter.start_max_s:
            result = self._solve((), None)
            self.noise_contradicted = isinstance(result, BatchSolution)
        return result

    def _solve(self, windows: Sequence[Window], noise_nt: float | None) -> BatchSolution | StartGate:
        ticks = self._ticks.entries
        field = np.concatenate([tick.field_body_nt for tick in ticks])
        magnitude = np.concatenate([tick.reference_magnitude_nt for tick in ticks])
        return batch_start(field, magnitude, windows, noise_nt, self.config.filter, self._ticks.stride)
