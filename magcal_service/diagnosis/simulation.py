"""The nine errors that a simulation was made with, from its scenario file."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.typed_toml import Table, TomlKind, nearest, open_toml, refuse_another
from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.model import Array

_ACCEPTED: Final = "give a scenario's TOML file, or the name of one that comes with sim-sensor"


def simulation_errors(name_or_file: str) -> Array:
    """b and D (9,) of a scenario, in the order of ``model.STATE_NAMES``.

    Only ``[magnetometer]`` is read: what else the scenario holds is the simulator's to check.

    Raises ``ConfigError`` where the file cannot be read, where it has no such numbers, or where it draws them from a
    seed, so that the file alone does not say what they were.
    """
    path = simulation_file(name_or_file)
    top = open_toml(path, ConfigError)
    refuse_another(top, TomlKind.SCENARIO, ConfigError)
    magnetometer = top.table("magnetometer", required=True)
    bias = D = None
    if magnetometer is not None:
        bias = magnetometer.numbers("bias_nt", 3, (0.0, 0.0, 0.0))
        D = magnetometer.numbers("D", 6, (0.0,) * 6)
    _refuse_drawn(top)
    if top.faults:
        raise ConfigError(top.faults)
    assert bias is not None
    assert D is not None
    x = np.array([*bias, *D])
    if is_collapsed(x):
        accepted = "I + D with eigenvalues from 0.5 to 2 is accepted"
        raise ConfigError([Fault(f"{path.name}: magnetometer.D", list(D), accepted)])
    return x


def _refuse_drawn(top: Table) -> None:
    random = top.table("random")
    for key in ("bias_nt", "D") if random is not None else ():
        assert random is not None
        if random.has(key):
            accepted = "errors that a seed draws are not in the file; write those of truth.json into [magnetometer]"
            random.refuse(key, random.content[key], accepted)


def simulation_file(name_or_file: str) -> Path:
    """The scenario's file: a path, or the name of one that comes with the simulator."""
    path = Path(name_or_file)
    if path.is_file() or path.suffix == ".toml":
        return path
    shipped = _shipped()
    if name_or_file in shipped:
        return shipped[name_or_file]
    known = f"; {nearest(name_or_file, shipped)}" if shipped else ""
    raise ConfigError([Fault("--simulation", name_or_file, _ACCEPTED + known)])


def _shipped() -> dict[str, Path]:
    """Scenarios that come with the simulator, where it is installed; found without importing it."""
    spec = find_spec("sim_sensor")
    folders = (spec.submodule_search_locations or ()) if spec is not None else ()
    return {path.stem: path for folder in folders for path in sorted((Path(folder) / "scenarios").glob("*.toml"))}
