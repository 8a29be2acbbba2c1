"""How wrong the vector was, and how wrong it is: against the truth that only a simulation knows, and against |H|."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.model import Array, calibrate, field_jacobian
from magcal_service.residuals import rms
from magcal_service.views.nine import values
from magcal_service.wire.messages import Estimate
from sim_sensor.simulation import Block
from sim_sensor.view.history import covariance_matrix

__all__ = ["BeforeAfter", "before_after"]


@dataclass(frozen=True, slots=True)
class Pair:
    """The same quantity of the raw and of the calibrated vectors [nT]."""

    raw_nt: float
    calibrated_nt: float


@dataclass(frozen=True, slots=True)
class BeforeAfter:
    """Errors of a flight's vectors, raw and with its last estimate.

    Parameters
    ----------
    samples: how many vectors.
    nine_rms, nine_worst: length of the error that the nine errors make, without noise: rms, and of the worst sample.
    sample_rms: length of the whole error of a sample, noise included, against the true field.
    residual_rms: |w| - |H|, which needs no truth.
    bound_nt: 3 sigma of the first by the estimate's covariance, at the sample and in the direction it knows worst [nT].
    protection_nt, protection_by: as in the estimate.
    """

    samples: int
    nine_rms: Pair
    nine_worst: Pair
    sample_rms: Pair
    residual_rms: Pair
    bound_nt: float
    protection_nt: float | None
    protection_by: str | None

    def text(self) -> str:
        """Plain text of at most 80 columns."""
        raw, calibrated = self.nine_rms.raw_nt, self.nine_rms.calibrated_nt
        lines = [
            f"The vector was {raw:.0f} nT off by its nine errors, and is {calibrated:.1f} nT off now (rms):",
            f"  {'':48}{'raw':>11}{'calibrated':>14}",
            _row("off by the nine errors, rms", self.nine_rms, 1),
            _row(f"  at the worst of {self.samples} samples", self.nine_worst, 1),
            _row("a single sample with its noise, rms", self.sample_rms, 0),
            _row("magnitude against |H|, all that a craft can see", self.residual_rms, 0),
            f"The daemon knows no truth, and bounds it by {self.bound_nt:.0f} nT: 3 sigma of its estimate.",
        ]
        if self.protection_nt is not None:
            by = f" ({self.protection_by}; docs/integrity.md)" if self.protection_by else ""
            lines.append(f"Beside it {self.protection_nt:.0f} nT for what is not seen yet{by}.")
        return "\n".join(lines)


def _row(name: str, pair: Pair, decimals: int) -> str:
    return f"  {name:48}{pair.raw_nt:8.0f} nT{pair.calibrated_nt:11.{decimals}f} nT"


def before_after(flown: Block, estimate: Estimate) -> BeforeAfter:
    """Compare all of a flight's samples with the truth, raw and by an estimate.

    Parameters
    ----------
    flown: at least one sample; its last true errors are those that the estimate is held against.
    """
    measured = flown.measured_nt
    known, truth = np.array(values(estimate)), np.concatenate([flown.bias_nt[-1], flown.D[-1]])
    calibrated, true = calibrate(known, measured), calibrate(truth, measured)
    raw_off, off = _length(measured - true), _length(calibrated - true)
    reference = _length(flown.true_eci_nt)
    jacobian = field_jacobian(measured)
    covariance = jacobian @ covariance_matrix(estimate) @ np.swapaxes(jacobian, -1, -2)
    return BeforeAfter(
        samples=len(measured),
        nine_rms=Pair(rms(raw_off), rms(off)),
        nine_worst=Pair(float(raw_off.max()), float(off.max())),
        sample_rms=Pair(*(rms(_length(one - flown.ambient_body_nt)) for one in (measured, calibrated))),
        residual_rms=Pair(*(rms(_length(one) - reference) for one in (measured, calibrated))),
        bound_nt=3.0 * float(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1].max())),
        protection_nt=estimate.protection_nt,
        protection_by=estimate.protection_by,
    )


def _length(vectors: Array) -> Array:
    length: Array = np.linalg.norm(vectors, axis=1)
    return length
