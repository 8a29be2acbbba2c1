"""What is amiss with a craft is said, and nothing where nothing is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.health.figures import troubles
from magcal_service.daemon.health.report import in_words
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict


@pytest.mark.parametrize(
    ("verdict", "silent_s", "told"),
    [
        (Verdict.TRUSTED, 0.0, []),
        (Verdict.CONVERGING, 59.0, []),
        (Verdict.TRUSTED, 61.0, ["no sample for 61 s"]),
        (Verdict.DOUBTFUL, 0.0, ["doubtful: collapsed"]),
        (Verdict.NOT_STARTED, 75.0, ["no sample for 75 s", "not_started: collapsed"]),
    ],
)
def test_verdict_and_silence(verdict: Verdict, silent_s: float, told: list[str]) -> None:
    pipeline = Pipeline(CraftConfig("demo"))
    pipeline.trust = replace(pipeline.trust, verdict=verdict, reasons=(Reason.COLLAPSED,))
    assert troubles(pipeline, silent_s) == told


def summary(**verdicts: list[str]) -> dict[str, object]:
    """As ``Health.summary`` has it: of each craft its verdict, and its troubles behind that."""
    return {"craft": {name: {"verdict": told[0], "troubles": told[1:]} for name, told in verdicts.items()}}


@pytest.mark.parametrize(
    ("of", "said"),
    [
        (summary(a=["trusted"], b=["converging"]), "a trusted, b converging; no troubles"),
        (
            summary(a=["doubtful", "doubtful: aliased", "no sample for 61 s"]),
            "a doubtful (aliased; no sample for 61 s)",
        ),
        (
            summary(a=["trusted"], b=["trusted"], c=["trusted"], d=["doubtful", "doubtful: aliased"]),
            "3 trusted, 1 doubtful; d doubtful (aliased)",
        ),
        (
            summary(a=["doubtful", "x"], b=["doubtful", "x"], c=["doubtful", "x"], d=["doubtful", "y"]),
            "4 doubtful; a doubtful (x), b doubtful (x), c doubtful (x) and 1 more with troubles",
        ),
        (summary(**{name: ["trusted"] for name in "abcd"}), "4 trusted; no troubles"),
    ],
)
def test_the_line_of_the_log_names_craft_verdict_and_trouble(of: dict[str, object], said: str) -> None:
    assert in_words(of) == said
