"""Final errors of a run, time to settle, and consistency of errors and sigmas (NEES)."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.views.nine import PARAMETERS, Parameter
from magcal_service.wire.messages import Estimate, Verdict
from sim_sensor.view.history import FloatArray, History, covariance_matrix, inside

__all__ = ["ONE_FLIGHT_NEES", "ParameterSummary", "Summary", "summarise"]

ONE_FLIGHT_NEES: Final = (2.7, 19.0)
"""Between these lie 95 % of single draws of chi-square with nine degrees of freedom: its 2.5 and 97.5 % points."""


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

    def text(self) -> str:
        """Plain text of at most 80 columns."""
        head = f"{'':4}{'unit':>5}{'estimate':>11}{'3 sigma':>10}"
        if self.truth_known:
            head += f"{'truth':>10}{'error':>10}{'in 3s':>7}{'ticks in':>10}{'settled':>10}"
        lines = [head, *(self._row(row) for row in self.rows), ""]
        if self.truth_known:
            count = sum(row.inside for row in self.rows)
            lines.append(f"{count} of {len(self.rows)} final errors inside 3 sigma")
            lines.append(self._draw())
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

    def _draw(self) -> str:
        """NEES beside what single flights have."""
        low, high = ONE_FLIGHT_NEES
        outside = "" if low <= self.nees <= high else ", not this one"
        return f"NEES {self.nees:.1f}: one flight is one draw; 95 % lie from {low} to {high}{outside}; mean 9"

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
