"""Small logs for the tests: a descriptor that is right, and a way to change one thing in it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

HEADER = "time,mx,my,mz,hx,hy,hz,f,lat,lon,alt,x,y,z,temp,q0,q1,q2,q3"
ROW = "{time},{mx},-20.5,3e1,11000,-22000,33000,41200.5,-10.5,30.25,450,6800,100,-200,21.5,1,0,0,0"

TIME = '[time]\ncolumn = "time"\nformat = "unix_s"\n'
MAGNETOMETER = '[magnetometer]\ncolumns = ["mx", "my", "mz"]\nunit = "uT"\n'
REFERENCE = '[reference]\ncolumns = ["hx", "hy", "hz"]\nunit = "nT"\nframe = "eci"\n'


def descriptor(
    *extra: str, time: str = TIME, magnetometer: str = MAGNETOMETER, reference: str = REFERENCE, file: str = "log.csv"
) -> str:
    """A descriptor; ``extra`` are further sections."""
    return "\n".join(["version = 1", f'[samples]\nfile = "{file}"', time, magnetometer, reference, *extra])


def described(
    file: str,
    *,
    time: str,
    field: Sequence[str],
    noise_nt: float,
    reference: str | Sequence[str],
    channels: Mapping[str, str],
    spin_axis: Sequence[float] | None = None,
) -> str:
    """The descriptor of a log in nT.

    Parameters
    ----------
    time: keys of its section beside the column ``t``.
    field: columns of the sensor, with noise of ``noise_nt``.
    reference: a column of magnitudes, or three of a vector in space (ECI).
    channels: columns of temperatures [degC] by name.
    spin_axis: where the craft turns at 7.5 rpm.
    """
    magnetometer = f'[magnetometer]\ncolumns = {json.dumps(field)}\nunit = "nT"\nnoise_nt = {noise_nt}\n'
    given = f'magnitude = "{reference}"' if isinstance(reference, str) else f"columns = {json.dumps(reference)}"
    frame = "" if isinstance(reference, str) else 'frame = "eci"\n'
    spin = [] if spin_axis is None else [f"[spin]\naxis = {json.dumps(spin_axis)}\nrate_rpm = 7.5\n"]
    listed = "".join(f'{name} = {{ column = "{column}", unit = "degC" }}\n' for name, column in channels.items())
    return descriptor(
        *spin,
        f"[channels]\n{listed}",
        time=f'[time]\ncolumn = "t"\n{time}\n',
        magnetometer=magnetometer,
        reference=f'[reference]\n{given}\nunit = "nT"\n{frame}',
        file=file,
    )


def row(time: object = "1700000000.0", mx: object = "10.0", **changes: str) -> str:
    """One row of the log with some cells changed."""
    cells = ROW.format(time=time, mx=mx).split(",")
    for name, value in changes.items():
        cells[HEADER.split(",").index(name)] = value
    return ",".join(cells)


def write_log(folder: Path, text: str | None = None, rows: list[str] | None = None, header: str = HEADER) -> Path:
    """Write the log and its descriptor; the descriptor's path is returned."""
    rows = [row(1700000000 + second) for second in range(3)] if rows is None else rows
    (folder / "log.csv").write_text("\n".join([header, *rows, ""]), newline="")
    path = folder / "log.toml"
    path.write_text(descriptor() if text is None else text)
    return path
