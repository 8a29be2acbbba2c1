"""Checkpoints of many craft are written a few at a time: between two, messages are looked for."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.checkpoints.schedule import Schedule
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link


class Disk:
    """Takes every checkpoint, and notes whose; ``stop`` is set once there has been a second round."""

    def __init__(self, stop: threading.Event) -> None:
        self.counters: Counter[str] = Counter()
        self.trouble = ""
        self.done: list[str] = []
        self.stop = stop

    def save(self, pipelines: Iterable[Pipeline]) -> bool:
        self.done += [pipeline.label for pipeline in pipelines]
        if len(self.done) >= 10:
            self.stop.set()
        return True


def test_messages_are_looked_for_between_the_checkpoints_of_many_craft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"c{number}" for number in range(5)]
    stop = threading.Event()
    disk = Disk(stop)
    monkeypatch.setattr(Schedule, "due", lambda _: True)
    with open_link("loop:turns", Role.SERVICE, crafts=names) as link:
        config = Config(link.address, tuple(map(CraftConfig, names)), state=StateConfig(tmp_path))
        service = Service(config, link, checkpoints=disk)  # type: ignore[arg-type]
        receive = link.receive

        def looked(timeout_s: float) -> Any:
            disk.done.append(f"look {timeout_s:g}")
            return receive(0.0)

        monkeypatch.setattr(link, "receive", looked)
        service.run(stop)
    assert disk.done[:8] == ["look 0.5", "c0", "c1", "look 0", "c2", "c3", "look 0", "c4"]
    assert disk.done[-5:] == names
