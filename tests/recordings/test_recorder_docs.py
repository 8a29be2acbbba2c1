"""docs/recorder.md says what the code does."""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path

from magcal_service.cli.record import add_record
from magcal_service.recordings import mcap
from magcal_service.recordings.recorder import MOST_WAITING, PATIENCE_S, Recorder
from magcal_service.recordings.session_arrays import WIDEST_PERIODS
from tests.recordings.sessions import craft, settings

PAGE_FOLDER = Path(__file__).resolve().parents[2] / "docs"
PAGE = (PAGE_FOLDER / "recorder.md").read_text(encoding="utf-8")


def test_the_page_names_every_counter_and_no_other(tmp_path: Path) -> None:
    with Recorder(settings(tmp_path), [craft()]) as recorder:
        known = set(recorder.counters)
    assert set(re.findall(r"`(record\.[a-z]+)`", PAGE)) == known


def test_the_page_names_every_command() -> None:
    parser = argparse.ArgumentParser()
    add_record(parser)
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    assert set(re.findall(r"magcal record ([a-z]+)", PAGE)) == set(commands.choices)


def test_the_page_names_every_metadata_record() -> None:
    assert set(re.findall(r"`(magcal\.[a-z]+)`", PAGE)) == {mcap.SESSION, mcap.CRAFT, mcap.STATE, mcap.DROPPED}


def test_the_pages_numbers_are_the_codes() -> None:
    assert f"Up to {MOST_WAITING} messages wait" in PAGE
    assert WIDEST_PERIODS == 2.5
    assert "two and a half of its periods" in PAGE


def test_the_pages_example_is_toml() -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    assert set(tomllib.loads(example)) == {"record"}


def test_the_recorder_ends_before_the_service_manager_loses_its_patience() -> None:
    unit = (PAGE_FOLDER.parent / "deploy" / "magcal.service").read_text(encoding="utf-8")
    (limit_s,) = re.findall(r"^TimeoutStopSec=(\d+)$", unit, flags=re.MULTILINE)
    assert 0.5 * int(limit_s) >= PATIENCE_S
