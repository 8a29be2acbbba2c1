"""What is amiss with a craft is said, and nothing where nothing is."""

from __future__ import annotations

from dataclasses import replace

import pytest

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.health.figures import troubles
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
