"""``[[craft]] physics``: the file is read and checked with the configuration, and its example in the docs is one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.config.reader import load_config
from magcal_service.daemon.checkpoints.files import config_digest
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.model_file import parse_model, text_of
from tests.cli.cli_inputs import run

DOC = (Path(__file__).resolve().parents[2] / "docs/physics-file.md").read_text(encoding="utf-8")
EXAMPLE = re.findall(r"```toml\n(.*?)```", DOC, flags=re.DOTALL)[0]


def written(tmp_path: Path, physics: str, value: str | None = None) -> Path:
    (tmp_path / "physics.toml").write_text(physics, encoding="utf-8")
    path = tmp_path / "daemon.toml"
    named = repr(str(tmp_path / "physics.toml")) if value is None else value
    path.write_text(f'version = 1\n[[craft]]\nname = "demo"\nphysics = {named}\n', encoding="utf-8")
    return path


def test_the_documents_example_is_read_with_the_configuration(tmp_path: Path) -> None:
    """Its text is in the configuration, so that a checkpoint under another model is not taken up."""
    craft = load_config(written(tmp_path, EXAMPLE)).crafts[0]
    assert craft.physics is not None
    assert craft.physics.text == text_of(parse_model(EXAMPLE.encode()))
    other = load_config(written(tmp_path, EXAMPLE.replace("8.0, -6.0", "8.5, -6.0"))).crafts[0]
    assert config_digest(other) != config_digest(craft)


def test_its_faults_are_the_configurations(tmp_path: Path) -> None:
    """An unknown effect is refused with the nearest name."""
    with pytest.raises(ConfigError, match=r"physics.toml: effect\[0\].name: .*did you mean 'thermal_bias'"):
        load_config(written(tmp_path, EXAMPLE.replace('"thermal_bias"', '"thermal_bais"')))


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        (
            'driver = "ch',
            'variant = "recorded lat"\ndriver = "ch',
            "variant: 'recorded lat' is refused; of thermal_bias",
        ),
        ("zero_degc = 20.0", "", "constants.zero_degc: missing; it is required of thermal_bias by channel:temperature"),
    ],
)
def test_a_form_that_the_catalogue_does_not_have_is_the_configurations_fault(
    tmp_path: Path, old: str, new: str, where: str
) -> None:
    """``run --check`` says it, before any sample: a number that is missing would have been taken for another."""
    assert EXAMPLE.count(old) == 1
    done = run("run", "--check", "--config", written(tmp_path, EXAMPLE.replace(old, new)))
    assert done.code == 2
    assert f"physics.toml: effect[0].{where}" in done.err
    assert "have the file made again by magcal diagnose" in done.err


@pytest.mark.parametrize("value", ["1", '""', '"no such.toml"'])
def test_what_is_no_file_is_refused(tmp_path: Path, value: str) -> None:
    """A number, an empty text, a file that is not there."""
    with pytest.raises(ConfigError):
        load_config(written(tmp_path, EXAMPLE, value))


def test_a_model_of_another_craft_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    other = EXAMPLE.replace('clock = "utc"', 'clock = "utc"\ncraft = "other"')
    Pipeline(load_config(written(tmp_path, other)).crafts[0])
    (record,) = caplog.records
    assert record.message == "demo: physics.toml is of craft other; it is subtracted all the same"


def test_a_model_that_is_not_to_be_acted_on_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """By the reasons that stand in the file; the same file without them says nothing."""
    Pipeline(load_config(written(tmp_path, EXAMPLE)).crafts[0])
    assert not caplog.records
    Pipeline(
        load_config(written(tmp_path, EXAMPLE.replace('clock = "utc"', 'clock = "utc"\ncraft = "demo"'))).crafts[0]
    )
    assert not caplog.records
    doubtful = EXAMPLE.replace('clock = "utc"', 'clock = "utc"\ndoubts = "name_uncertain"')
    Pipeline(load_config(written(tmp_path, doubtful)).crafts[0])
    (record,) = caplog.records
    (doubt,) = doubts_of("name_uncertain")
    assert record.message == f"demo: physics.toml is subtracted all the same: {doubt}"
