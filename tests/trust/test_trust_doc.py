"""docs/trust.md and docs/integrity.md name every verdict, reason and hazard that the code can give, and no other."""

from __future__ import annotations

import re
from pathlib import Path

from magcal_service.trust.hazards import Hazard
from magcal_service.trust.modes import MODES
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.messages import Verdict

DOCS = Path(__file__).resolve().parents[2] / "docs"
NO_MODE = {
    "of every start": {Reason.POOR_COVERAGE, Reason.NO_SOLUTION, Reason.NOT_SETTLED},
    "they come with model_doubtful, or before it": {
        Reason.COLLAPSED, Reason.INCONSISTENT, Reason.STRUCTURED_RESIDUAL, Reason.DRIFTING_RESIDUAL,
    },
    "they follow reference_wrong and spin_changed": {Reason.RESTARTED, Reason.SPIN_CONTRADICTED},
    "of an orbit or a configuration, from the start on": {
        Reason.SPIN_ALIASING, Reason.NOISE_TOO_HIGH, Reason.NOISE_MISSTATED, Reason.CONSTANT_REFERENCE,
    },
    "offline only": {Reason.RECORDING_DOUBTFUL},
    "of a file, while samples are corrected by it": {Reason.PHYSICS_DOUBTFUL},
}  # fmt: skip
"""Reasons that no degraded mode gives, by why none does."""


def first_cells(page: str, begin: str) -> list[str]:
    """The names in the first column of the table that begins with this row."""
    table = (DOCS / page).read_text(encoding="utf-8").partition(f"\n{begin}")[2].partition("\n\n")[0]
    return re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)


def test_every_verdict_and_reason_is_on_the_page_once() -> None:
    assert sorted(first_cells("trust.md", "| verdict |")) == sorted(Verdict)
    assert sorted(first_cells("trust.md", "| reason |")) == sorted(Reason)


def test_every_reason_has_a_remedy() -> None:
    assert set(REMEDIES) == set(Reason)


def test_every_hazard_is_on_the_page_once() -> None:
    assert sorted(first_cells("integrity.md", "| hazard | what")) == sorted(Hazard)


def test_every_reason_is_that_of_a_degraded_mode_or_none_for_a_cause() -> None:
    without = [reason for reasons in NO_MODE.values() for reason in reasons]
    assert sorted([*{row.reason for row in MODES.values() if row.reason is not None}, *without]) == sorted(Reason)
