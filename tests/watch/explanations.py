"""An explanation by its numbers."""

from __future__ import annotations

from magcal_service.watch.evidence import Explanation


def explained(name: str, gain_nats: float, columns: int = 3, tries: int = 1) -> Explanation:
    return Explanation((name,), "", gain_nats, columns, tries)
