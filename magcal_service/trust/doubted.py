"""Verdict and reasons where what they rest on is doubted itself: a recording with an open question, or a physics file
that its diagnosis says not to act on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.trust.verdict import Trust
from magcal_service.wire.kinds import MAX_REASONS
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


def doubted_by_physics(trust: Trust) -> Trust:
    """The verdict on samples that are corrected by a ``physics.toml`` that is not to be acted on: that comes first."""
    if trust.verdict is Verdict.NOT_STARTED:
        return trust
    reasons = (Reason.PHYSICS_DOUBTFUL, *trust.reasons)[:MAX_REASONS]
    verdict, remedy = doubted_verdict(trust.verdict, True), REMEDIES[Reason.PHYSICS_DOUBTFUL]
    return replace(trust, verdict=verdict, reasons=reasons, remedy=remedy)
