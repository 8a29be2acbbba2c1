"""The results of one magnetometer as they arrive: verdict, nine errors, counters, finding, events."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.trust.doubted import doubted_reasons, doubted_verdict
from magcal_service.trust.reasons import REMEDIES
from magcal_service.views.history import History
from magcal_service.views.nine import PARAMETERS, sigmas, values
from magcal_service.views.words import event_of, finding_of
from magcal_service.wire.messages import CommandReply, Estimate, Status, Verdict

_MOST_EVENTS: Final = 40  # choice: a page of them
_REMEDIES: Final = {str(reason): remedy for reason, remedy in REMEDIES.items()}


@dataclass(frozen=True, slots=True)
class Replayed:
    """A recording whose results are shown.

    Parameters
    ----------
    path: what a command that diagnoses a finding is given.
    defects: what has to be answered about the recording itself, a line each; while there is one, nothing is trusted.
    """

    path: str
    defects: tuple[str, ...] = ()


class ResultView:
    """What a page shows of one magnetometer's estimates and statuses; ``recording`` is what is replayed, if any."""

    def __init__(self, recording: Replayed | None = None) -> None:
        self.recording = recording
        self.estimate: Estimate | None = None
        self.status: Status | None = None
        self.history = History()
        self.events: deque[tuple[int, str]] = deque(maxlen=_MOST_EVENTS)
        self._event = ""

    def take(self, message: Estimate | Status | CommandReply) -> None:
        """Take a result; a change of verdict, the newest event of a status and a reply are events."""
        if isinstance(message, Estimate):
            if self.estimate is None or self.estimate.verdict is not message.verdict:
                reasons = f" ({', '.join(message.reasons)})" if message.reasons else ""
                self.events.append((message.time_ns, f"verdict {message.verdict}{reasons}"))
            self.estimate = message
            if not self.history.continues_with(message):
                self.history = History()
            self.history.take(message, doubted_verdict(message.verdict, self._open))
        elif isinstance(message, Status):
            event = event_of(message.text)
            if event and event != self._event:
                self._event = event
                self.events.append((message.time_ns, event))
            self.status = message
        elif message.name != "status" or not message.accepted:  # an answered question has changed nothing
            answer = "accepted" if message.accepted else "refused"
            self.events.append((message.time_ns, f"command {message.name} {answer}: {message.text}"))

    @property
    def verdict(self) -> Verdict:
        """The newest verdict, of a recording with open defects as ``trust.doubted`` has it."""
        newest = self.estimate or self.status
        return Verdict.NOT_STARTED if newest is None else doubted_verdict(newest.verdict, self._open)

    @property
    def _open(self) -> bool:
        return self.recording is not None and bool(self.recording.defects)

    def _finding(self) -> dict[str, str] | None:
        if self.status is None or self._open:
            return None
        found = finding_of(self.status.text, None if self.recording is None else self.recording.path)
        return None if found is None else {"what": found.what, "command": found.command}

    def _advice(self) -> list[list[str]]:
        """Each reason with what to do about it; the estimate's first reason in its own words, with the numbers."""
        reasons = () if self.estimate is None else self.estimate.reasons
        own = {} if self.estimate is None else dict.fromkeys(reasons[:1], self.estimate.remedy)
        return [[one, own.get(one) or _REMEDIES.get(one, "")] for one in doubted_reasons(reasons, self._open)]

    def now(self) -> dict[str, Any]:
        """What is said now, as plain data: reasons with remedies, finding, counters, and when [ms] they were said."""
        estimate, status = self.estimate, self.status
        return {
            "verdict": str(self.verdict),
            "reasons": self._advice(),
            "finding": self._finding(),
            "result_ms": None if estimate is None else estimate.time_ns * 1e-6,
            "counters": {} if status is None else dict(sorted(status.counters.items())),
            "status_ms": None if status is None else status.time_ns * 1e-6,
        }

    def shown(self, start_ns: int | None) -> dict[str, Any]:
        """As plain data; times are [s] since ``start_ns``, or since the first event where it is None."""
        estimate, status = self.estimate, self.status
        if start_ns is None:
            start_ns = self.events[0][0] if self.events else 0
        return {
            "verdict": str(self.verdict),
            "reasons": self._advice(),
            "defects": [] if self.recording is None else list(self.recording.defects),
            "nine": [] if estimate is None else nine_rows(estimate),
            "started": estimate is not None and estimate.verdict is not Verdict.NOT_STARTED,
            "protection_nt": None if estimate is None else estimate.protection_nt,
            "protection_by": None if estimate is None else estimate.protection_by,
            "residual_rms_nt": None if estimate is None else round(estimate.residual_rms_nt, 2),
            "noise_nt": None if estimate is None else round(estimate.noise_nt, 2),
            "method": "" if estimate is None else estimate.method,
            "ticks": 0 if estimate is None else estimate.tick,
            "ellipsoid": None if estimate is None else ellipsoid(estimate),
            "finding": self._finding(),
            "status": "" if status is None else status.text,
            "uptime_s": None if status is None else round(status.uptime_s, 1),
            "counters": {} if status is None else dict(sorted(status.counters.items())),
            "events": [[round((when - start_ns) * 1e-9, 1), text] for when, text in reversed(self.events)],
        }


def nine_rows(estimate: Estimate) -> list[list[str]]:
    """Name, value, 3 sigma and unit of each of the nine errors, as text."""
    shown = zip(PARAMETERS, values(estimate), sigmas(estimate), strict=True)
    return [[one.name, one.text(value), one.text(3.0 * sigma), one.unit] for one, value, sigma in shown]


def ellipsoid(estimate: Estimate) -> dict[str, list[float]] | None:
    """How the sensor shows a sphere: ``B = matrix (u |H| + bias_nt)``, the matrix row by row; None where D shrinks all.

    By equation (5) inverted: (I + D) B - b is the calibrated vector.
    """
    d11, d22, d33, d12, d13, d23 = estimate.D
    stretch = np.eye(3) + np.array([[d11, d12, d13], [d12, d22, d23], [d13, d23, d33]])
    if abs(np.linalg.det(stretch)) < 1e-3:
        return None
    return {"matrix": np.linalg.inv(stretch).round(6).ravel().tolist(), "bias_nt": list(estimate.bias_nt)}
