"""How far an estimate is to be trusted, as it goes out with each result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.messages import Verdict


@dataclass(frozen=True, slots=True)
class Trust:
    """A verdict with the reasons against it and the first one's remedy, and the protection level.

    ``protection_nt`` [nT] and what sets it, ``protection_by``, are None while unknown; ``no_level`` says why, where
    none comes by itself.
    """

    verdict: Verdict
    reasons: tuple[Reason, ...]
    remedy: str
    protection_nt: float | None = None
    protection_by: str | None = None
    no_level: str = ""

    @property
    def protection(self) -> str:
        """The level in words, or why there is none; empty while it is to come."""
        if self.protection_nt is None:
            return f", no protection level ({self.no_level})" if self.no_level else ""
        return f", protected to {self.protection_nt:.0f} nT ({self.protection_by})"


NOT_STARTED: Final = Trust(Verdict.NOT_STARTED, (Reason.COLLECTING,), REMEDIES[Reason.COLLECTING])
"""Of an estimate that there is not yet."""
