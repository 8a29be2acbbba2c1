"""Courses that repeat: a field fixed in the body that comes back with a period, whatever it does within it.

Heaters in several levels, a saw tooth, a load that nobody recorded: a tone follows the first wave of such a course, a
duty two of its levels.  Here its cycle is cut where that pays, into stretches of a constant field each, and the period
is sought where the first waves together hold most.

The best cuts of a cycle are found exactly, by dynamic programming over where the next one lies (Jackson et al. 2005,
IEEE Signal Processing Letters 12, 105-108), once for each place of the first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.lines import Spectrum, repeating
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

CYCLE: Final = "cycle"
"""Name of the family of a course that repeats."""

_SLOTS: Final = 48
"""Places in a cycle where it may be cut: twice those of a duty.  An edge halfway between two spoils a 96th."""

_PERIODS: Final = 6  # that are tried, each with its neighbours; choice: the true one is among the first three
_BESIDE: Final = np.arange(-4, 5) / 16.0
"""Places near a frequency that are tried [1 / duration]: from one to the next a cycle's edges move by a 32nd of it at
either end."""

_FINER: Final = (1.0 / 32.0, 1.0 / 64.0, 1.0 / 128.0)
"""Steps by which the best is moved either way then [1 / duration]: edges move by a tenth of a place at the last."""

_SIZES: Final = np.geomspace(0.03, 30.0, 7)  # of a row's noise: by factors of three, for evidence hardly depends on it
_LEAST_LEFT: Final = 1e-4  # of the squares: what a cycle leaves where there is no noise is rounding
_TRIED: Final = 5  # periods whose cycles are cut, the best by all slots first; choice: these rank well


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A course that repeats.

    Parameters
    ----------
    period_s: of it [s].
    levels: rows by the stretch of the cycle in which they are, where the field is constant.
    cost: ln of the number of such courses that were tried [nats].
    """

    period_s: float
    levels: Groups
    cost: float

    @property
    def says(self) -> str:
        """In words; of a course that is hardly in levels only its period."""
        count = self.levels.count
        inside = f", in {count} levels" if count <= _SLOTS // 4 else ""
        return f"a body-fixed field that repeats every {self.period_s:.4g} s{inside}"


def cycle(
    scene: Scene, rows: Array, residual: Array, spectrum: Spectrum, sigma_nt: float, spin_hz: float | None
) -> Cycle | None:
    """The likeliest course that repeats; None where nothing does.

    Parameters
    ----------
    rows: (m, 3) what a field of 1 nT along each axis of the body adds to the residual.
    residual: (m,) [nT], less what is fitted anyway.
    spectrum: of the residual.
    sigma_nt: a row's noise [nT].
    spin_hz: the spin's frequency; a cycle of which it is a wave is the attitude's.
    """
    sums, since_s = _sums(len(scene), rows, residual / sigma_nt), scene.time_s - scene.time_s[0]
    near_hz = repeating(scene, spectrum, _PERIODS, sigma_nt, spin_hz)[:, None] + _BESIDE / since_s[-1]
    rough = [_Folded.of(sums, since_s, period_s) for period_s in (1.0 / near_hz.ravel()).tolist()]
    if not rough:
        return None
    best = max((one.cut() for one in sorted(rough, key=lambda one: -one.nats)[:_TRIED]), key=lambda one: one.nats)
    sums[:, 9:] *= best.louder(float(residual @ residual) / sigma_nt**2)
    best = _Folded.of(sums, since_s, best.period_s, best.level).cut()
    for aside in _FINER:
        near_s = [1.0 / (1.0 / best.period_s + way * aside / since_s[-1]) for way in (-1.0, 1.0)]
        beside = [_Folded.of(sums, since_s, period_s, best.level).cut() for period_s in near_s]
        best = max([best, *beside], key=lambda one: one.nats)
    if not best.level.any():
        return None
    number = best.level[_slots(since_s, best.period_s)]
    groups = Groups.of(number, np.unique(number))
    return Cycle(best.period_s, groups, math.log(len(scene)) + groups.count * math.log(_SLOTS))


@dataclass(frozen=True, slots=True, eq=False)
class _Folded:
    """A cycle, and a field of its own in each of its stretches.

    Parameters
    ----------
    period_s: of it [s].
    sums: (slots, 12) as of ``_sums``, over each of its places.
    level: (slots,) number of the stretch that each place is in.
    size: prior size of a field [a row's noise].
    nats: evidence for them.
    """

    period_s: float
    sums: Array
    level: NDArray[np.intp]
    size: float
    nats: float

    @classmethod
    def of(cls, sums: Array, since_s: Array, period_s: float, level: NDArray[np.intp] | None = None) -> _Folded:
        """At the likeliest size; ``level``: of each place, else of pairs of them."""
        level = np.repeat(np.arange(_SLOTS // 2), 2) if level is None else level
        slot = _slots(since_s, period_s)
        each = [np.bincount(slot, column, minlength=_SLOTS) for column in sums.T]
        folded: Array = np.stack(each, axis=1, dtype=np.float64)
        nats = _nats(_of_levels(folded, level), _SIZES).sum(axis=1)
        return cls(period_s, folded, level, float(_SIZES[np.argmax(nats)]), float(nats.max()))

    def cut(self) -> _Folded:
        """The same with its best stretches, each of which costs as much as there are places for its end."""
        nats, level = _cut(self.sums, self.size)
        return replace(self, level=level, nats=nats)

    def louder(self, squares: float) -> float:
        """How much more the residual is in the noise that this leaves of so many squares [a row's noise]."""
        sums = _of_levels(self.sums, self.level)
        drop = float((_fitted(sums, np.array([self.size]))[0] * sums[:, 9:]).sum())
        return math.sqrt(squares / max(squares - drop, _LEAST_LEFT * squares))


def _slots(since_s: Array, period_s: float) -> NDArray[np.intp]:
    """(n,) place of each sample in its cycle."""
    return np.asarray(np.minimum(np.mod(since_s / period_s, 1.0) * _SLOTS, _SLOTS - 1).astype(np.intp))


def _sums(count: int, rows: Array, residual: Array) -> Array:
    """(n, 12) of each sample: products of its rows with one another, nine, and with the residual."""
    each = rows.reshape(count, -1, 3)
    normal = np.einsum("nri,nrj->nij", each, each).reshape(count, 9)
    return np.concatenate([normal, np.einsum("nri,nr->ni", each, residual.reshape(count, -1))], axis=1)


def _of_levels(folded: Array, level: NDArray[np.intp]) -> Array:
    """(levels, 12) sums over the places of each stretch."""
    return np.asarray((level == np.arange(level.max() + 1)[:, None]).astype(np.float64) @ folded)


def _fitted(sums: Array, sizes: Array) -> Array:
    """(s, ..., 3) the likeliest field in each of some stretches, by its prior size (s,) [a row's noise]."""
    normal, variance = sums[..., :9].reshape(*sums.shape[:-1], 3, 3), (sizes**2).reshape(-1, *[1] * sums.ndim)
    found: Array = np.linalg.solve(np.eye(3) + variance[..., None] * normal, (variance * sums[..., 9:])[..., None])
    return found[..., 0]


def _nats(sums: Array, sizes: Array) -> Array:
    """(s, ...) evidence for such a field."""
    normal, variance = sums[..., :9].reshape(*sums.shape[:-1], 3, 3), (sizes**2).reshape(-1, *[1] * (sums.ndim + 1))
    found: Array = 0.5 * (_fitted(sums, sizes) * sums[..., 9:]).sum(axis=-1)
    found -= 0.5 * np.linalg.slogdet(np.eye(3) + variance * normal)[1]
    return found


def _cut(folded: Array, size: float) -> tuple[float, NDArray[np.intp]]:
    """The best cuts of a cycle into stretches of a field of a prior size each: evidence, and each place's stretch."""
    running = np.concatenate([np.zeros((1, 12)), np.cumsum(np.concatenate([folded, folded]), axis=0)])
    first, length = np.arange(_SLOTS)[:, None], np.arange(1, _SLOTS + 1)
    alone = _nats(running[first + length] - running[first], np.array([size]))[0] - math.log(_SLOTS)
    best, came = np.zeros((_SLOTS, _SLOTS + 1)), np.zeros((_SLOTS, _SLOTS + 1), dtype=np.intp)
    start = np.arange(_SLOTS)
    for end in range(1, _SLOTS + 1):
        begin = np.arange(end)
        nats = best[:, :end] + alone[(start[:, None] + begin) % _SLOTS, end - begin - 1]
        came[:, end] = np.argmax(nats, axis=1)
        best[:, end] = nats[start, came[:, end]]
    at = int(np.argmax(best[:, -1]))
    level, last, number = np.zeros(_SLOTS, dtype=np.intp), _SLOTS, 0
    while last > 0:
        before = int(came[at, last])
        level[(at + np.arange(before, last)) % _SLOTS] = number
        last, number = before, number + 1
    return float(best[at, -1]), level
