"""A craft's protection level, kept up to date tick by tick, and the test that its hazards have to pass unseen.

Sums go back to the filter's start.  They are looked at every 64 ticks at first, every 320 later, and when a chunk's
residual is large: each hazard is tested there, and what that test would not have seen is what the level allows for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.base.snapshot import SnapshotError, Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model import STATE_SIZE, Array, largest_variance
from magcal_service.ticks.assembler import Tick
from magcal_service.trust import hazard_sums as sums
from magcal_service.trust.hazard_look import CHUNK, LOOK_CHUNKS, Accumulated, Look, look
from magcal_service.trust.hazards import REMEDY, Hazard
from magcal_service.trust.protection import Level

FREE_CHUNKS: Final = 16
"""Chunks during which the sums are made anew at the newest estimate: what comes later is linear to a few nT."""

EARLY_CHUNKS: Final = 48
"""Chunks after each of which there is a look: for 51 minutes at 1 Hz the response to a late reference changes fast."""

_SAME_SIZE: Final = 3
"""Blocks of one size; beyond, the two oldest become one of twice the size, so a step's age is known to a third."""

_ROUGH_SIGMA: Final = 3.5
"""By how much a chunk's mean square has to exceed the usual one to be looked at: once in a day by chance."""

UNLOOKED_S: Final = float(CHUNK * LOOK_CHUNKS)
"""Time without a tick that is learned from [s] after which a level says nothing: as long as between two looks at 1 Hz.

Nobody looks meanwhile: what began to drift at 1000 nT/h then is 90 nT off, and 1700 nT before the estimate is stale.
"""

_MISSED_START: Final = (
    "the filter has learned from ticks that are in no sum, so no level is known until it starts anew: "
    "reset, or set protection = false"
)
"""What to do where the filter's start lies before what was observed, as after a process noise that was taken away."""

_DIRECTIONS: Final = 24
"""Samples whose vectors the level holds for: three of each of the newest eight chunks, ten minutes at 1 Hz."""


@dataclass(init=False, repr=False, eq=False)
class ProtectorMemory:
    """What of ``Protector`` outlives a restart, saved and restored whole."""

    level: Level | None
    seen: Hazard | None
    evidence: float
    _restarts: int
    _rows: list[tuple[float, ...]]
    _history: list[tuple[float, ...]]
    _ticks: int
    _samples: int
    _used: int
    _chunks: int
    _x: Array
    _sums: Array
    _sizes: list[int]
    _blocks: list[Array]
    _steps: list[Array]
    _response: Array
    _information: Array | None
    _variance_nt2: float
    _memory: list[float]
    _directions: list[tuple[float, ...]]
    _newest_s: float | None
    _paused: bool


class Protector(Stateful, ProtectorMemory):
    """One craft's hazards.

    Parameters
    ----------
    config: the craft's configuration.

    Attributes
    ----------
    level: the protection level; None while unknown, and after a pause of ``UNLOOKED_S`` until the next look.
    seen: the hazard with the largest evidence beyond the alarm at the last look; None where there is none.
    evidence: the largest of all hazards at the last look, in units of the alarm's.
    """

    def __init__(self, config: CraftConfig) -> None:
        self.config = config
        self._spin_rad_s = 0.0 if config.spin is None else config.spin.rate_rpm * 2.0 * math.pi / 60.0
        self._restarts = 0
        self._begin()

    def applies_to(self, estimate: StateEstimate) -> bool:
        """Whether a level can be given: it is asked for, and how the estimate responds to a disturbance is known."""
        return self.config.trust.watch and self.config.trust.protection and estimate.is_least_squares

    def level_of(self, estimate: StateEstimate, unlooked_s: float) -> Level | None:
        """The level, where the estimate still is one that it holds for.

        Parameters
        ----------
        estimate: as it stands.
        unlooked_s: how much newer the newest sample is than those learned from [s].
        """
        return None if unlooked_s > UNLOOKED_S or not self.applies_to(estimate) else self.level

    def why_none(self, estimate: StateEstimate, unlooked_s: float) -> str:
        """Why there is no level, in a few words, where none comes by itself after the start; else empty."""
        if estimate.phase is not Phase.RUNNING:
            return ""
        whys = (
            ("protection = false", not self.config.trust.protection),
            ("watch = false", not self.config.trust.watch),
            (estimate.departure, not estimate.is_least_squares),
            ("until the filter's next start", self._missed_start(estimate)),
            (f"nothing learned for {unlooked_s / 60.0:.0f} min", unlooked_s > UNLOOKED_S),
        )
        return next((why for why, holds in whys if holds), "")

    def remedy(self, estimate: StateEstimate, level: Level | None) -> str:
        """What would lower the level, or bring one; empty where it comes by itself."""
        if level is not None:
            return REMEDY[level.by]
        return _MISSED_START if self._missed_start(estimate) else ""

    def _missed_start(self, estimate: StateEstimate) -> bool:
        return self._information is None and estimate.phase is Phase.RUNNING and self.applies_to(estimate)

    def reset(self) -> None:
        """Discard all, as after a reset of the estimator."""
        self._restarts = 0
        self._begin()

    def _begin(self) -> None:
        self.level = self.seen = None
        self.evidence = 0.0
        self._rows, self._history, self._sizes, self._directions = [], [], [], []
        self._ticks = self._samples = self._used = self._chunks = 0
        self._x = np.zeros(STATE_SIZE)
        self._sums = np.zeros((sums.COLUMNS, sums.COLUMNS))
        self._blocks, self._steps, self._information = [], [], None
        self._response = np.zeros((STATE_SIZE, sums.RESIDUAL - STATE_SIZE))
        self._variance_nt2 = 0.0
        self._memory = [0.0, 0.0]
        self._newest_s, self._paused = None, False

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state; SnapshotError where its parts don't belong together."""
        super().restore_state(saved, where, given)
        count = len(self._sizes)
        sound = (
            {len(row) for row in (*self._rows, *self._history, *self._directions)} <= {5}
            and len(self._rows) < CHUNK
            and len(self._memory) == 2
            and all(size >= 1 for size in self._sizes)
            and (self._information is None or self._information.shape == (STATE_SIZE, STATE_SIZE))
            and len(self._blocks) == len(self._steps) == count
            and {one.shape for one in self._blocks} <= {(STATE_SIZE + 1, STATE_SIZE + 1)}
            and {one.shape for one in self._steps} <= {(STATE_SIZE, sums.STEADY)}
            and (self._information is not None or not count)
        )
        if not sound:
            raise SnapshotError(f"{where}: sums, blocks and rows don't belong together")

    # Ticks

    def observe(self, tick: Tick, estimate: StateEstimate) -> None:
        """Take a tick that the estimator has been given, with its estimate afterwards."""
        if not self.applies_to(estimate):
            if self._ticks:
                self._begin()
            return
        if estimate.restarts != self._restarts:
            self._begin()
            self._restarts = estimate.restarts
        try:
            self._add(tick, estimate)
        except np.linalg.LinAlgError:  # a covariance or sums that cannot be inverted: nothing is known again
            self._begin()

    def _add(self, tick: Tick, estimate: StateEstimate) -> None:
        self._ticks += 1
        self._samples += len(tick.times_s)
        row = (float(tick.times_s[-1]), *tick.field_body_nt[-1].tolist(), float(tick.reference_magnitude_nt[-1]))
        if self._newest_s is not None and row[0] - self._newest_s > UNLOOKED_S:
            self._rows.clear()  # the next look is at a whole chunk of what came after the pause
            self.level, self._paused = None, True
        self._newest_s = row[0]
        if estimate.phase is not Phase.RUNNING:
            self._history.append(row)
            del self._history[: -CHUNK * FREE_CHUNKS]
            return
        if self._information is None:
            if len(self._history) > 1:  # else it has not seen the start, and cannot know what the estimate is made of
                self._start(estimate)
            return
        self._rows.append(row)
        if len(self._rows) == CHUNK:
            self._close_chunk(estimate)

    def _start(self, estimate: StateEstimate) -> None:
        """The filter has its start: sums of what it was made of, and how it responds to that."""
        rows = np.array(self._history)
        columns = sums.columns_of(rows, estimate.x, estimate.noise_nt, self._spin_rad_s)
        sums.leave_out(columns, self._gate_nt(estimate, rows[-1, 1:4]))
        weight = self._samples / len(rows) / max(estimate.noise_nt**2, 1e-12)
        scalar = weight * columns[:, :STATE_SIZE].T @ columns
        self._information, self._variance_nt2 = _information(estimate), estimate.noise_nt**2
        before = self.config.filter.start_inflation**2 * self._information  # as the start was found
        middle = sums.errors_of(sums.courses(rows[:, 0], self._spin_rad_s)).mean(axis=0)
        learned = scalar[:, STATE_SIZE : sums.RESIDUAL] + (before - scalar[:, :STATE_SIZE]) @ middle
        self._response = np.linalg.solve(before, learned)
        self._keep_directions(rows[-_DIRECTIONS // 3 * CHUNK :])
        self._ticks = self._samples = 0
        whole = len(rows) // CHUNK
        self._history = self._history[len(rows) - whole * CHUNK :]
        if whole:
            self._sizes, self._steps = [whole], [np.zeros((STATE_SIZE, sums.STEADY))]
            self._relinearise(estimate)
            self._look()

    def _gate_nt(self, estimate: StateEstimate, field_nt: Array) -> float:
        spread = largest_variance(estimate.covariance, field_nt)
        return self.config.filter.gate_sigma * math.sqrt(estimate.noise_nt**2 + max(spread, 0.0))

    def _close_chunk(self, estimate: StateEstimate) -> None:
        rows = np.array(self._rows)
        weight = self._samples / max(self._ticks, 1)
        free = self._chunks < FREE_CHUNKS
        if free:
            self._x = estimate.x.copy()
        columns = sums.columns_of(rows, self._x, estimate.noise_nt, self._spin_rad_s)
        used = sums.leave_out(columns, self._gate_nt(estimate, rows[-1, 1:4]))
        own = columns.T @ columns
        self._respond(own, weight, rows[CHUNK // 2, 0], estimate)
        self._chunks += 1
        if free:
            self._history += self._rows
            self._relinearise(estimate)
            if self._chunks == FREE_CHUNKS:
                self._history.clear()
        else:
            self._sums = self._sums + own
            self._used += used
            self._blocks.append(_block(own))
            self._remember(columns)
        self._rows.clear()
        self._merge()
        self._keep_directions(rows)
        early = self._chunks <= EARLY_CHUNKS
        if early or self._paused or self._chunks % LOOK_CHUNKS == 0 or self._is_rough(own, used):
            self._paused = False
            self._look()

    def _is_rough(self, own: Array, used: int) -> bool:
        """Whether a chunk's residual is larger than noise makes it: something has just begun, and is looked at now."""
        usual = float(self._sums[-1, -1]) / max(self._used, 1)
        return float(own[-1, -1]) > (1.0 + _ROUGH_SIGMA * math.sqrt(2.0 / CHUNK)) * usual * used

    def _respond(self, own: Array, weight: float, middle_s: float, estimate: StateEstimate) -> None:
        """What the filter has made of a chunk, whose sums are ``own`` (33, 33); a step may have begun with it."""
        assert self._information is not None
        variance = max(estimate.noise_nt**2, 1e-12)
        before = self._information * (self._variance_nt2 / variance)  # a noise that is learned weighs all samples anew
        now = _information(estimate)
        scalar = weight * own[:STATE_SIZE] / variance
        learned = now - before
        errors = sums.errors_of(sums.courses(np.array(middle_s), self._spin_rad_s))
        driven = scalar[:, STATE_SIZE : sums.RESIDUAL] + (learned - scalar[:, :STATE_SIZE]) @ errors
        size = self._response.shape[1]
        steps = np.concatenate([*self._steps, np.zeros((STATE_SIZE, sums.STEADY))], axis=1)
        stepped = before @ steps + np.tile(learned[:, : sums.STEADY], len(self._steps) + 1)
        both = np.linalg.solve(now, np.concatenate([before @ self._response + driven, stepped], axis=1))
        self._response = both[:, :size]
        self._steps = [np.ascontiguousarray(one) for one in np.split(both[:, size:], len(self._steps) + 1, axis=1)]
        self._sizes.append(1)
        self._information, self._variance_nt2 = now, estimate.noise_nt**2

    def _relinearise(self, estimate: StateEstimate) -> None:
        """All sums anew at the newest estimate."""
        rows = np.array(self._history)
        self._x = estimate.x.copy()
        self._sums, self._used, self._memory = np.zeros((sums.COLUMNS, sums.COLUMNS)), 0, [0.0, 0.0]
        blocks, gate_nt = [], self._gate_nt(estimate, rows[-1, 1:4])
        for chunk in rows.reshape(-1, CHUNK, 5):
            columns = sums.columns_of(chunk, self._x, estimate.noise_nt, self._spin_rad_s)
            self._used += sums.leave_out(columns, gate_nt)
            own = columns.T @ columns
            self._sums = self._sums + own
            blocks.append(_block(own))
            self._remember(columns)
        begins = np.cumsum([0, *self._sizes[:-1]])
        self._blocks = list(np.add.reduceat(np.array(blocks), begins, axis=0))

    def _remember(self, columns: Array) -> None:
        """How far a chunk's residual, without what its nine errors absorb, goes on from one sample to the next."""
        fitted = np.linalg.lstsq(columns[:, :STATE_SIZE], columns[:, sums.RESIDUAL], rcond=1e-6)[0]
        rest = columns[:, sums.RESIDUAL] - columns[:, :STATE_SIZE] @ fitted
        self._memory = [self._memory[0] + float(rest[1:] @ rest[:-1]), self._memory[1] + float(rest @ rest)]

    def _merge(self) -> None:
        """Make one of the two oldest blocks of a size where there are too many of it; the start's stays as it is."""
        size = 1
        while size <= max(self._sizes):
            same = [index for index, one in enumerate(self._sizes) if one == size and index]
            if len(same) > _SAME_SIZE:
                first, second = same[:2]
                self._blocks[first] = self._blocks[first] + self._blocks.pop(second)
                self._sizes[first] += self._sizes.pop(second)
                del self._steps[second]
            size *= 2

    def _keep_directions(self, rows: Array) -> None:
        """Keep three samples of each of the newest eight chunks (n, 5)."""
        each = rows[10 :: CHUNK // 3] if self._chunks % 2 else rows[:: CHUNK // 3]
        self._directions = [*self._directions, *map(tuple, each.tolist())][-_DIRECTIONS:]

    # Looks

    def _look(self) -> None:
        """Test every hazard, and keep what would not have been seen."""
        found = self.looked()
        if found is not None:
            self.level, self.seen, self.evidence = found.level, found.seen, found.evidence

    def looked(self) -> Look | None:
        """A look at the sums as they stand, the newest whole chunk the last in them; None while there are none."""
        if not self._sizes:
            return None
        data = Accumulated(
            total=self._sums,
            used=self._used,
            sizes=self._sizes,
            blocks=self._blocks,
            steps=self._steps,
            response=self._response,
            newest=np.array(self._directions),
            memory=self._memory,
            spin_rad_s=self._spin_rad_s,
        )
        return look(data, self.config.trust)


def _information(estimate: StateEstimate) -> Array:
    """Inverse of the estimate's covariance, in units of the sums (9, 9)."""
    inverse: Array = np.linalg.inv(estimate.covariance / np.outer(sums.UNIT, sums.UNIT))
    return inverse


def _block(own: Array) -> Array:
    """Of a chunk's sums those of the nine errors and the residual (10, 10)."""
    ends = [*range(STATE_SIZE), sums.RESIDUAL]
    return own[np.ix_(ends, ends)]
