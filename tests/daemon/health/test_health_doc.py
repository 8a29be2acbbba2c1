"""docs/health.md names the metrics that the code renders, each of them and no other."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.health.report import Health
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.links import Role, open_link
from magcal_service.ticks.rejection import Rejection

TEXT = (Path(__file__).resolve().parents[3] / "docs/health.md").read_text(encoding="utf-8")
PLAIN = {"magcal_build_info", "magcal_uptime_seconds"}
"""Those that say themselves what they are."""


def test_every_metric_is_listed_and_no_other() -> None:
    with open_link("loop:doc", Role.SERVICE) as link:
        rendered = Health(link).metrics([Pipeline(CraftConfig("demo"))], Counter())
    families = set(re.findall(r"^# TYPE (magcal_\w+)", rendered, re.MULTILINE))
    listed = set(re.findall(r"magcal_\w+", TEXT))
    listed |= {f"magcal_messages{name}total" for name in re.findall(r"`(_lost_|_doubled_|_late_)`", TEXT)}
    assert listed - {"magcal_loop_age_seconds"} == families - PLAIN


def test_every_refusal_of_a_sample_is_listed() -> None:
    assert [name for name in Rejection if f"`{name}`" not in TEXT] == []
