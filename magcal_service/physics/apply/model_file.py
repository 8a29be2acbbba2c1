"""``physics.toml``: what a diagnosis has found, as a model that daemon and simulator apply.  docs/physics-file.md

A model is numbers alone: nine errors, and for each effect the name, driver and form that pick a ``Hypothesis`` of the
catalogue, with the amplitudes by block, the nonlinear numbers and the constants that the form was fitted with.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.errors import InputRefusedError
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array, d_matrix
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.interface import Effect
from magcal_service.typed_toml import Table, nearest, open_toml, parse_toml
from magcal_service.wire.messages import Clock

VERSION: Final = 1
MOST_EFFECTS: Final = 32
_MOST_NUMBERS: Final = 64
_DRIVER: Final = re.compile(r"none|channel:[^\s\x00-\x1f]{1,200}|inferred:[a-z_]{1,32}")
_CONSTANT: Final = re.compile(r"[a-z][a-z0-9_]{0,31}")
_UNIT: Final = 1e-6
"""How far a direction's length may be from 1."""


class ModelError(InputRefusedError):
    """A physics file was refused."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelTerm:
    """One effect of a model.

    Parameters
    ----------
    effect, driver, variant: which hypothesis of the catalogue.
    amplitudes, sigma: by name of the block, in the hypothesis' order; sigma may leave some out.
    nonlinear: by name, in the hypothesis' order.
    constants: what the hypothesis was fitted with, such as the temperature that counts as zero.
    """

    effect: str
    driver: str
    variant: str
    amplitudes: Mapping[str, Array]
    sigma: Mapping[str, Array] = field(default_factory=dict)
    nonlinear: Mapping[str, float] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Note:
    """An effect that is no field, such as nutation: said, and not compensated."""

    effect: str
    says: str
    values: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ModelSpin:
    """A steady turn: axis (3,) in the body and in ECI, mean rate [rad/s] about it."""

    axis_body: tuple[float, float, float]
    axis_eci: tuple[float, float, float]
    rate_rad_s: float


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsModel:
    """A whole file.

    Parameters
    ----------
    recording: name of the recording it comes from.
    origin_ns, clock: instant from which effects count their time.
    x, sigma: the nine errors (9,) and their 1 sigma, fitted together with the effects.
    noise_nt: white noise, 1 sigma per axis [nT].
    """

    recording: str
    origin_ns: int
    clock: Clock
    x: Array
    sigma: Array
    noise_nt: float
    terms: tuple[ModelTerm, ...] = ()
    notes: tuple[Note, ...] = ()
    spin: ModelSpin | None = None


# Writing


def text_of(model: PhysicsModel) -> str:
    """The file's content; ``parse_model`` gives every number back to the last bit."""
    lines = [
        "# What a recording was found to hold beyond its simulation, as numbers.  docs/physics-file.md",
        f"version = {VERSION}",
        "",
        "[recording]",
        f"name = {_text(model.recording)}",
        f"origin_ns = {model.origin_ns}",
        f"clock = {_text(model.clock)}",
        "",
        "[errors]  # D11 D22 D33 D12 D13 D23",
        f"bias_nt = {_numbers(model.x[BIAS])}",
        f"D = {_numbers(model.x[D_ALL])}",
        f"bias_sigma_nt = {_numbers(model.sigma[BIAS])}",
        f"D_sigma = {_numbers(model.sigma[D_ALL])}",
        f"noise_nt = {_numbers(np.float64(model.noise_nt))}",
    ]
    if model.spin is not None:
        lines += ["", "[spin]", f"axis_body = {_numbers(np.array(model.spin.axis_body))}"]
        lines += [f"axis_eci = {_numbers(np.array(model.spin.axis_eci))}"]
        lines += [f"rate_rad_s = {_numbers(np.float64(model.spin.rate_rad_s))}"]
    units = {effect.name: effect.units for effect in catalogue()}
    for term in model.terms:
        lines += ["", "[[effect]]", f"name = {_text(term.effect)}", f"driver = {_text(term.driver)}"]
        lines += [f"variant = {_text(term.variant)}"] if term.variant else []
        lines += _table("effect.amplitudes", term.amplitudes, units[term.effect])
        lines += _table("effect.sigma", term.sigma, {})
        lines += _table("effect.nonlinear", term.nonlinear, units[term.effect])
        lines += _table("effect.constants", term.constants, {})
    for note in model.notes:
        lines += ["", "[[note]]", f"effect = {_text(note.effect)}", f"says = {_text(note.says)}"]
        lines += _table("note.values", note.values, units.get(note.effect, {}))
    return "\n".join(lines) + "\n"


def _table(name: str, values: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    if not values:
        return []
    rows = [f"{key} = {_numbers(np.asarray(v))}{_comment(units.get(key, '1'))}" for key, v in values.items()]
    return [f"[{name}]", *rows]


def _comment(unit: str) -> str:
    return "" if unit == "1" else f"  # {unit}"


def _text(value: str) -> str:
    """A TOML basic string: JSON's escapes are TOML's, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _numbers(values: Any) -> str:
    if np.ndim(values) == 0:
        return repr(float(values))
    return f"[{', '.join(_numbers(part) for part in values)}]"


# Reading


def read_model(path: Path) -> PhysicsModel:
    """Read a file; raises ModelError with every fault: file, field, value, what is accepted."""
    return _model(open_toml(path, ModelError))


def parse_model(raw: bytes, name: str = "physics.toml") -> PhysicsModel:
    """The same of a file's content."""
    return _model(parse_toml(raw, name, name, ModelError))


def _model(top: Table) -> PhysicsModel:
    if top.number("version", required=True) not in (None, float(VERSION)):
        top.refuse("version", top.content["version"], f"{VERSION} is accepted")
    recording = top.table("recording", required=True) or Table({}, top.file, "recording", [])
    errors = top.table("errors", required=True) or Table({}, top.file, "errors", [])
    terms = top.tables("effect")
    if len(terms) > MOST_EFFECTS:
        top.refuse("effect", len(terms), f"at most {MOST_EFFECTS} tables [[effect]] are accepted")
    x, sigma, noise_nt = _errors(errors)
    model = PhysicsModel(
        recording=recording.text("name", "", accepted="the recording's name"),
        origin_ns=_origin(recording),
        clock=recording.choice("clock", Clock),
        x=x,
        sigma=sigma,
        noise_nt=noise_nt,
        terms=tuple(_term(table) for table in terms[:MOST_EFFECTS]),
        notes=tuple(_note(table) for table in top.tables("note")),
        spin=_spin(top.table("spin")),
    )
    recording.finish()
    top.finish()
    if top.faults:
        raise ModelError(top.faults)
    return model


def _origin(table: Table) -> int:
    value = table.content.get("origin_ns")
    table.has("origin_ns")
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 1 << 63:
        table.refuse("origin_ns", "missing" if value is None else value, "a whole number of nanoseconds is accepted")
        return 0
    return value


def _errors(table: Table) -> tuple[Array, Array, float]:
    """Nine errors, their sigma and the noise."""
    bias = table.numbers("bias_nt", 3, required=True) or (0.0,) * 3
    d = table.numbers("D", 6, required=True) or (0.0,) * 6
    sigma = [*(table.numbers("bias_sigma_nt", 3) or (0.0,) * 3), *(table.numbers("D_sigma", 6) or (0.0,) * 6)]
    x = np.array([*bias, *d])
    noise_nt = table.real("noise_nt", 0.0, minimum=0.0, maximum=1e6)
    if np.abs(x[BIAS]).max() > 1e6:
        table.refuse("bias_nt", list(bias), "numbers from -1e6 to 1e6 are accepted")
    if not np.abs(x[D_ALL]).max() < 1e3 or np.linalg.eigvalsh(np.eye(3) + d_matrix(x))[0] < 0.1:
        table.refuse("D", list(d), "I + D with eigenvalues above 0.1 is accepted")
        x = np.zeros(STATE_SIZE)
    table.finish()
    return x, np.array(sigma), noise_nt


def _spin(table: Table | None) -> ModelSpin | None:
    if table is None:
        return None
    axes = []
    for key in ("axis_body", "axis_eci"):
        axis = table.numbers(key, 3, required=True) or (0.0, 0.0, 1.0)
        if abs(math.hypot(*axis) - 1.0) > _UNIT:
            table.refuse(key, list(axis), "a vector of length 1 is accepted")
        axes.append((axis[0], axis[1], axis[2]))
    rate = table.number("rate_rad_s", required=True, minimum=-320.0, maximum=320.0) or 0.0
    table.finish()
    return ModelSpin(axes[0], axes[1], rate)


def _effect(table: Table, key: str) -> Effect | None:
    known = {effect.name: effect for effect in catalogue()}
    name = table.text(key, accepted="the name of an effect of the catalogue")
    if name in known:
        return known[name]
    if isinstance(table.content.get(key), str):
        table.refuse(key, name, nearest(name, known))
    return None


def _term(table: Table) -> ModelTerm:
    effect = _effect(table, "name")
    driver = table.text("driver", "none")
    if not _DRIVER.fullmatch(driver):
        table.refuse("driver", driver, '"none", "channel:NAME" or "inferred:NAME" is accepted')
    known = None if effect is None else effect.units
    amplitudes = _arrays(table, "amplitudes", known)
    if not amplitudes and not table.faults:
        table.refuse("amplitudes", "missing", "required: a table [effect.amplitudes] with at least one block")
    term = ModelTerm(
        effect="" if effect is None else effect.name,
        driver=driver,
        variant=table.text("variant", ""),
        amplitudes=amplitudes,
        sigma=_arrays(table, "sigma", dict.fromkeys(amplitudes, "")),
        nonlinear=_plain(table, "nonlinear", known),
        constants=_plain(table, "constants", None),
    )
    table.finish()
    return term


def _note(table: Table) -> Note:
    effect = _effect(table, "effect")
    note = Note("" if effect is None else effect.name, table.text("says", ""), _arrays(table, "values", None))
    table.finish()
    return note


def _plain(table: Table, key: str, known: Mapping[str, str] | None) -> dict[str, float]:
    found = _arrays(table, key, known)
    for name, value in found.items():
        if value.ndim:
            table.refuse(f"{key}.{name}", value.tolist(), "one finite number is accepted")
    return {name: float(value) for name, value in found.items() if value.ndim == 0}


def _arrays(table: Table, key: str, known: Mapping[str, str] | None) -> dict[str, Array]:
    """The named numbers and arrays of a sub-table; names are checked where ``known`` are given."""
    inner = table.table(key)
    if inner is None:
        return {}
    found = {}
    for name in inner.keys():  # noqa: SIM118 - a Table is no mapping
        inner.has(name)
        value = inner.content[name]
        array = _array(value)
        if known is not None and name not in known:
            inner.refuse(name, value, f"unknown name; {nearest(name, known)}")
        elif known is None and not _CONSTANT.fullmatch(name):
            inner.refuse(name, value, "a name of a-z 0-9 _ is accepted")
        elif array is None:
            inner.refuse(name, value, f"a finite number or an array of at most {_MOST_NUMBERS} of them is accepted")
        else:
            found[name] = array
    return found


def _array(value: object) -> Array | None:
    """A finite number, a list of them, or a list of equally long lists; None for anything else."""
    rows = value if isinstance(value, list) else [value]
    flat = [number for row in rows for number in (row if isinstance(row, list) else [row])]
    if (
        not flat
        or len(flat) > _MOST_NUMBERS
        or any(isinstance(n, bool) or not isinstance(n, int | float) for n in flat)
    ):
        return None
    if len({len(row) if isinstance(row, list) else -1 for row in rows}) > 1:
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except OverflowError:
        return None
    return array if np.isfinite(array).all() else None
