"""The results of one magnetometer over time, as numbers."""

from __future__ import annotations

import math
from typing import Final

from magcal_service.trust.reasons import Reason
from magcal_service.views.nine import sigmas, values
from magcal_service.views.series import Recent, Row, Whole
from magcal_service.wire.messages import Estimate, Verdict

MOST_RECENT: Final = 120
"""Newest results that are kept: two minutes at 1 Hz, far more than come between two updates of a reader."""

MOST_WHOLE: Final = 600
"""Results that are kept of the whole session: about one for each two pixels of a plot; 0.5 MB."""

_BACK_MS: Final = 60_000.0  # so far back is a new beginning, such as a restarted node, and no late result
_VERDICTS: Final = tuple(Verdict)


def _known(value: float | None) -> float | None:
    """A number that JSON has; None for what is unknown or no number."""
    return value if value is not None and math.isfinite(value) else None


def result_row(estimate: Estimate, verdict: Verdict) -> Row:
    """One result: time [ms of the samples' own clock], the nine errors, 3 sigma of each [nT and -], and six more.

    Before there is an estimate the nine and their sigma are None.  The six are the protection level, rms of the
    residual and noise [nT], the ticks used, the verdict's place in ``Verdict``, and 1 where the reasons say that the
    protection level is too high, else 0.
    """
    nine = (*values(estimate), *(3.0 * sigma for sigma in sigmas(estimate)))
    started = estimate.verdict is not Verdict.NOT_STARTED
    return (
        estimate.time_ns * 1e-6,
        *(_known(value) if started else None for value in nine),
        _known(estimate.protection_nt),
        _known(estimate.residual_rms_nt),
        _known(estimate.noise_nt),
        estimate.tick,
        _VERDICTS.index(verdict),
        int(Reason.UNPROTECTED in estimate.reasons),
    )


class History:
    """The newest results, and every n-th of all."""

    def __init__(self) -> None:
        self.recent, self.whole = Recent(MOST_RECENT), Whole(MOST_WHOLE)
        self._newest_ms = -math.inf

    def continues_with(self, estimate: Estimate) -> bool:
        """Whether a result belongs to these; if not, time has gone back and another history begins."""
        return self._newest_ms - estimate.time_ns * 1e-6 <= _BACK_MS

    def take(self, estimate: Estimate, verdict: Verdict) -> None:
        """Append a result under the verdict that is shown of it; one that is out of order is left out."""
        time_ms = estimate.time_ns * 1e-6
        if time_ms <= self._newest_ms:
            return
        self._newest_ms = time_ms
        row = result_row(estimate, verdict)
        self.recent.add(row)
        self.whole.add(row)
