"""deploy/foxglove: the layout asks for topics and fields that the recorder writes, and shows each panel once."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from magcal_service.recordings.json_form import schema_of
from magcal_service.recordings.mcap import Topic
from magcal_service.wire.kinds import KINDS

LAYOUT: dict[str, Any] = json.loads(
    (Path(__file__).resolve().parents[2] / "deploy/foxglove/magcal-layout.json").read_text(encoding="utf-8")
)
SCHEMAS = {Topic("demo", kind.name, "", b"").name: schema_of(kind)["properties"] for kind in KINDS}


def asked_for() -> list[str]:
    panels = LAYOUT["configById"].values()
    return [path["value"] for panel in panels for path in panel.get("paths", ())] + [
        panel["topicPath"] for panel in panels if "topicPath" in panel
    ]


def test_every_path_is_a_topic_and_a_field_that_is_recorded() -> None:
    assert len(asked_for()) > 20
    for path in asked_for():
        match = re.fullmatch(r"(/magcal/demo/\w+)(?:\.(\w+)(?:\[(\d)\])?)?", path)
        assert match, path
        topic, name, place = match.groups()
        if name is not None:
            field = SCHEMAS[topic][name]
            assert place is None or int(place) < field["maxItems"], path
        assert topic in SCHEMAS


def panels_in(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else panels_in(node["first"]) + panels_in(node["second"])


def test_every_panel_has_one_place() -> None:
    assert sorted(panels_in(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
