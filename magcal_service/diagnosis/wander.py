"""Courses at no regular times: a field along one direction of the body that wanders, or goes between two levels.

Loads that nobody records, magnets that flip, a heater under its thermostat, a bias that walks.  A family of shapes
(``shapes``) needs an amplitude for each stretch and axis, and loses a faint course among what noise alone would give
those.  Here the course is a random process along one direction, and its evidence is summed up exactly over short blocks
and averaged over directions, sizes and times, so that what is free costs what it is free:

- wandering: an Ornstein-Uhlenbeck process; its likelihood by the innovations of a Kalman filter (Schweppe 1965, IEEE
  Transactions on Information Theory 11, 61-70).
- two levels: a Markov chain of two states (random telegraph); its likelihood by the forward recursion, its course by
  the backward one (Rabiner 1989, Proceedings of the IEEE 77, 257-286, equations 19 to 27).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments

TWO_LEVELS: Final = "two levels"
"""Name of the family of a course between two levels."""

_MOST_BLOCKS: Final = 1000
"""Blocks in which the course is constant; choice: what is on for a hundredth of the recording fills ten."""

_FEWEST_BLOCKS: Final = 8  # fewer say nothing of when a course changes
_SAMPLES: Final = 5  # in a block on the average at the least, so that blocks are cheaper than samples

_DIRECTIONS: Final = 100
"""On half of the sphere, about 14 degrees apart: halfway between two 1.5 % of the squares are lost."""

_SIZES: Final = np.geomspace(0.03, 10.0, 9)
"""Of a row's noise: the least of them is 6 sigma in 40 000 rows."""

_TIMES: Final = (2.0, 6.0, 20.0, 60.0, 200.0)
"""Memories and times between switches, in blocks: by factors of three, for evidence hardly depends on them."""

_DUTIES: Final = (0.1, 0.3, 0.5)
"""Shares of the time in the rarer level: by factors of about two, as for the times."""

_NEAREST: Final = 10  # directions about that of a wandering course, both ways, in which two levels are tried
_SHOWN: Final = 240  # stretches at the most in which a wandering course is shown: as many columns of all samples


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A course along one direction of the body.

    Parameters
    ----------
    nats: evidence over none, averaged over directions, sizes and times.
    direction: (3,) in the body.
    each_s: time after which it is another, or on the average goes to the other level [s].
    """

    nats: float
    direction: Array
    each_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Levels(Course):
    """A course between two levels: with which probability (n,) each sample is in the rarer one."""

    share: Array

    @property
    def switches(self) -> int:
        """How often it goes from one level to the other."""
        return int(np.count_nonzero(np.diff(self.share > 0.5)))  # the likelier one


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """What is known in each of g blocks of a field of 1 nT along each axis of the body.

    Parameters
    ----------
    first: first sample (g,) of each.
    apart_s: time (g,) from the middle of the one before [s], 0 for the first.
    normal, right: information (g, 3, 3) [1/nT^2] on such a field, and the same times what it shows (g, 3) [1/nT].
    sigma_nt: noise of a row [nT].
    samples: how many they hold together.
    """

    first: NDArray[np.intp]
    apart_s: Array
    normal: Array
    right: Array
    sigma_nt: float
    samples: int

    @classmethod
    def of(cls, scene: Scene, first: NDArray[np.intp], columns: Array, sums: Segments, sigma_nt: float) -> Blocks:
        """From columns (m, 3) of such a field, their sums in each block (``first_samples``), and a row's noise [nT]."""
        scale = np.sqrt(np.mean(columns**2, axis=0))  # sums are of columns of unit rms
        last = np.append(first[1:], len(scene)) - 1
        middle_s = 0.5 * (scene.time_s[first] + scene.time_s[last])
        apart_s = np.diff(middle_s, prepend=middle_s[0])
        normal, right = sums.normal * np.outer(scale, scale), sums.right * scale
        return cls(first, apart_s, normal / sigma_nt**2, right / sigma_nt**2, sigma_nt, len(scene))

    @property
    def usual_s(self) -> float:
        """Time from one to the next where there is no pause [s]."""
        return float(np.median(self.apart_s[1:]))

    def along(self, directions: Array) -> tuple[Array, Array]:
        """Information (g, d) on a course along each of directions (d, 3), and the same times what it shows."""
        normal = np.einsum("di,gij,dj->gd", directions, self.normal, directions)
        return normal, self.right @ directions.T


def first_samples(scene: Scene) -> NDArray[np.intp]:
    """First samples (g,) of the blocks of a recording, none of one too short for them."""
    width_s = max(_SAMPLES * scene.period_s, float(scene.time_s[-1] - scene.time_s[0]) / _MOST_BLOCKS)
    first = np.unique(((scene.time_s - scene.time_s[0]) / width_s).astype(np.intp), return_index=True)[1]
    return first if len(first) >= _FEWEST_BLOCKS else first[:0]


def wandering(blocks: Blocks) -> Course:
    """The likeliest wandering course, and the evidence that there is one."""
    directions = _half_sphere(_DIRECTIONS)
    normal, right = blocks.along(directions)
    memory_s, variance = blocks.usual_s * np.array(_TIMES), (_SIZES * blocks.sigma_nt) ** 2
    shape = (len(memory_s), len(directions), len(variance))
    mean, spread, nats = np.zeros(shape), np.broadcast_to(variance, shape), np.zeros(shape)
    for n, r, apart_s in zip(normal[:, :, None], right[:, :, None], blocks.apart_s, strict=True):
        kept = np.exp(-apart_s / memory_s)[:, None, None]
        mean = kept * mean
        spread = variance + kept**2 * (spread - variance)
        seen = 1.0 + n * spread
        nats += 0.5 * ((r**2 * spread + mean * (2.0 * r - n * mean)) / seen - np.log(seen))
        spread = spread / seen
        mean = mean + spread * (r - n * mean)
    time, way, _ = np.unravel_index(int(np.argmax(nats)), shape)
    return Course(_averaged(nats), directions[way], float(memory_s[time]))


def of_every_axis(blocks: Blocks) -> float:
    """Evidence [nats] for a course of its own along each axis, all of one size and memory: noise that has a memory."""
    memory_s, variance = blocks.usual_s * np.array(_TIMES), (_SIZES * blocks.sigma_nt) ** 2
    shape = (len(memory_s), len(variance))
    whole = variance[None, :, None, None] * np.eye(3)
    mean, spread, nats = np.zeros((*shape, 3)), np.broadcast_to(whole, (*shape, 3, 3)), np.zeros(shape)
    for n, r, apart_s in zip(blocks.normal, blocks.right, blocks.apart_s, strict=True):
        kept = np.exp(-apart_s / memory_s)[:, None, None]
        mean = kept * mean
        spread = whole + kept[..., None] ** 2 * (spread - whole)
        # r = n mean + noise of covariance n: the odds of its density with the course over that without
        seen = np.eye(3) + spread @ n
        left = r - mean @ n
        gain = np.linalg.solve(seen, spread)
        moved = (gain @ left[..., None])[..., 0]
        nats += 0.5 * ((left * moved).sum(-1) - np.linalg.slogdet(seen)[1]) + (mean * r).sum(-1)
        nats -= 0.5 * ((mean @ n) * mean).sum(-1)
        mean, spread = mean + moved, gain
    return _averaged(nats)


def two_levels(blocks: Blocks, near: Array) -> Levels:
    """The likeliest course between two levels, and the evidence that there is one.

    Parameters
    ----------
    near: (3,) direction about which it is looked for.
    """
    half = _half_sphere(_DIRECTIONS)
    half = half[np.argsort(-np.abs(half @ near))[:_NEAREST]]
    directions = np.concatenate([half, -half])
    normal, right = blocks.along(directions)
    each_s, duty = blocks.usual_s * np.array(_TIMES)[:, None, None, None], np.array(_DUTIES)[:, None, None]
    apart = _SIZES * blocks.sigma_nt
    up, down = (1.0 - duty) * apart, -duty * apart  # the mean is the bias's
    shape = np.broadcast_shapes(each_s.shape, duty.shape, (len(directions), len(apart)))
    on, nats = np.broadcast_to(duty, shape), np.zeros(shape)
    for n, r, after_s in zip(normal[:, :, None], right[:, :, None], blocks.apart_s, strict=True):
        on = duty + np.exp(-after_s / each_s) * (on - duty)
        high, low = up * (r - 0.5 * n * up), down * (r - 0.5 * n * down)
        top = np.maximum(high, low)
        in_high = on * np.exp(high - top)
        both = in_high + (1.0 - on) * np.exp(low - top)
        nats += top + np.log(both)
        on = in_high / both
    time, share, way, size = np.unravel_index(int(np.argmax(nats)), shape)
    shows = up[share, 0, size], down[share, 0, size], normal[:, way], right[:, way]
    return Levels(
        nats=_averaged(nats) + math.log(_NEAREST / _DIRECTIONS),  # elsewhere on the sphere there is none
        direction=directions[way],
        each_s=float(each_s[time].item()),
        share=_share_of(blocks, float(each_s[time].item()), _DUTIES[share], *shows),
    )


def _share_of(blocks: Blocks, each_s: float, duty: float, up: float, down: float, normal: Array, right: Array) -> Array:
    """(n,) probability that each sample is in the rarer level, by all samples."""
    odds = np.exp(np.clip((up - down) * right - 0.5 * (up**2 - down**2) * normal, -500.0, 500.0))
    kept = np.exp(-blocks.apart_s / each_s)
    before, on = np.empty(len(odds)), duty
    for number, odd in enumerate(odds.tolist()):
        before[number] = duty + kept[number] * (on - duty)
        on = before[number] * odd / (before[number] * odd + 1.0 - before[number])
    # backward: of what follows a block, its likelihood in the rarer level over that in the other
    after, follows = np.ones(len(odds)), 1.0
    for number in range(len(odds) - 1, 0, -1):
        seen, keep = odds[number] * follows, kept[number]
        to_on, to_off = duty + keep * (1.0 - duty), duty - keep * duty
        follows = (to_on * seen + 1.0 - to_on) / (to_off * seen + 1.0 - to_off)
        after[number - 1] = follows
    weight = before * odds * after
    return np.repeat(weight / (weight + 1.0 - before), np.diff(np.append(blocks.first, blocks.samples)))


def shown_in(scene: Scene, course: Course) -> NDArray[np.intp]:
    """(n,) number of the stretch that each sample is shown in: of half a memory, or as many as can be shown."""
    elapsed = scene.time_s - scene.time_s[0]
    width_s = max(0.5 * course.each_s, float(elapsed[-1]) / _SHOWN)
    return np.asarray(np.unique((elapsed / width_s).astype(np.intp), return_inverse=True)[1].reshape(-1))


def _averaged(nats: Array) -> float:
    """Evidence averaged over a grid of equally likely numbers [nats]."""
    best = float(nats.max())
    return best + math.log(float(np.mean(np.exp(nats - best))))


def _half_sphere(count: int) -> Array:
    """(count, 3) unit vectors, evenly over half of the sphere: by the golden angle."""
    number = np.arange(count) + 0.5
    z, angle = 1.0 - number / count, math.pi * (1.0 + math.sqrt(5.0)) * number
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
