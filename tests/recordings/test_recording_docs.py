"""The descriptors in docs/recording-format.md are loaded as they stand there."""

import re
from pathlib import Path

import pytest

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.report import RowFault

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "recording-format.md").read_text()
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_each_example_of_the_page_is_accepted(tmp_path: Path, number: int) -> None:
    (tmp_path / "log.toml").write_text(EXAMPLES[number])
    assert load_descriptor(tmp_path / "log.toml").samples.parent == tmp_path


def test_the_magnetometers_of_the_page_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "log.toml").write_text(EXAMPLES[1])
    descriptor = load_descriptor(tmp_path / "log.toml")
    assert descriptor.sources == ("mag1", "mag2")
    assert descriptor.of_source("mag2").magnetometer.noise_nt == 120.0


def test_the_page_names_every_unit_of_a_channel() -> None:
    assert [unit for unit in CHANNEL_UNITS if unit and f"`{unit}`" not in PAGE] == []


def test_the_page_names_every_kind_of_fault() -> None:
    assert [fault.value for fault in RowFault if f"`{fault.value}`" not in PAGE] == []


OTHER = re.compile(
    r"^description = |`description`|telemetry's description|description=|\.description\b|\"description\""
)
"""What is called so and is no descriptor: a scenario's own words, a parser's, and fields of JSON schemas and XTCE."""


def test_pages_helps_and_messages_have_one_word_for_what_describes_a_log() -> None:
    """They had two, descriptor and description."""
    pages = [*ROOT.glob("docs/*.md"), *ROOT.glob("docs/tutorials/*.md"), ROOT / "README.md"]
    sources = [path for path in ROOT.glob("magcal_service/**/*.py") if path.name != "xtce.py"]
    said = [
        (path.name, line)
        for path in [*pages, *sources]
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\b(description|manifest)s?\b", line, re.I) and not OTHER.search(line)
    ]
    assert len(pages) > 40
    assert len(sources) > 300
    assert said == []
