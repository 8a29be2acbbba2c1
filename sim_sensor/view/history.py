"""The estimates of a run in order of arrival, with the truth where it is known."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.views.nine import PARAMETERS, sigmas, values
from magcal_service.wire.messages import Estimate, Verdict

__all__ = ["History", "covariance_matrix", "inside"]

FloatArray = npt.NDArray[np.float64]


_SIZE = len(PARAMETERS)


def inside(error: float, sigma: float) -> bool:
    """Whether an error lies within three standard deviations; False where either is not a number."""
    return abs(error) <= 3.0 * sigma


def covariance_matrix(estimate: Estimate) -> FloatArray:
    """The full 9x9 covariance of an estimate [nT^2, nT, -]."""
    upper = np.zeros((_SIZE, _SIZE))
    upper[np.triu_indices(_SIZE)] = estimate.covariance
    full: FloatArray = upper + np.triu(upper, 1).T
    return full


class History:
    """Collects estimates in order of arrival.

    Parameters
    ----------
    start_ns: source time that counts as zero [ns]; the first estimate's own time where None.

    Estimates with the verdict ``not_started`` carry no numbers yet and are only counted (``waiting``).
    """

    def __init__(self, start_ns: int | None = None) -> None:
        self.start_ns = start_ns
        self.waiting = 0
        self.last: Estimate | None = None
        self.verdicts: list[Verdict] = []
        self._rows: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, estimate: Estimate, truth: Sequence[float] | None = None) -> None:
        """Append one estimate, with the nine true errors at its time where they are known."""
        if self.start_ns is None:
            self.start_ns = estimate.time_ns
        self.last = estimate
        if estimate.verdict is Verdict.NOT_STARTED:
            self.waiting += 1
            return
        true_values = tuple(truth) if truth is not None else (math.nan,) * _SIZE
        time_s = (estimate.time_ns - self.start_ns) * 1e-9
        rms = (estimate.residual_rms_nt, estimate.noise_nt)
        self._rows.append((time_s, *values(estimate), *sigmas(estimate), *true_values, *rms))
        self.verdicts.append(estimate.verdict)

    def _columns(self, start: int, stop: int) -> FloatArray:
        table = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 3 * _SIZE + 3)
        return table[:, start:stop]

    @property
    def time_s(self) -> FloatArray:
        """Sample time of each estimate since ``start_ns`` [s], shape (n,)."""
        return self._columns(0, 1)[:, 0]

    @property
    def x(self) -> FloatArray:
        """The estimates [nT and -], shape (n, 9)."""
        return self._columns(1, 1 + _SIZE)

    @property
    def sigma(self) -> FloatArray:
        """Their standard deviations [nT and -], shape (n, 9)."""
        return self._columns(1 + _SIZE, 1 + 2 * _SIZE)

    @property
    def truth(self) -> FloatArray:
        """The true errors [nT and -], shape (n, 9), NaN where unknown."""
        return self._columns(1 + 2 * _SIZE, 1 + 3 * _SIZE)

    @property
    def residual_rms_nt(self) -> FloatArray:
        """The daemon's running rms of |(I+D)B - b| - |H| [nT], shape (n,)."""
        return self._columns(1 + 3 * _SIZE, 2 + 3 * _SIZE)[:, 0]

    @property
    def noise_nt(self) -> FloatArray:
        """The sensor noise the filter assumes [nT], shape (n,)."""
        return self._columns(2 + 3 * _SIZE, 3 + 3 * _SIZE)[:, 0]

    def write_csv(self, path: Path) -> None:
        """One row per estimate: time, nine values, nine sigmas, nine truths (empty where unknown), rms, verdict."""
        units = ["_nt" if parameter.unit == "nT" else "" for parameter in PARAMETERS]
        names = [parameter.name + unit for parameter, unit in zip(PARAMETERS, units, strict=True)]
        header = ["time_s", *names, *(f"sigma_{n}" for n in names), *(f"true_{n}" for n in names)]
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*header, "residual_rms_nt", "noise_nt", "verdict"])
            for row, verdict in zip(self._rows, self.verdicts, strict=True):
                writer.writerow([*("" if math.isnan(value) else value for value in row), verdict.value])
