"""The descriptions in docs/recording-format.md are loaded as they stand there."""

import re
from pathlib import Path

import pytest

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.report import RowFault

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "recording-format.md").read_text()
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
