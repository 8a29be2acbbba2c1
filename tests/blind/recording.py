"""A case as a folder that ``magcal`` reads: samples.csv and RECORDING.toml, and no word of the answer."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.blind.case import Answer, Case
from tests.blind.cause import Telemetry
from tests.blind.vectors import Floats


def write_case(case: Case, folder: Path | str) -> Path:
    """Write ``samples.csv`` and ``RECORDING.toml`` into a folder, made where absent; returns the descriptor's path.

    Same case, same bytes.  Columns, channel names and descriptor are the same for a channel that drives an effect and
    for one that does not.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    header, columns = _columns(case)
    rows = zip(*columns, strict=True)
    (folder / "samples.csv").write_text("\n".join([",".join(header), *map(",".join, rows), ""]))
    descriptor = folder / "RECORDING.toml"
    descriptor.write_text(_descriptor(case))
    return descriptor


def seal_answer(answer: Answer, file: Path | str, recording: Path | str) -> None:
    """Write an answer as JSON; ValueError where the file would lie within the recording's folder."""
    file, folder = Path(file).resolve(), Path(recording).resolve()
    folder = folder.parent if folder.is_file() else folder
    if file.is_relative_to(folder):
        raise ValueError(f"{file}: an answer outside of {folder} is accepted")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(answer.to_json())


def _cells(values: Floats, decimals: int) -> list[str]:
    """Numbers (n,) as text; empty where there is none."""
    form = f"%.{decimals}f"
    return ["" if value != value else form % value for value in values.tolist()]


def _columns(case: Case) -> tuple[list[str], list[list[str]]]:
    """Names and cells of the log's columns."""
    parts: list[tuple[Iterable[str], Floats, int | tuple[int, ...]]] = [
        (("time",), (case.start_unix_s or 0.0) + case.time_s, 3),
        (("bx", "by", "bz"), case.field_nt, 2),
        (("hx", "hy", "hz") if case.reference_frame else ("h",), case.reference_nt, 2),
    ]
    if case.position is not None:
        geodetic = case.position_form == "geodetic"
        parts.append(
            (("lat", "lon", "alt") if geodetic else ("x", "y", "z"), case.position, (5, 5, 3) if geodetic else 3)
        )
    parts += [(channel.columns, channel.values, channel.decimals) for channel in case.channels]
    header: list[str] = []
    columns: list[list[str]] = []
    for names, values, decimals in parts:
        header += names
        wide = np.asarray(values).reshape(len(values), -1)
        places = decimals if isinstance(decimals, tuple) else (decimals,) * wide.shape[1]
        columns += [_cells(column, place) for column, place in zip(wide.T, places, strict=True)]
    return header, columns


def _descriptor(case: Case) -> str:
    lines = ["version = 1", "[samples]", 'file = "samples.csv"', "[time]", 'column = "time"']
    lines.append('format = "unix_s"' if case.start_unix_s is not None else 'format = "elapsed_s"')
    lines += ["[magnetometer]", 'columns = ["bx", "by", "bz"]', 'unit = "nT"']
    if case.stated_noise_nt is not None:
        lines.append(f"noise_nt = {case.stated_noise_nt}")
    lines.append("[reference]")
    if case.reference_frame is None:
        lines += ['magnitude = "h"', 'unit = "nT"']
    else:
        lines += ['columns = ["hx", "hy", "hz"]', 'unit = "nT"', f'frame = "{case.reference_frame}"']
    if case.position_form == "geodetic":
        lines += ["[position]", 'columns = ["lat", "lon"]', 'altitude = { column = "alt", unit = "km" }']
    elif case.position_form == "ecef":
        lines += ["[position]", 'columns = ["x", "y", "z"]', 'unit = "km"', 'frame = "ecef"']
    if case.spin_axis is not None:
        lines += ["[spin]", f"axis = {json.dumps(case.spin_axis)}"]
        if case.spin_rpm is not None:
            lines.append(f"rate_rpm = {case.spin_rpm}")
    if case.channels:
        lines += ["[channels]", *map(_channel, case.channels)]
    return "\n".join([*lines, ""])


def _channel(channel: Telemetry) -> str:
    columns = channel.columns
    keys = [f'column = "{columns[0]}"' if len(columns) == 1 else f"columns = {json.dumps(columns)}"]
    if channel.unit:
        keys.append(f'unit = "{channel.unit}"')
    if channel.frame:
        keys.append(f'frame = "{channel.frame}"')
    return f"{channel.name} = {{ {', '.join(keys)} }}"
