"""How far off a calibration without the effects puts vectors, and when."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term, disturbances
from magcal_service.diagnosis.sized import numbers_of
from magcal_service.model import STATE_SIZE, Array, calibrate
from magcal_service.physics.saying import measured


@dataclass(frozen=True, slots=True)
class Misled:
    """Lengths of what calibrated vectors are off by under nine errors alone, were the fit with effects the truth [nT].

    Parameters
    ----------
    rms_nt: over the samples.
    sigma_nt: 1 sigma of it by the nine errors of the fit, rms over the samples: where the field did not point in enough
        directions, the two calibrations differ by what neither knows.
    most_nt, most_at_s: the largest, and when.
    shown_nt: what of it the held-out residual shows: the root of the difference of the two squared levels.
    change_s: when the bias or a scale jumps, where it does so once; else None, as the two that follow.
    before_nt, after_nt: rms before and after that.
    from_start: whether an effect grows from nought at the start, or comes later: there the fit's nine errors hold.
    """

    rms_nt: float
    sigma_nt: float
    most_nt: float
    most_at_s: float
    shown_nt: float
    change_s: float | None = None
    before_nt: float | None = None
    after_nt: float | None = None
    from_start: bool = False

    @classmethod
    def of(cls, baseline: Fit, fit: Fit) -> Misled:
        """Of nine errors alone and of a fit with effects to the same samples."""
        scene = fit.problem.scene
        body, _ = disturbances(fit.terms, scene)
        alone = calibrate(baseline.x[:STATE_SIZE], scene.field_nt)
        off_nt = np.linalg.norm(alone - (calibrate(fit.x[:STATE_SIZE], scene.field_nt) - body), axis=1)
        worst = int(np.argmax(off_nt))
        shown_nt = math.sqrt(max(baseline.held_out_rms_nt**2 - fit.held_out_rms_nt**2, 0.0))
        from_start = any(_begins(term) for term in fit.terms)
        sigma_nt = _sigma_nt(scene.field_nt, fit.covariance[:STATE_SIZE, :STATE_SIZE])
        found = cls(
            _rms(off_nt), sigma_nt, float(off_nt[worst]), float(scene.time_s[worst]), shown_nt, from_start=from_start
        )
        instants = [at for _, at in numbers_of(fit, "instant")]
        if len(instants) != 1:
            return found
        after = scene.time_s >= instants[0]
        if after.all() or not after.any():
            return found
        levels = _rms(off_nt[~after]), _rms(off_nt[after])
        return replace(found, change_s=instants[0], before_nt=levels[0], after_nt=levels[1])

    def __str__(self) -> str:
        when = f"at most {_whole(self.most_nt)}, at {self.most_at_s:.0f} s"
        if self.before_nt is not None and self.after_nt is not None:
            when = f"{_whole(self.before_nt)} before {self.change_s:.1f} s, {_whole(self.after_nt)} after"
        return (
            f"off by {measured(self.rms_nt, self.sigma_nt)} nT rms ({when}); the residual shows {_whole(self.shown_nt)}"
        )

    def to_dict(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {name: round(value, 2) if isinstance(value, float) else value for name, value in asdict(self).items()}


def _whole(level_nt: float) -> str:
    """A level with its unit, as whole nanoteslas where it has three digits of them."""
    return f"{level_nt:.{0 if level_nt >= 100.0 else 1}f} nT"


def _begins(term: Term) -> bool:
    """Whether a term has no driver, is nothing at the first sample, and something at the last."""
    field = term.hypothesis.columns(term.theta).field(term.amplitudes)
    return term.hypothesis.driver == "none" and bool(field[-1].any() and not field[0].any())


def _sigma_nt(field_nt: Array, covariance: Array) -> float:
    """1 sigma of calibrated vectors (n, 3) by the nine errors' covariance (9, 9), along all axes, rms [nT]."""
    at_zero = calibrate(np.zeros(STATE_SIZE), field_nt)
    slopes = np.array([calibrate(one, field_nt) - at_zero for one in np.eye(STATE_SIZE)]).reshape(STATE_SIZE, -1)
    variance = float(np.sum((slopes @ slopes.T) * covariance)) / len(field_nt)
    return math.sqrt(max(variance, 0.0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
