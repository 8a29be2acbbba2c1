"""The daemon's watch over its model: does the residual follow something that the nine errors leave out, and what?

One sample of each tick that was learned from goes into sums over a window of up to ``TICKS``; at the end of each block
the sums are tested for what would explain the residual (``watch_evidence``).  Windows don't overlap and hold a
reference state each, with the nine errors fitted again: how the filter weighs its past does not enter, and the
noise of the sums is as white as the sensor's.  A finding stands until a whole window has passed without it.

Of a sensor faster than 1 Hz the newest sample of each tick is used.  Where the errors are allowed to walk
(``process_noise``), each block has its nine errors, and drifts and steps of them are no finding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.snapshot import SnapshotError, Stateful
from magcal_service.estimators.interface import StateEstimate
from magcal_service.model import (
    BIAS,
    STATE_SIZE,
    Array,
    d_matrix,
    field_jacobian,
    largest_variance,
    without_radial_noise,
)
from magcal_service.physics.acting import Watched
from magcal_service.physics.catalogue import watched_as
from magcal_service.ticks.assembler import Tick
from magcal_service.watch.drivers import Driver, DriverTrack, value_of
from magcal_service.watch.evidence import (
    CLASS_NATS,
    FALSE_PER_YEAR,
    UNKNOWN,
    Explanation,
    courses,
    of_columns,
    spectral,
    without,
)

CHUNK: Final = 64
"""Ticks of a chunk, whose spectrum is taken: a minute at 1 Hz, lines a sixtieth of a Hz apart.

Choice: longer chunks resolve lines better and are spoilt by a few outliers more often.
"""

BLOCK: Final = 320
"""Ticks of a block, after which the sums are evaluated: five chunks; twice as often would need 0.7 nats more each."""

TICKS: Final = 5120
"""Ticks of a window: 85 min at 1 Hz, nearly a low orbit with its eclipse."""

FIRST_EVALUATION: Final = 3 * BLOCK
"""Ticks before the first evaluation: two blocks always lie on a line, so that no drift differs from a step."""

_YEAR_S: Final = 31_557_600.0
"""Seconds in a year of 365.25 days."""

_TESTS: Final = 150
"""Tests in one evaluation at the most: 16 drivers and their channels, courses, 58 steps, 31 lines, 13 memories."""

ALARM_NATS: Final = math.log(_YEAR_S / BLOCK * _TESTS / FALSE_PER_YEAR)
"""Significance from which an explanation is reported: -ln of a false alarm's probability in one test."""

_BINS: Final = CHUNK // 2 + 1  # of the two-sided spectrum of a chunk that are different for real values
_BIN_WEIGHT: Final = np.r_[0.5, np.ones(_BINS - 2), 0.5]  # the first and the last bin have one number, the others two
_NULL: Final = 1e-6  # directions of the nine errors that a chunk has less of are not projected out of it
_OWN: Final = 7  # columns without a driver: cubes of the reading 3, what is beyond its largest 3, slope of |H| 1
_FAR_NT: Final = 5e4  # [nT] unit of the readings in their cubes: a strong field, so that columns have sizes near one
_MOST_ALONE: Final = 2  # samples far off by themselves in a chunk that is still used
_WIDER: Final = 2.0  # than the filter's gate: samples in a row that jump out of that count as if there
_UNKNOWN_SHARE: Final = 1.25  # of the best name's evidence that the unknown has to have: the name then leaves a fifth
_FLAT: Final = 10  # times that an axis has to repeat its largest reading for a flat top


@dataclass(frozen=True, slots=True)
class Finding:
    """What the model seems to leave out.

    Parameters
    ----------
    effects: names of the catalogue, the likeliest first; several where they cannot be distinguished; or ``unknown``.
    driver: what it follows, in words; empty where nothing.
    nats: evidence for it.
    minutes: length of the data behind it.
    """

    effects: tuple[str, ...]
    driver: str
    nats: float
    minutes: float

    def __str__(self) -> str:
        driver = f" ({self.driver})" if self.driver else ""
        what = "something unknown" if self.effects == (UNKNOWN,) else " or ".join(self.effects)
        return f"looks like {what}{driver}, {self.nats:.0f} nats over {self.minutes:.0f} min"


def _width(driver: Driver) -> int:
    """Columns of a driver: a field along each axis, and where gains follow it as well a gain of each."""
    return 6 if watched_as(Watched.SCALE_BY, driver.quantity) else 3


def _spoiled(far: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which samples (n,) to leave out, of those far off (n,): one by itself, and a whole chunk that has many such."""
    alone = far.copy()
    alone[1:] &= ~far[:-1]
    alone[:-1] &= ~far[1:]
    return np.full(len(far), fill_value=True) if np.count_nonzero(alone) > _MOST_ALONE else alone


def _span(columns: Array) -> Array:
    """Orthonormal columns (n, r) of what columns (n, k) span; weak directions are left out."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    span: Array = left[:, values > _NULL * values[0]]
    return span


def likely(explanations: list[Explanation], samples: int) -> list[Explanation]:
    """Those that chance does not explain and that cannot be distinguished, the best first; the unknown one alone.

    It is called unknown where the best name leaves more than a fifth of the evidence without one.
    """
    found = [one for one in explanations if one.significance() > ALARM_NATS]
    found.sort(key=lambda one: -one.score(samples))
    named = [one for one in found if one.effects != (UNKNOWN,)]
    unknown = [one for one in found if one.effects == (UNKNOWN,)]
    if unknown and (not named or unknown[0].score(samples) > _UNKNOWN_SHARE * named[0].score(samples)):
        return unknown[:1]
    return [one for one in named if one.score(samples) > named[0].score(samples) - CLASS_NATS]


@dataclass(init=False, repr=False, eq=False)
class ModelWatchMemory:
    """What of ``ModelWatch`` outlives a restart, saved and restored whole."""

    drivers: DriverTrack
    finding: Finding | None
    _quiet: bool
    _x: Array
    _spread_nt2: float
    _drivers: list[Driver]
    _offered: int
    _zero: list[float]
    _void: list[bool]
    _reach: list[float]
    _topped: list[int]
    _rows: list[tuple[float, ...]]
    _block: Array | None
    _rest: Array | None
    _blocks: list[Array]
    _times: list[float]
    _power: Array
    _share: Array
    _samples: int
    _began_s: float


class ModelWatch(Stateful, ModelWatchMemory):
    """Monitors one craft's residual.

    Parameters
    ----------
    gate_sigma: a residual beyond so many sigmas is far off.
    """

    def __init__(self, gate_sigma: float) -> None:
        self._gate = gate_sigma
        self.drivers = DriverTrack()
        self._reach, self._topped = [0.0] * 3, [0] * 3
        self.reset()

    def reset(self) -> None:
        """Discard the finding, as after a reset of the estimator; drivers and the largest readings stay."""
        self.finding = None
        self._quiet = True
        self.begin()

    def begin(self) -> None:
        """Begin a new window; the finding is kept."""
        self._x, self._spread_nt2 = np.zeros(STATE_SIZE), 0.0
        self._drivers, self._zero, self._void, self._offered = [], [], [], 0
        self._rows, self._blocks, self._times = [], [], []
        self._block = self._rest = None
        self._power, self._share = np.zeros(_BINS), np.zeros(_BINS)
        self._samples, self._began_s = 0, 0.0

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state; SnapshotError where its parts don't belong together."""
        super().restore_state(saved, where, given)
        size, count = self._size(), len(self._drivers)
        shapes = {one.shape for one in (self._block, self._rest) if one is not None}
        blocks = {one.shape for one in self._blocks}
        lengths = {len(row) for row in self._rows}
        sound = (
            shapes <= {(size, size), (size - STATE_SIZE, size - STATE_SIZE)}
            and blocks <= {(STATE_SIZE + 1, STATE_SIZE + 1)}
            and lengths <= {5 + count}
            and len(self._times) == len(self._blocks) <= TICKS // BLOCK
            and len(self._zero) == len(self._void) == count
            and len(self._rows) == self._samples % CHUNK
            and (self._block is None) == (self._samples % BLOCK < CHUNK)
            and (self._rest is None) == (self._samples < BLOCK)
            and len(self._reach) == len(self._topped) == 3
        )
        if not sound:
            raise SnapshotError(f"{where}: sums, blocks and rows don't belong together")

    def _size(self) -> int:
        """Columns of the sums: nine errors, those without a driver, the drivers', the residual."""
        return STATE_SIZE + _OWN + sum(map(_width, self._drivers)) + 1

    @property
    def is_open(self) -> bool:
        """Whether a window has begun."""
        return self._samples > 0

    def push(self, tick: Tick, estimate: StateEstimate, *, walks: bool) -> bool:
        """Add a tick that the estimate has used; whether the finding has changed.

        Parameters
        ----------
        walks: the nine errors are allowed to change from tick to tick.
        """
        values = self.drivers.at(tick.time_ns)
        field = tick.field_body_nt[-1].tolist()
        if not self._samples:
            self._open(tick, estimate, values)
        for axis, reading in enumerate(map(abs, field)):
            if reading > self._reach[axis]:
                self._reach[axis], self._topped[axis] = reading, 0
            self._topped[axis] += reading == self._reach[axis]
        now = [value_of(values, driver) for driver in self._drivers]
        self._void = [gone or math.isnan(value) for gone, value in zip(self._void, now, strict=True)]
        driven = [0.0 if gone else value - zero for value, zero, gone in zip(now, self._zero, self._void, strict=True)]
        self._rows.append((float(tick.times_s[-1]), *field, float(tick.reference_magnitude_nt[-1]), *driven))
        self._samples += 1
        if len(self._rows) == CHUNK:
            self._close_chunk(estimate.noise_nt)
        if self._samples % BLOCK:
            return False
        if len(self.drivers.drivers()) > self._offered or self._walked_otherwise(walks):
            self.begin()  # the window has no columns for a channel that has come, or sums of another kind
            return False
        return self._close_block(float(tick.times_s[-1]), walks=walks)

    def _walked_otherwise(self, walks: bool) -> bool:
        """Whether the window's sums are of nine errors that walk while these do not, or the other way round.

        A command or a configuration may change the process noise while a window is open.
        """
        return self._rest is not None and (len(self._rest) < self._size()) is not walks

    def _open(self, tick: Tick, estimate: StateEstimate, values: Mapping[str, tuple[float, ...]]) -> None:
        offered = self.drivers.drivers()
        known = [driver for driver in offered if not math.isnan(value_of(values, driver))]
        self._x, self._began_s = estimate.x.copy(), float(tick.times_s[-1])
        spread_nt2 = largest_variance(estimate.covariance, tick.field_body_nt[-1])
        self._spread_nt2 = max(0.0, spread_nt2)  # the reference state's error is allowed for
        self._drivers, self._void, self._offered = known, [False] * len(known), len(offered)
        self._zero = [value_of(values, driver) for driver in known]

    def _close_chunk(self, noise_nt: float) -> None:
        """Add the chunk's rows to the block's sums and to the spectrum."""
        columns = self._columns(np.array(self._rows))
        self._rows.clear()
        gate_nt = self._gate * math.sqrt(noise_nt**2 + self._spread_nt2)
        left_out = _spoiled(np.abs(columns[:, -1]) > gate_nt)
        columns[left_out] = 0.0
        columns[:, -1] = np.clip(columns[:, -1], -_WIDER * gate_nt, _WIDER * gate_nt)
        sums = columns.T @ columns
        self._block = sums if self._block is None else self._block + sums
        if not left_out.all():
            self._add_spectrum(_span(columns[:, :STATE_SIZE]), columns[:, -1])

    def _add_spectrum(self, absorbed: Array, residual: Array) -> None:
        """Power of a chunk's residual (n,) without what lies in orthonormal columns (n, r), and white noise's share."""
        spectra = np.fft.rfft(np.column_stack([residual - absorbed @ (absorbed.T @ residual), absorbed]), axis=0)
        power = np.abs(spectra) ** 2 * _BIN_WEIGHT[:, None] / CHUNK
        self._power = self._power + power[:, 0]
        self._share = self._share + _BIN_WEIGHT - power[:, 1:].sum(axis=1)

    def _close_block(self, now_s: float, *, walks: bool) -> bool:
        """Add the block to the window and evaluate it; whether the finding has changed."""
        block = self._block
        assert block is not None
        self._block = None
        rest = without(block) if walks else block
        self._rest = rest if self._rest is None else self._rest + rest
        ends = [*range(STATE_SIZE), -1]
        self._blocks.append(block[np.ix_(ends, ends)])
        self._times.append(now_s)
        if self._samples < FIRST_EVALUATION:
            return False
        changed = self._evaluate((now_s - self._began_s) / 60.0, walks=walks)
        if self._samples >= TICKS:
            if self._quiet and self.finding is not None:
                self.finding, changed = None, True
            self._quiet = True
            self.begin()
        return changed

    def _evaluate(self, minutes: float, *, walks: bool) -> bool:
        likeliest = likely(self.explanations(walks=walks), self._samples)
        if not likeliest:
            return False
        self._quiet = False
        effects = tuple(dict.fromkeys(name for one in likeliest for name in one.effects))
        best, before = likeliest[0], self.finding
        young = self._samples < TICKS // 2
        if before is not None and before.nats > best.gain and (young or set(before.effects) & set(effects)):
            return False  # the finding of the window before has more evidence
        self.finding = Finding(effects, best.driver, best.gain, minutes)
        return before is None or before.effects[0] != effects[0]

    def explanations(self, *, walks: bool) -> list[Explanation]:
        """What each thing that may have been left out would explain of the window so far."""
        assert self._rest is not None
        fast, raised = spectral(self._power, self._share)
        memory = max(one.gain for one in fast if one.effects == watched_as(Watched.MEMORY))
        count = self._samples
        rest = self._rest if walks else without(self._rest)
        slow = [
            Explanation(effects, driver, of_columns(rest, columns, count), len(columns), tries)
            for effects, driver, columns, tries in self._columns_of()
        ]
        if not walks:
            slow += courses(np.array(self._blocks), np.array(self._times), count)
        # noise with a memory follows slow things by chance; what explains more than a memory would is no chance
        return fast + [one if one.gain > memory else replace(one, gain=one.gain / raised) for one in slow]

    def _columns_of(self) -> Iterator[tuple[tuple[str, ...], str, list[int], int]]:
        """Names, driver, columns behind the nine errors, and how many of their kind, of each explanation by columns."""
        yield watched_as(Watched.CUBE), "", [0, 1, 2], 1
        if max(self._topped) >= _FLAT:
            yield watched_as(Watched.FLAT_TOP), "", [3, 4, 5], 1
        yield watched_as(Watched.SLOPE), "", [6], 1
        at, channels = _OWN, dict[str, list[int]]()
        for driver, void in zip(self._drivers, self._void, strict=True):
            along = [at, at + 1, at + 2]
            if not void:
                channels.setdefault(driver.channel, []).extend(along)
                bias, scale = (watched_as(kind, driver.quantity) for kind in (Watched.BIAS_BY, Watched.SCALE_BY))
                yield bias, driver.label, along, len(self._drivers)
                if scale:
                    across = [at + 3, at + 4, at + 5]
                    yield scale, driver.label, across, len(self._drivers)
                    yield bias + scale, driver.label, along + across, len(self._drivers)
            at += _width(driver)
        for driver in {one.channel: one for one in self._drivers}.values():
            columns = channels.get(driver.channel, [])
            if len(columns) > 3:
                yield watched_as(Watched.BIAS_BY, driver.quantity), driver.label, columns, 1

    def _columns(self, table: Array) -> Array:
        """Rows of the sums (n, k) from samples, magnitudes and drivers."""
        field, magnitude = table[:, 1:4], table[:, 4]
        w_hat, b_hat = without_radial_noise(self._x, field, magnitude)
        unit = w_hat / np.maximum(magnitude, 1.0)[:, None]
        sensitivity = np.einsum("ni,nij->nj", unit, field_jacobian(b_hat))
        residual = np.linalg.norm(field + field @ d_matrix(self._x) - self._x[BIAS], axis=1) - magnitude
        slope = np.gradient(magnitude, np.maximum.accumulate(table[:, 0] + 1e-6 * np.arange(len(table))))
        beyond = np.sign(b_hat) * np.maximum(np.abs(b_hat) - np.array(self._reach), 0.0)
        parts = [sensitivity, unit * (b_hat / _FAR_NT) ** 3, unit * beyond, slope[:, None]]
        for index, driver in enumerate(self._drivers):
            along = unit * table[:, 5 + index, None]
            parts.append(along)
            if watched_as(Watched.SCALE_BY, driver.quantity):
                parts.append(along * b_hat)
        return np.column_stack([*parts, residual])
