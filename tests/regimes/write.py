"""A case as a folder that the product reads, and the answers beside, never inside."""

from __future__ import annotations

import json
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from tests.regimes.case import Case, rows
from tests.regimes.orbit import Floats, geodetic, sidereal_angle, turned_about_z

ANSWERS = "answers.json"


def write_case(case: Case, folder: Path) -> Path:
    """Write ``recording.csv`` and ``recording.toml`` into a folder, which is made; the descriptor's path."""
    folder.mkdir(parents=True, exist_ok=True)
    columns: list[tuple[str, Floats, int]] = [("t", case.world.t, 3)]
    lines = ["version = 1", "[samples]", 'file = "recording.csv"', "[time]", 'column = "t"', 'format = "elapsed_s"']
    lines.append(f'start = "{_utc(case.world.start_unix_s)}"')
    lines += _magnetometer(case, columns) + _reference(case, columns) + _position(case, columns)
    if case.world.spin is not None:
        axis, rate = case.world.spin
        lines += ["[spin]", f'axis = "{"xyz"[int(np.argmax(axis))]}"', f"rate_rpm = {rate:.6f}"]
    lines += _telemetry(case, columns)
    table = rows(case, np.column_stack([values for _, values, _ in columns]))
    header = ",".join(name for name, _, _ in columns)
    formats = [f"%.{decimals}f" for _, _, decimals in columns]
    np.savetxt(folder / "recording.csv", table, fmt=formats, delimiter=",", header=header, comments="")
    path = folder / "recording.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_answers(answers: dict[str, Any], folder: Path) -> Path:
    """Write the answers of all cases, by folder, beside the folders."""
    path = folder / ANSWERS
    path.write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")
    return path


def _utc(unix_s: float) -> str:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=unix_s)).strftime("%Y-%m-%dT%H:%M:%SZ")


def _magnetometer(case: Case, columns: list[tuple[str, Floats, int]]) -> list[str]:
    names = _add(columns, ("bx", "by", "bz"), case.samples, 4)
    lines = ["[magnetometer]", f"columns = {names}", 'unit = "nT"']
    return [*lines, f"noise_nt = {case.world.noise_nt}"] if case.states_noise else lines


def _reference(case: Case, columns: list[tuple[str, Floats, int]]) -> list[str]:
    lines, form = ["[reference]"], case.reference_form
    if form == "igrf":
        return [*lines, 'model = "igrf"']
    if form == "room":
        return [*lines, f"constant = {float(np.linalg.norm(case.reference[0])):.3f}", 'unit = "nT"']
    if form == "magnitude":
        _add(columns, ("f",), np.linalg.norm(case.reference, axis=1)[:, None], 3)
        return [*lines, 'magnitude = "f"', 'unit = "nT"']
    vector = case.reference if form == "eci" else turned_about_z(case.reference, _angle(case))
    return [*lines, f"columns = {_add(columns, ('hx', 'hy', 'hz'), vector, 3)}", 'unit = "nT"', f'frame = "{form}"']


def _position(case: Case, columns: list[tuple[str, Floats, int]]) -> list[str]:
    place = case.world.position_km
    if place is None:
        return []
    lines = ["[position]"]
    if case.reference_form == "igrf":
        latitude, longitude, height = geodetic(turned_about_z(place, _angle(case))).T
        _add(columns, ("lat", "lon"), np.stack([latitude, longitude], axis=1), 7)
        _add(columns, ("alt",), height[:, None], 4)
        return [*lines, 'columns = ["lat", "lon"]', 'altitude = { column = "alt", unit = "km" }']
    return [*lines, f"columns = {_add(columns, ('px', 'py', 'pz'), place, 4)}", 'unit = "km"', 'frame = "eci"']


def _telemetry(case: Case, columns: list[tuple[str, Floats, int]]) -> list[str]:
    lines = ["[channels]"]
    for channel in case.channels:
        width = channel.values.shape[1]
        names = [channel.name] if width == 1 else [f"{channel.name}_{k}" for k in range(width)]
        listed = _add(columns, names, channel.values, channel.decimals)
        if channel.name == "attitude":
            start = "ned" if case.world.regime.on_ground else "eci"
            lines.append(f'attitude = {{ columns = {listed}, order = "wxyz", from = "{start}", to = "body" }}')
        elif width == 1:
            lines.append(f'{channel.name} = {{ column = "{channel.name}", unit = "{channel.unit}" }}')
        else:
            lines.append(f'{channel.name} = {{ columns = {listed}, unit = "{channel.unit}" }}')
    return lines


def _angle(case: Case) -> Floats:
    return sidereal_angle(case.world.start_unix_s + case.world.t)


def _add(columns: list[tuple[str, Floats, int]], names: Iterable[str], values: Floats, decimals: int) -> str:
    """Add columns of values (n, k); their names as TOML has a list."""
    listed = list(names)
    columns.extend((name, values[:, k], decimals) for k, name in enumerate(listed))
    return json.dumps(listed)
