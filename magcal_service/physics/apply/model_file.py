"""``physics.toml``: what a diagnosis has found, as a model that daemon and simulator apply.  docs/physics-file.md

``text_of`` writes a model, ``read_model`` and ``parse_model`` read it by the declarations of ``physics_model``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.base.typed_toml import Table, TomlKind, open_toml, parse_toml, refuse_another
from magcal_service.base.typed_toml.record import read_record
from magcal_service.model import BIAS, D_ALL
from magcal_service.physics.apply.accepted import check_forms
from magcal_service.physics.apply.empirical import Empirical
from magcal_service.physics.apply.physics_model import (
    MOST_EFFECTS,
    VERSION,
    ModelError,
    ModelSections,
    ModelSpin,
    ModelTerm,
    Note,
    PhysicsModel,
)
from magcal_service.physics.catalogue import catalogue, held_at
from magcal_service.physics.drivers.computed import driver_unit
from magcal_service.physics.held import held_in_words

__all__ = [
    "MOST_EFFECTS",
    "VERSION",
    "Empirical",
    "ModelError",
    "ModelSpin",
    "ModelTerm",
    "Note",
    "PhysicsModel",
    "parse_model",
    "read_model",
    "text_of",
]


def read_model(path: Path) -> PhysicsModel:
    """Read a file; raises ModelError with every fault: file, field, value, what is accepted."""
    return _model(open_toml(path, ModelError))


def parse_model(raw: bytes, name: str = "physics.toml") -> PhysicsModel:
    """Read the content ``raw`` of a file called ``name``; raises as ``read_model``."""
    return _model(parse_toml(raw, name, name, ModelError))


def _model(top: Table) -> PhysicsModel:
    refuse_another(top, TomlKind.MODEL, ModelError)
    if top.number("version", required=True) not in (None, float(VERSION)):
        top.refuse("version", top.content["version"], f"{VERSION} is accepted")
    sections = read_record(top, ModelSections)
    if not top.faults:  # what is refused has no meaning to be held against a form
        check_forms(top.tables("effect"), sections.terms)
    if top.faults:
        raise ModelError(top.faults)
    return sections.model()


def text_of(model: PhysicsModel) -> str:
    """The file's content; ``parse_model`` gives every number back to the last bit."""
    lines = [
        "# What a recording was found to hold beyond nine errors, as numbers.  docs/physics-file.md",
        f"version = {VERSION}",
        "",
        "[recording]",
        f"name = {_text(model.recording)}",
        *([f"craft = {_text(model.craft)}"] if model.craft else []),
        f"origin_ns = {model.origin_ns}",
        f"clock = {_text(model.clock)}",
        *([f"doubts = {_text(model.doubts)}"] if model.doubts else []),
        "",
        f"[errors]  # D11 D22 D33 D12 D13 D23{_comment_of_held(model)}",
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
    for curve in model.empirical:
        lines += ["", "[[empirical]]", *_curve(curve)]
    for note in model.notes:
        lines += ["", "[[note]]", f"effect = {_text(note.effect)}", f"says = {_text(note.says)}"]
        lines += _table("note.values", note.values, units.get(note.effect, {}))
    return "\n".join(lines) + "\n"


def _curve(curve: Empirical) -> list[str]:
    lines = [f"driver = {_text(curve.driver)}", f"kind = {_text(curve.kind)}"]
    lines += [f"quantity = {_text(curve.quantity)}", f"column = {curve.column}"] if curve.quantity else []
    unit = _comment(driver_unit(curve.driver, curve.quantity))
    lines += [f"knots = {_numbers(curve.knots)}{unit}", f"values = {_numbers(curve.values)}{_comment(curve.kind.unit)}"]
    lines += [f"sigma = {_numbers(curve.sigma)}", f"range = {_numbers(np.array(curve.span))}"]
    return [*lines, "interpolating_only = true"]


def _table(name: str, values: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    if not values:
        return []
    rows = [f"{key} = {_numbers(np.asarray(v))}{_comment(units.get(key, '1'))}" for key, v in values.items()]
    return [f"[{name}]", *rows]


def _comment_of_held(model: PhysicsModel) -> str:
    """At which values of the effects' drivers the errors hold, without what ends a comment in a channel's name."""
    held = held_in_words(held_at(model.terms))
    return f"; at {''.join(one if one.isprintable() else '?' for one in held)}" if held else ""


def _comment(unit: str) -> str:
    return "" if unit == "1" else f"  # {unit}"


def _text(value: str) -> str:
    """A TOML basic string: JSON's escapes are TOML's, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _numbers(values: Any) -> str:
    if np.ndim(values) == 0:
        return repr(float(values))
    return f"[{', '.join(_numbers(part) for part in values)}]"
