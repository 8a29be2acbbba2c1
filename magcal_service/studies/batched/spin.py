"""``spin`` for many runs at once: the same filter and the same fits, with an axis of runs, for Monte-Carlo studies.

All runs share the sample times and the reference and differ in what was measured.  The filters go together
(``batched_spin_state``), and beside them, until all have started, their scalar filters (``batched_ukf``).  Starts and
fits are those of ``SpinSearch``, one run at a time.  Results agree with ``spin`` to rounding (a test holds that).

Not covered, and rejected: unknown noise and process noise.  A run whose scalar filter leaves its batch before the spin
has started, whose spin is lost or may change, or that has to drop samples for want of room is marked ``left``: it goes
no further and has to be repeated alone.

Source: as ``spin``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.estimators.spin import configured_tie
from magcal_service.estimators.steady_spin.fit import Samples
from magcal_service.estimators.steady_spin.sample_buffer import CAPACITY
from magcal_service.estimators.steady_spin.search import SpinSearch, SpinStart, retry_at
from magcal_service.estimators.steady_spin.state import ERRORS, SpinState
from magcal_service.estimators.steady_spin.watch import BLOCK, BLOCK_LIMIT, BLOCKS, DRIFT_LIMIT, MEMORY, RATIO_LIMIT
from magcal_service.model import Array
from magcal_service.studies.batched.spin_state import SpinInnovations, SpinStates
from magcal_service.studies.batched.ukf import BatchedUkf
from magcal_service.ticks.assembler import Tick

Flags = NDArray[np.bool_]

_SPARE: Final = 64
"""Room for the samples that others take in place of those they have rejected."""

_MOST_REJECTED: Final = 5
"""Samples rejected in a row at which a run leaves; ``spin`` gives the spin up at 30."""


class BatchedSpin:
    """The spin estimators of many runs.

    Parameters
    ----------
    config: the craft's configuration, the same for every run.
    runs: how many.

    Attributes
    ----------
    left: runs that have to be repeated alone (runs,).

    Raises ValueError where the configuration needs the estimator alone (see ``supports``).
    """

    def __init__(self, config: CraftConfig, runs: int) -> None:
        if not self.supports(config):
            raise ValueError("sensor.noise_nt = None or process noise: not in a batch, run it alone")
        self._noise_nt = config.sensor.noise_nt or 0.0
        self._limit = config.filter.gate_sigma**2 + 3.0
        self._scalar: BatchedUkf | None = BatchedUkf(replace(config, spin=None), runs)
        self._scalar_running: Flags = np.zeros(runs, dtype=bool)
        self._searches = [SpinSearch(config, 0.0, configured_tie(config, 0.0)) for _ in range(runs)]
        self.left: Flags = np.zeros(runs, dtype=bool)
        self._started: Flags = np.zeros(runs, dtype=bool)
        self._history = _History(runs)
        self._attempt_at_s = np.full(runs, self._searches[0].first_attempt_s)
        self._refining: Flags = np.ones(runs, dtype=bool)
        # by column: run number, filter and watch of the runs in progress, which fill the first columns
        self._run = np.arange(runs)
        self._active = 0
        self._states = SpinStates(runs)
        self._watch = _Watches.of(runs)
        self._time_s = 0.0

    @staticmethod
    def supports(config: CraftConfig) -> bool:
        """Whether a configuration can be run in a batch."""
        walk = any(config.filter.process_noise_bias_nt + config.filter.process_noise_D)
        return BatchedUkf.supports(replace(config, spin=None)) and not walk

    @property
    def running(self) -> Flags:
        """Runs that have an estimate (runs,)."""
        return self._started | self._scalar_running

    @property
    def x(self) -> Array:
        """The states (runs, 9) [nT, -]: of the spin where it has started, of the scalar filter elsewhere."""
        x = self._scalar.x if self._scalar is not None else np.zeros((len(self._run), 9))
        x[self._run[: self._active]] = self._states.x[:, : self._active].T
        return x

    @property
    def covariance(self) -> Array:
        """Their covariances (runs, 9, 9)."""
        covariance = self._scalar.covariance if self._scalar is not None else np.zeros((len(self._run), 9, 9))
        own = self._states.covariance[ERRORS, ERRORS, : self._active]
        covariance[self._run[: self._active]] = np.moveaxis(own, 2, 0)
        return covariance

    def handle(self, tick: Tick, field_body_nt: Array) -> None:
        """Take one tick of every run.

        Parameters
        ----------
        tick: one sample's time and reference vector; its measured vector is not used.
        field_body_nt: measured vectors B (runs, 3) [nT]; fastest where the runs are next to each other in memory.
        """
        if tick.reference_eci_nt is None or tick.after_gap:
            raise ValueError("a tick without a reference vector, or after a gap: not in a batch, run it alone")
        reference, now_s = tick.reference_eci_nt[-1], float(tick.times_s[-1])
        self._history.add(now_s, field_body_nt, reference)
        if self._scalar is not None:
            self._follow_scalar(self._scalar, tick, field_body_nt)
        if self._active:
            self._track(field_body_nt, reference, now_s)
            self._refine(now_s)
        if self._scalar is not None:
            self._collect(self._scalar, now_s)
        self._leave()
        self._time_s = now_s

    def _follow_scalar(self, scalar: BatchedUkf, tick: Tick, field_nt: Array) -> None:
        scalar.handle(tick, field_nt)
        self._scalar_running = scalar.running
        self.left |= scalar.left & ~self._started

    def _collect(self, scalar: BatchedUkf, now_s: float) -> None:
        """Starts of the runs that wait; with the last one the scalar filters have done their part."""
        waiting = ~(self._started | self.left)
        due = waiting & scalar.running & (self._history.seconds(now_s) >= self._attempt_at_s)
        if due.any():
            x, covariance = scalar.x, scalar.covariance
            for run in np.flatnonzero(due).tolist():
                self._attempt_at_s[run] = retry_at(self._history.seconds(now_s))
                self._attempt(run, self._estimate(x[run], covariance[run]), now_s)
        if self._history.full:
            self.left |= ~self._started
        if not (~(self._started | self.left)).any():
            self._scalar = None

    def _estimate(self, x: Array, covariance: Array) -> StateEstimate:
        return StateEstimate(x, covariance, Phase.RUNNING, self._noise_nt, 0, 0, 0, None, False)

    def _attempt(self, run: int, scalar: StateEstimate, now_s: float) -> None:
        start = self._searches[run].start_of(self._history.samples(run), scalar, now_s)
        if not isinstance(start, SpinStart):
            return
        if start.rate_walk:
            self.left[run] = True
            return
        column = int(np.flatnonzero(self._run == run)[0])
        self._swap(column, self._active)
        self._states.put(self._active, start.state)
        self._active += 1
        self._started[run] = True

    def _track(self, field_nt: Array, reference_eci_nt: Array, now_s: float) -> None:
        """``SpinTracker.handle`` for every run in progress."""
        count = self._active
        self._states.predict(count, now_s - self._time_s)
        runs = self._run[:count]
        found = self._states.innovations(count, field_nt.T[:, runs], reference_eci_nt, self._noise_nt**2)
        used = found.squared_norm() <= self._limit
        self._states.apply(found, used.astype(np.float64))
        lost = self._watch.check(found, self._states.body_from_eci[:, :, :count], used)
        self.left[runs[lost]] = True
        self._history.leave_out(runs[~used])

    def _refine(self, now_s: float) -> None:
        """The fits of ``SpinSearch.refine``, for the runs for which it is time."""
        runs = self._run[: self._active]
        if self._history.closed:
            self.left[runs[self._refining[runs]]] = True
        wanted = self._refining[runs] & ~self.left[runs] & self._history.newest_taken(runs)
        full = self._history.counts[runs] >= CAPACITY
        due = wanted & (full | (self._history.seconds(now_s) >= self._attempt_at_s[runs]))
        for column in np.flatnonzero(due).tolist():
            run = int(runs[column])
            self._attempt_at_s[run] = retry_at(self._history.seconds(now_s))
            samples = self._history.samples(run)
            state = self._searches[run].refit(samples, self._states.get(column), self._noise_nt)
            self._refining[run] = not full[column]
            if isinstance(state, SpinState):
                self._states.put(column, state)
            else:
                self.left[run] = True

    def _swap(self, one: int, other: int) -> None:
        """Exchange two columns."""
        pair, crossed = [one, other], [other, one]
        states = self._states
        for rows in (self._run, states.x, states.body_from_eci, states.rate_rad_s, states.covariance):
            rows[..., pair] = rows[..., crossed]
        self._watch.swap(pair, crossed)

    def _leave(self) -> None:
        """All that have left make room."""
        for column in np.flatnonzero(self.left[self._run[: self._active]])[::-1].tolist():
            self._active -= 1
            self._started[self._run[column]] = False
            self._swap(column, self._active)


class _History:
    """Every sample of every run, for the fits; one that the gate has stopped is left out of its run.

    Attributes
    ----------
    counts: samples taken by run (runs,).
    """

    def __init__(self, runs: int) -> None:
        self.counts = np.zeros(runs, dtype=int)
        self._times_s = np.empty(CAPACITY + _SPARE)
        self._reference_nt = np.empty((CAPACITY + _SPARE, 3))
        self._fields_nt = np.empty((CAPACITY + _SPARE, 3, runs))
        self._rows = 0
        self._left_out: dict[int, list[int]] = {}
        self._newest_out: Flags = np.zeros(runs, dtype=bool)

    @property
    def full(self) -> bool:
        """Whether a run that has taken every sample has no room for more."""
        return self._rows >= CAPACITY

    @property
    def closed(self) -> bool:
        """Whether there is no room for any run."""
        return self._rows == len(self._times_s)

    def add(self, time_s: float, field_nt: Array, reference_eci_nt: Array) -> None:
        """Take a sample of every run: B (runs, 3) and H (3,) [nT]; nothing more once it is closed."""
        self._newest_out[:] = self.closed
        if self.closed:
            return
        self._times_s[self._rows], self._reference_nt[self._rows] = time_s, reference_eci_nt
        self._fields_nt[self._rows] = field_nt.T
        self._rows += 1
        self.counts += 1

    def leave_out(self, runs: NDArray[np.intp]) -> None:
        """The newest sample of these runs does not count."""
        if self.closed:
            return
        self._newest_out[runs] = True
        self.counts[runs] -= 1
        for run in runs.tolist():
            self._left_out.setdefault(run, []).append(self._rows - 1)

    def newest_taken(self, runs: NDArray[np.intp]) -> Flags:
        """Whether the newest sample of runs counts."""
        taken: Flags = ~self._newest_out[runs]
        return taken

    def seconds(self, now_s: float) -> float:
        """Sample time since the first sample [s]."""
        return now_s - float(self._times_s[0])

    def samples(self, run: int) -> Samples:
        """What a run has taken, with times before the newest."""
        rows = self._rows
        times, field, reference = self._times_s[:rows], self._fields_nt[:rows, :, run], self._reference_nt[:rows]
        left_out = self._left_out.get(run)
        if left_out:
            times, field, reference = (np.delete(part, left_out, axis=0) for part in (times, field, reference))
        return Samples(times - times[-1], np.ascontiguousarray(field), reference)


@dataclass(slots=True)
class _Watches:
    """``SpinWatch`` of many runs without gaps: what it keeps, by column."""

    count: Array
    along: Array
    across: Array
    sums: Array
    variance: Array
    in_block: Array
    blocks: Array
    drift: Array
    rejected: Array

    @classmethod
    def of(cls, runs: int) -> _Watches:
        """Before any sample."""
        zero, one = np.zeros(runs), np.ones(runs)
        return cls(
            zero.copy(),
            one.copy(),
            one.copy(),
            np.zeros((3, runs)),
            zero.copy(),
            zero.copy(),
            zero.copy(),
            one.copy(),
            zero,
        )

    def swap(self, pair: list[int], crossed: list[int]) -> None:
        """Exchange two columns."""
        for rows in (self.count, self.along, self.across, self.sums, self.variance):
            rows[..., pair] = rows[..., crossed]
        for rows in (self.in_block, self.blocks, self.drift, self.rejected):
            rows[..., pair] = rows[..., crossed]

    def check(self, found: SpinInnovations, body_from_eci: Array, used: Flags) -> Flags:
        """``SpinWatch.accepted`` or ``rejected`` for the first runs; which have lost their spin (r,)."""
        count = len(used)
        self.rejected[:count] = np.where(used, 0.0, self.rejected[:count] + 1.0)
        trace = found.covariance[0, 0] + found.covariance[1, 1] + found.covariance[2, 2]
        lost = self._compare(found, trace, used)
        lost |= self._drifts(found, trace, body_from_eci, used)
        lost |= self.rejected[:count] >= _MOST_REJECTED
        return lost

    def _compare(self, found: SpinInnovations, trace: Array, used: Flags) -> Flags:
        """Across against along, each over its expectation."""
        rows = slice(0, len(used))
        y, h = found.value, found.field_body_nt
        square = (h * h).sum(axis=0)
        along, total = (h * y).sum(axis=0) ** 2 / square, (y * y).sum(axis=0)
        along_expected = (h * np.einsum("abr,br->ar", found.covariance, h)).sum(axis=0) / square
        self.count[rows] = np.minimum(self.count[rows] + used, MEMORY)
        weight = used / np.maximum(self.count[rows], 1.0)
        self.along[rows] += weight * (along / along_expected - self.along[rows])
        self.across[rows] += weight * ((total - along) / (trace - along_expected) - self.across[rows])
        lost: Flags = (self.count[rows] == MEMORY) & (self.across[rows] > RATIO_LIMIT * self.along[rows])
        return lost

    def _drifts(self, found: SpinInnovations, trace: Array, body_from_eci: Array, used: Flags) -> Flags:
        """Block means in space; the noise level is that along the field."""
        rows = slice(0, len(used))
        self.sums[:, rows] += used * np.einsum("ar,abr->br", found.value, body_from_eci)
        self.variance[rows] += used * trace
        self.in_block[rows] += used
        lost: Flags = np.zeros(len(used), dtype=bool)
        ended = np.flatnonzero(self.in_block[rows] == BLOCK)
        if not len(ended):
            return lost
        sums = self.sums[:, ended]
        squared = (sums * sums).sum(axis=0) / (self.variance[ended] * np.maximum(self.along[ended], 1e-12))
        self.sums[:, ended], self.variance[ended], self.in_block[ended] = 0.0, 0.0, 0.0
        self.blocks[ended] = np.minimum(self.blocks[ended] + 1.0, BLOCKS)
        self.drift[ended] += (squared - self.drift[ended]) / self.blocks[ended]
        lost[ended] = (squared > BLOCK_LIMIT) | ((self.blocks[ended] == BLOCKS) & (self.drift[ended] > DRIFT_LIMIT))
        return lost
