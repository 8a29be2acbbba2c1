"""The public face: its names, what importing it costs, and that it is the same as what the commands use."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import magcal_service as magcal

PUBLIC = {
    "Answer",
    "Calibration",
    "Craft",
    "ExtraMissingError",
    "Filter",
    "Fit",
    "InputRefusedError",
    "JointAnswer",
    "MagcalError",
    "NoSolutionError",
    "Pipeline",
    "Recording",
    "Replay",
    "Sensor",
    "Spin",
    "Ticks",
    "Trust",
    "__version__",
    "calibrate",
    "diagnose",
    "fit",
    "read_recording",
    "replay",
}


def test_the_public_names_are_these_and_no_other() -> None:
    """A name that is dropped or added is a decision, in the changelog too."""
    assert set(magcal.__all__) == PUBLIC


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_every_public_name_is_there_and_has_a_docstring(name: str) -> None:
    value = getattr(magcal, name)
    assert name in dir(magcal)
    assert name == "__version__" or value.__doc__


def test_every_name_is_what_its_home_has() -> None:
    for name, (module, own_name) in magcal._HOMES.items():
        home = importlib.import_module(f"magcal_service.{module}")
        assert getattr(magcal, name) is getattr(home, own_name)


def test_an_unknown_name_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(AttributeError, match=r"'magcal_service' has no attribute 'calibrait'; public: .*calibrate"):
        magcal.calibrait  # noqa: B018


def loaded_by(code: str) -> set[str]:
    """Modules loaded after a statement in a fresh interpreter, by their top name."""
    command = [sys.executable, "-c", f"{code}\nimport sys; print(*sorted(sys.modules))"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_nothing_but_its_version() -> None:
    before, after = loaded_by("pass"), loaded_by("import magcal_service")
    assert {name for name in after - before if name.startswith("magcal_service")} == {
        "magcal_service",
        "magcal_service.base",
        "magcal_service.base.version",
    }
    assert not {"numpy", "zenoh", "serial", "msgpack"} & after


def test_a_fit_of_arrays_loads_no_link_and_no_extra() -> None:
    loaded = loaded_by("import magcal_service; magcal_service.fit")
    assert "numpy" in loaded
    assert not {"zenoh", "serial", "msgpack", "ppigrf", "pandas", "matplotlib", "scipy", "rich", "mcap"} & loaded
