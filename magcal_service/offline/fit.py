"""Arrays in, nine errors out: the batch fit that the daemon starts from, for a notebook."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.config.settings import FilterConfig
from magcal_service.estimators.interface import StartGate
from magcal_service.estimators.parts.start import batch_solution, gated
from magcal_service.model import Array, scalar_residual
from magcal_service.offline.nine_errors import NineErrors, vectors
from magcal_service.offline.no_solution import no_solution, stopped
from magcal_service.residuals import rms

FEWEST_SAMPLES: Final = 50  # as for a recording: below this not even the residual's level is known to 10 %
LARGEST_NT: Final = 1e6  # 1 mT, as for a recording: more is no magnetometer's reading
SMALLEST_REFERENCE_NT: Final = 100.0  # a tenth of a microtesla: the Earth's field is 200 times that, a coil's sweep 10


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(NineErrors):
    """Nine errors of arrays.

    Parameters
    ----------
    x, covariance: state (9,) and covariance (9, 9) in the order of ``model.STATE_NAMES`` [nT, -].
    noise_nt: white noise, 1 sigma per axis [nT]: as given, or as the residual shows it.
    residual_rms_nt: rms of |(I+D)B - b| - |H| over the samples used [nT].
    samples, left_out: rows used, and rows without three finite components and a reference, or with B = 0.
    """

    x: Array
    covariance: Array
    noise_nt: float
    residual_rms_nt: float
    samples: int
    left_out: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data, in the form of ``calibrate --json``."""
        return {
            "samples": self.samples,
            "left_out": self.left_out,
            "bias_nt": self.bias_nt.tolist(),
            "D": self.D.tolist(),
            "sigma": {"bias_nt": self.sigma_bias_nt.tolist(), "D": self.sigma_D.tolist()},
            "residual_rms_nt": {"after": self.residual_rms_nt, "noise_floor": self.noise_nt},
        }

    def __repr__(self) -> str:
        head = f"Fit of {self.samples} samples, residual {self.residual_rms_nt:.1f} nT at noise {self.noise_nt:.1f} nT"
        return f"{head}\n{self._table()}"


def fit(B: npt.ArrayLike, H: npt.ArrayLike, noise_nt: float | None = None) -> Fit:
    """Estimate bias, scale and non-orthogonality from arrays, without attitude.

    Parameters
    ----------
    B: measured vectors (n, 3) [nT], sensor axes, in the order of time.
    H: reference field [nT]: vectors (n, 3) in any axes, or magnitudes (n,); only the magnitude is used.
    noise_nt: white noise of the sensor, 1 sigma per axis [nT]; None: taken from the residual.

    Returns a ``Fit``.  Rows that are not finite, and zeros of a failed read, are left out and counted.

    Raises
    ------
    InputRefusedError: shapes that do not fit, fields beyond 1 mT, references near zero, fewer than 50 usable rows.
    NoSolutionError: no sound solution, and which condition was not met.

    The batch solution of the daemon's start: linear least squares in (E, c, s) (Alonso & Shuster 2002), then
    Gauss-Newton on equation (3) with sensitivities free of the radial noise, outliers beyond 6 sigma left out.  Where
    the errors change over the samples, ``calibrate`` on a recording says so; this does not.
    """
    field, magnitude = vectors("B", B), _magnitudes(H)
    if len(field) != len(magnitude):
        accepted = f"as many rows as B are accepted; B has {len(field)}"
        raise InputRefusedError([Fault("rows of H", len(magnitude), accepted)])
    _check_noise(noise_nt)
    usable = np.isfinite(field).all(axis=1) & field.any(axis=1) & np.isfinite(magnitude)
    field, magnitude = field[usable], magnitude[usable]
    _check_sizes(field, magnitude)
    found = batch_solution(field, magnitude, (), noise_nt, FilterConfig())
    if isinstance(found, StartGate):
        raise no_solution(found, field, magnitude)
    solution = gated(found, field, magnitude, noise_nt, thinned=1)
    if isinstance(solution, StartGate):
        raise stopped(solution, found, field, magnitude, noise_nt)
    return Fit(
        x=solution.x,
        covariance=solution.covariance,
        noise_nt=solution.noise_nt,
        residual_rms_nt=rms(scalar_residual(solution.x, field, magnitude)),
        samples=len(field),
        left_out=int(np.count_nonzero(~usable)),
    )


def _magnitudes(H: npt.ArrayLike) -> Array:
    try:
        array = np.asarray(H, dtype=np.float64)
    except (TypeError, ValueError):
        accepted = "magnitudes (n,) or vectors (n, 3) of numbers [nT] are accepted"
        raise InputRefusedError([Fault("H", type(H).__name__, accepted)]) from None
    if array.ndim == 1:
        return array
    return np.asarray(np.linalg.norm(vectors("H", array), axis=1))


def _check_noise(noise_nt: float | None) -> None:
    if noise_nt is not None and not 0.0 < noise_nt <= LARGEST_NT:
        raise InputRefusedError(
            [Fault("noise_nt", noise_nt, "a number above 0 nT, or None to estimate it, is accepted")]
        )


def _check_sizes(field: Array, magnitude: Array) -> None:
    """Refuse what no sensor reads and no place has; a unit that was mistaken shows here."""
    if len(field) < FEWEST_SAMPLES:
        accepted = f"at least {FEWEST_SAMPLES} rows of finite numbers are needed"
        raise InputRefusedError([Fault("usable rows of B and H", len(field), accepted)])
    if np.abs(field).max() > LARGEST_NT:
        accepted = f"at most {LARGEST_NT:g} nT is accepted; is B in nT? (1 uT = 1000 nT, 1 G = 100000 nT)"
        raise InputRefusedError([Fault("largest component of B", float(np.abs(field).max()), accepted)])
    if magnitude.min() < SMALLEST_REFERENCE_NT:
        accepted = f"at least {SMALLEST_REFERENCE_NT:g} nT is accepted; is H in nT? (1 uT = 1000 nT, 1 G = 100000 nT)"
        raise InputRefusedError([Fault("smallest magnitude of H", float(magnitude.min()), accepted)])
