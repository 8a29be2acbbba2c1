"""Values on a lattice: the converter's step against the noise."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.scene.view import View

_ON_LATTICE: Final = 0.04
"""Distance from whole multiples of the step, in steps, that 95 % of the values keep; by chance they have 0.475."""

_LEAST_SIGMAS: Final = 0.5
"""Step in noise sigmas from which on it counts: 2 % of the variance, 1 % of the noise; a choice.  What finer rounding
adds is white and independent of the field to less than 10^-33 (Widrow & Kollar 2008): it is a part of the noise."""

_LEAST_DETECTABILITY: Final = 10.0
"""Least detectability of its noise in the recording besides: sqrt(n) (q / sqrt 12) / sigma."""

_FEWEST_INSIDE: Final = 8
"""Levels without the ends from which their step is the lattice's: on one of half of it all would be even by chance once
in 128 times."""

_DIGITS: Final = range(-2, 10)
"""Decimals that values may be written with [log10 of 1/nT]: from 0.1 uT on, as far as a double of 1e5 nT has them."""

_SAME_STEP: Final = 1e-6  # relative; the ends of a lattice move its step by rounding alone


def step_of(values: Array) -> float:
    """Lattice step of values (n,), 0 where there is none.

    The least and the largest may lie between two steps, where a range ends: a step that only they show is none.
    """
    levels = np.unique(values)
    if len(levels) > 0.6 * len(values):
        return 0.0
    whole, inner = _step_of_levels(levels), _step_of_levels(levels[1:-1])
    if len(levels) < _FEWEST_INSIDE + 2 or not inner or math.isclose(whole, inner, rel_tol=_SAME_STEP):
        return whole
    return inner


def _step_of_levels(levels: Array) -> float:
    """Step of rising values (n,), each of which came once or more often; 0 where they are on no lattice."""
    if len(levels) < 3:
        return 0.0
    gaps = np.diff(levels)
    smallest = float(np.median(gaps[gaps <= 1.5 * np.quantile(gaps, 0.05) + 1e-12]))
    if smallest <= 1e-9 * max(float(np.abs(levels).max()), 1.0):
        return 0.0
    number = (levels - levels[0]) / smallest
    refined = float(levels[-1] - levels[0]) / max(round(float(number[-1])), 1)
    number = (levels - levels[0]) / refined
    off = np.abs(number - np.round(number))
    return refined if float(np.quantile(off, 0.95)) < _ON_LATTICE else 0.0


def sigma_of(values: Array, step: float) -> float:
    """1 sigma of the lattice's step: the way between the ends of values (n,) over its number of steps; 0 of no step.

    Both ends are off by the rounding of the file: what values differ from whole steps by, and its last digit.
    """
    if step <= 0.0:
        return 0.0
    levels = np.unique(values)
    number = np.round((levels - levels[0]) / step)
    off = (levels - levels[0] - number * step)[1:-1]  # the ends may lie between two steps
    scaled = (levels * 10.0**digits for digits in _DIGITS)
    digits = next((d for d, one in zip(_DIGITS, scaled, strict=True) if np.abs(one - np.round(one)).max() < 1e-4), 9)
    rounding = max(float(np.std(off)), 10.0**-digits / math.sqrt(12.0))
    return math.sqrt(2.0) * rounding / max(float(number[-1]), 1.0)


def _find(view: View) -> Finding | None:
    field = view.scene.field_nt
    steps = np.array([step_of(field[:, axis]) for axis in range(3)])
    step = float(steps.max())
    if step < _LEAST_SIGMAS * view.noise_nt:
        return None
    own_nt = step / math.sqrt(12.0)
    detectability = math.sqrt(len(field)) * own_nt / max(view.noise_nt, 1e-9)
    if detectability < _LEAST_DETECTABILITY:
        return None
    share = min(1.0, own_nt**2 / max(float(np.mean(view.residual_nt**2)), 1e-12))
    sigmas = np.array([sigma_of(field[:, axis], float(one)) for axis, one in enumerate(steps)])
    parameters = {
        "lsb_nt": value_of(step, sigmas[int(np.argmax(steps))], "nT"),
        "lsb_by_axis_nt": value_of(steps, sigmas, "nT"),
        "added_noise_nt": value_of(own_nt, 0.0, "nT"),
    }
    return Finding(parameters, nats=detectability, share=share)


EFFECT = Effect(
    name="quantisation",
    acts_on=ActsOn.SAMPLES,
    title="values on a lattice",
    equation="B_i rounded to a multiple of q: adds a variance of q^2 / 12",
    units={"lsb_nt": "nT", "lsb_by_axis_nt": "nT", "added_noise_nt": "nT"},
    prior=(1.0, 500.0),
    valid="the step is seen in the values themselves; below half a noise sigma it is a part of the noise",
    confused_with=("coloured_noise",),
    separated_by="gaps in the histogram of each axis",
    source="Widrow & Kollar 2008: q^2 / 12, and lines where the field moves slowly against q",
    says=("Values lie on a lattice of {lsb_nt.size}, which adds {added_noise_nt.size} of noise per axis.",),
    find=_find,
)
