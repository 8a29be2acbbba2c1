"""What the estimates said over time, and what can honestly be said about it at the end."""

from __future__ import annotations

import csv
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.wire.messages import Estimate, Verdict

__all__ = [
    "PARAMETERS",
    "History",
    "Parameter",
    "ParameterSummary",
    "Summary",
    "inside",
    "sigmas",
    "summarise",
    "values",
]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the nine errors, as it is shown.

    Parameters
    ----------
    name, unit: the paper's letters and the unit, ``-`` for a pure number.
    decimals: digits after the point.
    settled: an error below this counts as settled.  50 nT, and 0.001 because that moves a field of
        50 000 nT by the same 50 nT.
    """

    name: str
    unit: str
    decimals: int
    settled: float

    def text(self, value: float, sign: str = "") -> str:
        """The value in this parameter's own number format."""
        return f"{value:{sign}.{self.decimals}f}"


PARAMETERS: tuple[Parameter, ...] = (
    *(Parameter(name, "nT", 1, 50.0) for name in ("bx", "by", "bz")),
    *(Parameter(name, "-", 5, 1e-3) for name in ("D11", "D22", "D33", "D12", "D13", "D23")),
)
_SIZE = len(PARAMETERS)
# Places of the variances in the upper triangle, row by row, of a 9x9 covariance: 0, 9, 17, 24, ...
_DIAGONAL = tuple(row * _SIZE - row * (row - 1) // 2 for row in range(_SIZE))


def values(estimate: Estimate) -> tuple[float, ...]:
    """The nine errors in the order of ``PARAMETERS`` [nT and -]."""
    return (*estimate.bias_nt, *estimate.D)


def sigmas(estimate: Estimate) -> tuple[float, ...]:
    """One standard deviation of each of the nine errors [nT and -]; NaN where a variance is negative."""
    variances = (estimate.covariance[place] for place in _DIAGONAL)
    return tuple(math.sqrt(variance) if variance >= 0.0 else math.nan for variance in variances)


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


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """The end of one of the nine errors; truth and what follows from it are NaN or None where truth is unknown.

    Parameters
    ----------
    estimate, sigma, truth, error: final values; error is estimate minus truth.
    share_inside: share of all estimates, the first included, whose error lay within their own 3 sigma.
    settled_s: time from which the error stayed below ``parameter.settled`` to the end [s], None if it never did.
    """

    parameter: Parameter
    estimate: float
    sigma: float
    truth: float
    error: float
    share_inside: float
    settled_s: float | None

    @property
    def inside(self) -> bool:
        """Whether the final error lies within 3 sigma."""
        return inside(self.error, self.sigma)


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run ended with.

    Parameters
    ----------
    rows: one per parameter, in the order of ``PARAMETERS``; empty where the filter never started.
    verdict, reasons, remedy: of the last estimate.
    trusted_s: time from which every verdict to the end was ``trusted`` [s], None if the last one is not.
    nees: error' P^-1 error of the last estimate (9 expected), NaN where truth is unknown or P is singular.
    mean_error: error averaged over the last tenth of the run, one per parameter [nT and -]: neighbouring estimates
        share almost all their data, so this average is hardly more certain than the last estimate itself.
    """

    rows: tuple[ParameterSummary, ...]
    verdict: Verdict
    reasons: tuple[str, ...]
    remedy: str
    trusted_s: float | None
    nees: float
    mean_error: tuple[float, ...]
    residual_rms_nt: float
    noise_nt: float
    samples_used: int
    end_s: float

    @property
    def truth_known(self) -> bool:
        """Whether the final errors could be computed."""
        return bool(self.rows) and not any(math.isnan(row.truth) for row in self.rows)

    @property
    def all_inside(self) -> bool:
        """Whether all nine final errors lie within 3 sigma of a known truth."""
        return self.truth_known and all(row.inside for row in self.rows)

    def text(self) -> str:
        """Plain text of at most 80 columns."""
        head = f"{'':4}{'unit':>5}{'estimate':>11}{'3 sigma':>10}"
        if self.truth_known:
            head += f"{'truth':>10}{'error':>10}{'in 3s':>7}{'ticks in':>10}{'settled':>10}"
        lines = [head, *(self._row(row) for row in self.rows), ""]
        if self.truth_known:
            count = sum(row.inside for row in self.rows)
            lines.append(f"{count} of {len(self.rows)} final errors inside 3 sigma; NEES {self.nees:.1f} (9 expected)")
            settled = [row.settled_s for row in self.rows]
            times = [time_s for time_s in settled if time_s is not None]
            if len(times) == len(settled):
                lines.append(f"errors below 50 nT and 0.001 for good from {max(times):.0f} s of sample time on")
            shown = (f"{p.name} {p.text(e, '+')}" for p, e in zip(PARAMETERS, self.mean_error, strict=True))
            lines.append(_wrap("mean error over the last tenth: " + ", ".join(shown)))
        trusted = "" if self.trusted_s is None else f" without a break since {self.trusted_s:.0f} s"
        lines.append(_wrap(f"verdict: {self.verdict.value}{trusted}" + "".join(f"; {r}" for r in self.reasons)))
        if self.remedy:
            lines.append(_wrap(f"remedy: {self.remedy}"))
        lines.append(f"residual rms {self.residual_rms_nt:.1f} nT at a sensor noise of {self.noise_nt:.1f} nT")
        return "\n".join(lines)

    def _row(self, row: ParameterSummary) -> str:
        show = row.parameter.text
        unit = row.parameter.unit
        text = f"{row.parameter.name:4}{unit:>5}{show(row.estimate):>11}{show(3.0 * row.sigma):>10}"
        if self.truth_known:
            mark = "yes" if row.inside else "NO"
            settled = "never" if row.settled_s is None else f"{row.settled_s:.0f} s"
            text += f"{show(row.truth):>10}{show(row.error, '+'):>10}{mark:>7}{row.share_inside:>10.1%}{settled:>10}"
        return text


def _wrap(text: str) -> str:
    return textwrap.fill(text, width=79, subsequent_indent="  ")


def _since(good: npt.NDArray[np.bool_], time_s: FloatArray) -> float | None:
    """Time from which ``good`` holds to the end; None where it does not hold at the end."""
    bad = np.flatnonzero(~good)
    first = 0 if bad.size == 0 else int(bad[-1]) + 1
    return float(time_s[first]) if first < good.size else None


def summarise(history: History) -> Summary:
    """Sum up a history of at least one estimate; ValueError where it has none."""
    last = history.last
    if last is None:
        raise ValueError("no estimate has arrived; nothing can be summed up")
    time_s, x, sigma, truth = history.time_s, history.x, history.sigma, history.truth
    error = x - truth
    rows: list[ParameterSummary] = []
    for i, parameter in enumerate(PARAMETERS if len(history) else ()):
        share = float(np.mean(np.abs(error[:, i]) <= 3.0 * sigma[:, i]))
        settled_s = _since(np.abs(error[:, i]) < parameter.settled, time_s)
        final = (float(x[-1, i]), float(sigma[-1, i]), float(truth[-1, i]), float(error[-1, i]))
        rows.append(ParameterSummary(parameter, *final, share, settled_s))
    trusted = np.array([verdict is Verdict.TRUSTED for verdict in history.verdicts], dtype=np.bool_)
    return Summary(
        rows=tuple(rows),
        verdict=last.verdict,
        reasons=last.reasons,
        remedy=last.remedy,
        trusted_s=_since(trusted, time_s) if last.verdict is Verdict.TRUSTED else None,
        nees=_nees(last, error[-1]) if len(history) else math.nan,
        mean_error=tuple(error[-max(1, len(history) // 10) :].mean(axis=0).tolist()) if len(history) else (),
        residual_rms_nt=last.residual_rms_nt,
        noise_nt=last.noise_nt,
        samples_used=last.samples_used,
        end_s=float(time_s[-1]) if len(history) else 0.0,
    )


def _nees(estimate: Estimate, error: FloatArray) -> float:
    try:
        return float(error @ np.linalg.solve(covariance_matrix(estimate), error))
    except np.linalg.LinAlgError:
        return math.nan
