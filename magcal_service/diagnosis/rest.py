"""What lasts in a residual beside the names: a cause that is only like the one named leaves a part of itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.model import Array

LITTLE_LASTS: Final = 0.02
"""Share of what lasts from one sample to the next in the residual of the nine errors alone, that may still last beside
names.  A true cause leaves what its model is not exact in, and no more than noise where that is exact; one that only
resembles it left 4 to 66 %."""

_MOST_UNSEEN: Final = 0.25
"""The same share, which has to be excluded where nothing but its own shape speaks for a name: what one name may fall
short of the best family without one (``nameless.NEEDED_SHARES``)."""

_SAFE: Final = 2.0
"""Its standard errors within which what cannot be excluded lies: 95 %, as for a name."""

_OPEN: Final = 0.5
"""Probability that something else lasts, at the most, where that is only not excluded: of six names of whose mismatch
nothing could be excluded to last, three were true."""

_NEIGHBOURS: Final = 1.5
"""Sample periods that two samples may lie apart to be neighbours."""

_BEYOND: Final = 3.0
"""Standard errors by which it has to stand out of noise."""


@dataclass(frozen=True, slots=True)
class Rest:
    """What lasts from one sample to the next in the held-out residual [nT^2], before and after names.

    The mean product of neighbours: white noise has none, however large it is and however it is spread, and neither
    whitening nor a family of shapes can hide what is there.

    Parameters
    ----------
    before: under the nine errors alone.
    after: beside the names, less what the field model errs by here, and no more than usual: that lasts too.
    sigma: 1 sigma of ``after``, were there nothing.
    is_free: whether nothing but its own shape speaks for one of the names.
    excused: what the field model may err by instead of ``after``; another cause may hide in it.
    """

    before: float
    after: float
    sigma: float
    is_free: bool = False
    excused: float = 0.0

    @classmethod
    def of(cls, baseline: Fit, fit: Fit) -> Rest:
        """Of nine errors alone and of a fit with effects."""
        after, sigma = _mean_and_sigma(_neighbours(fit))
        error = fit.problem.field_error
        excused = 0.0 if error is None else min(max(after, 0.0), error.no_larger_than_usual.rms_nt**2)
        is_free = any(term.hypothesis.is_free for term in fit.terms)
        return cls(max(_mean_and_sigma(_neighbours(baseline))[0], 0.0), after - excused, sigma, is_free, excused)

    @classmethod
    def of_all(cls, pairs: Sequence[tuple[Fit, Fit]]) -> Rest:
        """Of several recordings, each by its rows: their nine errors alone, and their parts of a fit with effects."""
        rests = [cls.of(*pair) for pair in pairs]
        shares = np.array([len(fit.residual) for _, fit in pairs], dtype=np.float64)
        shares /= shares.sum()
        each = np.array([(rest.before, rest.after, rest.excused) for rest in rests])
        total = math.sqrt(float(shares**2 @ np.array([rest.sigma for rest in rests]) ** 2))
        before, after, excused = (shares @ each).tolist()
        return cls(before, after, total, any(rest.is_free for rest in rests), excused)

    @property
    def beyond_noise_nt2(self) -> float:
        """``after``, where all that lasts is more than noise."""
        return max(self.after, 0.0) if self._stands_out else 0.0

    @property
    def _stands_out(self) -> bool:
        return self.after + self.excused > _BEYOND * self.sigma

    @property
    def share(self) -> float:
        """Of the mismatch, what lasts beyond noise beside the names."""
        return min(self.beyond_noise_nt2 / self.before, 1.0) if self.before > 0.0 else 0.0

    @property
    def unsafe_share(self) -> float:
        """What cannot be excluded to last, where a name is free; else what does last."""
        if not self.is_free:
            return self.share
        return min(max(self.after + _SAFE * self.sigma, 0.0) / self.before, 1.0) if self.before > 0.0 else 1.0

    @property
    def likely_share(self) -> float:
        """The share that counts as a probability against the names: what lasts, or up to a half what may."""
        hidden = self.excused / self.before if self._stands_out and self.before > 0.0 else 0.0
        return max(self.share, min(self.unsafe_share**2, _OPEN), _OPEN * min(hidden, 1.0))

    @property
    def is_much(self) -> bool:
        """Whether it is more than may be left of a true cause, or, where a name is free, could be a quarter."""
        if self.share > LITTLE_LASTS:
            return True
        return self.is_free and self.unsafe_share > _MOST_UNSEEN


def _neighbours(fit: Fit) -> Array:
    """Products (m,) of the held-out residual of samples that follow one another [nT^2]."""
    scene = fit.problem.scene
    rows = fit.held_out_residual.reshape(len(scene), -1)
    follow = np.diff(scene.time_s) < _NEIGHBOURS * scene.period_s
    return np.asarray((rows[1:] * rows[:-1]).mean(axis=1)[follow])


def _mean_and_sigma(products: Array) -> tuple[float, float]:
    if not len(products):
        return 0.0, 0.0
    return float(products.mean()), math.sqrt(float(np.mean(products**2)) / len(products))
