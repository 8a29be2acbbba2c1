"""Logs without a defect, of many kinds, and a way to spoil one thing in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.recordings.inspect.finding import Code, Finding
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.timestamps import ns_to_iso8601

Array = NDArray[np.float64]

START_NS = 1_740_787_200_000_000_000  # 2025-03-01
MU_KM3_S2 = 398_600.4418


@dataclass(frozen=True)
class Kind:
    """What varies from one clean log to the next."""

    rows: int = 1800
    step_s: float = 1.0
    jitter: float = 0.0
    height_km: float = 500.0
    inclination_deg: float = 97.4
    rates_deg_s: tuple[float, float] = (1.7, 0.9)
    noise_nt: float = 50.0
    noise_stated: bool = True
    resolution_nt: float = 0.0
    bias_nt: tuple[float, float, float] = (5000.0, -3000.0, 4000.0)
    D: tuple[float, ...] = (0.05, -0.04, 0.08, 0.02, -0.03, 0.01)
    unit: str = "nT"
    time_format: str = "unix_s"
    reference: str = "magnitude"
    place: str = "geodetic"
    place_digits: int = 6
    channels: bool = True


def kind_of(seed: int) -> Kind:
    """One of very many kinds of clean log, always the same for the same seed."""
    draw = np.random.default_rng(seed)

    def one(*values: object) -> object:
        return values[int(draw.integers(len(values)))]

    step_s = float(one(0.1, 0.25, 1.0, 1.0, 2.0, 10.0))  # type: ignore[arg-type]
    return Kind(
        rows=int(draw.integers(600, 4000)),
        step_s=step_s,
        jitter=float(one(0.0, 0.05, 0.2)),  # type: ignore[arg-type]
        height_km=float(draw.uniform(350.0, 1400.0)),
        inclination_deg=float(draw.uniform(20.0, 100.0)),
        rates_deg_s=(float(draw.uniform(-6.0, 6.0)) / step_s, float(draw.uniform(-1.0, 1.0))),
        noise_nt=float(np.exp(draw.uniform(np.log(3.0), np.log(600.0)))),
        resolution_nt=float(one(0.0, 1.0, 13.0, 76.9, 150.0)),  # type: ignore[arg-type]
        bias_nt=tuple(draw.uniform(-20_000.0, 20_000.0, 3).tolist()),
        D=tuple(draw.uniform(-0.08, 0.08, 6).tolist()),
        unit=str(one("nT", "uT", "mG")),
        time_format=str(one("unix_s", "unix_ms", "iso8601", "elapsed_s")),
        reference=str(one("magnitude", "vector")),
        place=str(one("geodetic", "geodetic", "eci", "none")),
        place_digits=int(one(2, 4, 6)),  # type: ignore[call-overload]
        channels=bool(draw.integers(2)),
    )


@dataclass(frozen=True)
class CleanLog:
    """A log as columns.

    Parameters
    ----------
    columns: numbers (n,) by name; cells are written by ``formats``, with nine digits where there is none.
    time_ns: (n,) times [ns]; ``time_cells`` go before them.
    """

    kind: Kind
    columns: dict[str, Array]
    time_ns: NDArray[np.int64]
    time_cells: list[str] | None = None
    descriptor: dict[str, str] = field(default_factory=dict)

    def changed(self, **columns: Array) -> CleanLog:
        """The same log with other columns."""
        return replace(self, columns=self.columns | columns)

    def spoiled(self, names: str, change: Callable[[Array], Array]) -> CleanLog:
        """The same log with some of its columns changed."""
        return self.changed(**{name: change(self.columns[name].copy()) for name in names.split()})

    def at(self, time_ns: NDArray[np.int64], cells: list[str] | None = None) -> CleanLog:
        """The same log at other times."""
        return replace(self, time_ns=time_ns, time_cells=cells)

    def take(self, rows: NDArray[np.intp]) -> CleanLog:
        """Some of its rows."""
        return replace(self, columns={k: v[rows] for k, v in self.columns.items()}, time_ns=self.time_ns[rows])

    def described(self, **sections: str) -> CleanLog:
        """The same log with other sections of its descriptor (``time``, ``reference``, ...)."""
        return replace(self, descriptor=self.descriptor | sections)

    def write(self, folder: Path) -> Path:
        """Write log and descriptor; the descriptor's path."""
        folder.mkdir(parents=True, exist_ok=True)
        cells = [self._times(), *([f"{value:.10g}" for value in column.tolist()] for column in self.columns.values())]
        lines = [",".join(["t", *self.columns]), *map(",".join, zip(*cells, strict=True)), ""]
        (folder / "log.csv").write_text("\n".join(lines))
        path = folder / "RECORDING.toml"
        path.write_text("\n".join(['version = 1\n[samples]\nfile = "log.csv"', *self.descriptor.values(), ""]))
        return path

    def _times(self) -> list[str]:
        if self.time_cells is not None:
            return self.time_cells
        form = self.kind.time_format
        if form == "iso8601":
            return [ns_to_iso8601(value) for value in self.time_ns.tolist()]
        offset = START_NS if form == "elapsed_s" else 0
        scale, digits = (1e6, 3) if form == "unix_ms" else (1e9, 6)
        return [f"{(value - offset) / scale:.{digits}f}" for value in self.time_ns.tolist()]

    def inspected(self, folder: Path) -> Inspection:
        """What is found on it."""
        return inspect(read_recording(self.write(folder)))

    def found(self, folder: Path) -> Mapping[Code, Finding]:
        """Findings by code."""
        return {one.code: one for one in self.inspected(folder).findings}


def clean_log(kind: Kind = Kind(), seed: int = 0) -> CleanLog:
    """A tumbling craft on a circular orbit in a tilted dipole field."""
    draw = np.random.default_rng(seed)
    steps = kind.step_s * (1.0 + kind.jitter * draw.uniform(-0.5, 0.5, kind.rows))
    time_s = np.concatenate([[0.0], np.cumsum(steps)[:-1]]).round(3)
    time_ns = START_NS + np.rint(time_s * 1e9).astype(np.int64)
    place = _orbit(kind, time_s, draw)
    fixed = geomagnetic.ecef_from_eci(time_ns, place)
    field_eci = geomagnetic.eci_from_ecef(time_ns, _dipole(fixed))
    attitude, rate = _tumbling(kind, time_s, draw)
    body = np.einsum("nij,nj->ni", attitude, field_eci)
    d11, d22, d33, d12, d13, d23 = kind.D
    grown = np.eye(3) + np.array([[d11, d12, d13], [d12, d22, d23], [d13, d23, d33]])
    measured = np.linalg.solve(grown, (body + np.array(kind.bias_nt)).T).T
    measured += kind.noise_nt * draw.standard_normal(measured.shape)
    if kind.resolution_nt:
        measured = np.round(measured / kind.resolution_nt) * kind.resolution_nt
    factor = {"nT": 1.0, "uT": 1e3, "mG": 1e2}[kind.unit]
    columns = dict(zip(("mx", "my", "mz"), (measured / factor).T, strict=True))
    columns |= dict(zip(("hx", "hy", "hz"), field_eci.T, strict=True))
    columns["F"] = np.linalg.norm(field_eci, axis=1)
    latitude, longitude, height = geomagnetic.geodetic_from_ecef(fixed)
    columns |= {"lat": latitude.round(kind.place_digits), "lon": longitude.round(kind.place_digits), "alt": height}
    columns |= dict(zip("xyz", place.T, strict=True))
    columns |= dict(zip(("wx", "wy", "wz"), (rate + 1e-4 * draw.standard_normal(rate.shape)).T, strict=True))
    columns |= dict(zip(("q0", "q1", "q2", "q3"), _quaternions(attitude).T, strict=True))
    return CleanLog(kind, columns, time_ns, None, _descriptor(kind))


def _orbit(kind: Kind, time_s: Array, draw: np.random.Generator) -> Array:
    radius = 6371.0 + kind.height_km
    angle = draw.uniform(0.0, 2.0 * np.pi) + np.sqrt(MU_KM3_S2 / radius**3) * time_s
    tilt, node = np.radians(kind.inclination_deg), draw.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.cos(node), np.sin(node), 0.0])
    across = np.array([-np.sin(node) * np.cos(tilt), np.cos(node) * np.cos(tilt), np.sin(tilt)])
    return np.asarray(radius * (np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * across))


def _dipole(fixed_km: Array) -> Array:
    radius = np.linalg.norm(fixed_km, axis=1)[:, None]
    unit, moment = fixed_km / radius, np.array([0.05, -0.16, 0.985])
    return np.asarray(-30_000.0 * (6371.2 / radius) ** 3 * (3.0 * (unit @ moment)[:, None] * unit - moment))


def _turn(axis: Array, angle: Array) -> Array:
    """(n, 3, 3) that give a vector's components in axes turned about ``axis`` by angles (n,)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) - sin * cross + (1.0 - cos) * (cross @ cross))


def _tumbling(kind: Kind, time_s: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Body from inertial (n, 3, 3), and the rate (n, 3) [rad/s] in the body."""
    first, second = (vector / np.linalg.norm(vector) for vector in draw.standard_normal((2, 3)))
    fast, slow = np.radians(kind.rates_deg_s)
    own = _turn(first, fast * time_s)
    attitude = np.einsum("nij,njk->nik", own, _turn(second, slow * time_s))
    return attitude, fast * first + slow * np.einsum("nij,j->ni", own, second)


def _quaternions(matrices: Array) -> Array:
    """(n, 4), scalar first, of rotations that are not by half a turn."""
    w = 0.5 * np.sqrt(np.maximum(1.0 + np.trace(matrices, axis1=1, axis2=2), 1e-9))
    m = matrices
    x, y, z = (m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1])
    quaternion = np.stack([w, x / (4.0 * w), y / (4.0 * w), z / (4.0 * w)], axis=1)
    return np.asarray(quaternion / np.linalg.norm(quaternion, axis=1)[:, None])


_PLACES = {
    "geodetic": '[position]\ncolumns = ["lat", "lon"]\naltitude = { column = "alt", unit = "km" }',
    "eci": '[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "eci"',
    "none": "",
}
_REFERENCES = {
    "magnitude": '[reference]\nmagnitude = "F"\nunit = "nT"',
    "vector": '[reference]\ncolumns = ["hx", "hy", "hz"]\nunit = "nT"\nframe = "eci"',
    "igrf": '[reference]\nmodel = "igrf"',
}


def _descriptor(kind: Kind) -> dict[str, str]:
    noise = f"noise_nt = {kind.noise_nt}" if kind.noise_stated else ""
    start = '\nstart = "2025-03-01T00:00:00Z"' if kind.time_format == "elapsed_s" else ""
    channels = '[channels]\ngyro = { columns = ["wx", "wy", "wz"], unit = "rad/s" }\n'
    channels += 'attitude = { columns = ["q0", "q1", "q2", "q3"], order = "wxyz", from = "eci", to = "body" }'
    return {
        "time": f'[time]\ncolumn = "t"\nformat = "{kind.time_format}"{start}',
        "magnetometer": f'[magnetometer]\ncolumns = ["mx", "my", "mz"]\nunit = "{kind.unit}"\n{noise}',
        "reference": _REFERENCES[kind.reference],
        "position": _PLACES[kind.place],
        "channels": channels if kind.channels else "",
    }
