"""Verdict and reasons of a recording about which something has to be answered first."""

from __future__ import annotations

from collections.abc import Iterable

from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict


def doubted_verdict(verdict: Verdict, is_open: bool) -> Verdict:
    """The verdict; ``doubtful`` in place of a better one while a question about the recording is open."""
    believed = verdict in (Verdict.TRUSTED, Verdict.CONVERGING)
    return Verdict.DOUBTFUL if believed and is_open else verdict


def doubted_reasons(reasons: Iterable[str], is_open: bool) -> tuple[str, ...]:
    """The reasons' codes; while a question is open it is the first of them, and no physics is named."""
    if not is_open:
        return tuple(reasons)
    return (Reason.RECORDING_DOUBTFUL, *(reason for reason in reasons if reason != Reason.MODEL_DOUBTFUL))
