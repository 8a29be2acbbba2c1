"""Raw logs in the styles of eight makers, each of a simulated sensor whose field, times and place are known."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.earth.geomagnetic import ecef_from_geodetic, igrf_ecef_nt

FloatArray = npt.NDArray[np.float64]

START_S = 1751328000.0  # 2025-07-01T00:00:00Z
BIAS_NT = np.array([9000.0, -6000.0, 4000.0])
GROUND_NT = 49200.0
NOISE_NT = 60.0
GPS_EPOCH_S = 315964800.0
LEAP_S = 18.0


@dataclass(frozen=True)
class MakerLog:
    """A raw log and what it holds.

    Parameters
    ----------
    answers: what its describer has to be told; nobody can know it from the log.
    field_nt, time_s: (n, 3) and (n,) as the log holds them, Unix seconds or since its start.
    """

    path: Path
    answers: dict[str, str]
    field_nt: FloatArray
    time_s: FloatArray


def ground(rows: int = 600, seed: int = 1) -> FloatArray:
    """A board turned by hand in every direction: (rows, 3) [nT], bias and noise included."""
    rng = np.random.default_rng(seed)
    turns = np.linspace(0.0, 1.0, rows)
    azimuth = 2.0 * np.pi * (9.0 * turns + 0.2 * np.sin(11.0 * turns))
    height = np.clip(0.98 * np.sin(2.0 * np.pi * 2.3 * turns + 0.4), -1.0, 1.0)
    flat = np.sqrt(1.0 - height**2)
    direction = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
    return GROUND_NT * direction + BIAS_NT + NOISE_NT * rng.standard_normal((rows, 3))


@dataclass(frozen=True)
class Orbit:
    """A tumbling craft in a 500 km orbit, a row every 5 s."""

    time_s: FloatArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    field_nt: FloatArray
    magnitude_nt: FloatArray
    ecef_km: FloatArray


def orbit(rows: int = 1100, seed: int = 2) -> Orbit:
    """One orbit, with the field of IGRF turned into a tumbling body, bias and noise included."""
    rng = np.random.default_rng(seed)
    elapsed = 5.0 * np.arange(rows)
    along = 2.0 * np.pi * elapsed / 5677.0
    inclination = np.radians(70.0)
    latitude = np.degrees(np.arcsin(np.sin(inclination) * np.sin(along)))
    longitude = np.degrees(np.arctan2(np.cos(inclination) * np.sin(along), np.cos(along))) - 360.0 * elapsed / 86164.0
    longitude = (longitude + 40.0 + 180.0) % 360.0 - 180.0
    ecef_km = ecef_from_geodetic(latitude, longitude, np.full(rows, 500.0))
    time_s = START_S + elapsed
    field = igrf_ecef_nt((time_s * 1e9).astype(np.int64), ecef_km)
    a, b = 0.031 * elapsed, 0.0173 * elapsed
    turn_z = np.stack([np.cos(a), -np.sin(a), 0 * a, np.sin(a), np.cos(a), 0 * a, 0 * a, 0 * a, 1 + 0 * a], -1)
    turn_x = np.stack([1 + 0 * b, 0 * b, 0 * b, 0 * b, np.cos(b), -np.sin(b), 0 * b, np.sin(b), np.cos(b)], -1)
    body = np.einsum("nij,njk,nk->ni", turn_x.reshape(-1, 3, 3), turn_z.reshape(-1, 3, 3), field)
    measured = body + BIAS_NT + NOISE_NT * rng.standard_normal((rows, 3))
    return Orbit(time_s, latitude, longitude, measured, np.sqrt((field**2).sum(axis=1)), ecef_km)


def _write(path: Path, lines: list[str], end: str = "\n") -> Path:
    path.write_bytes((end.join(lines) + end).encode("utf-8"))
    return path


def phone(folder: Path) -> MakerLog:
    """A phone app: quoted names with brackets, the sensor's own length beside the axes."""
    field, time = ground(), 0.5 * np.arange(600)
    head = ",".join(
        f'"{name}"' for name in ("Time (s)", *(f"Magnetic field {a} (µT)" for a in "xyz"), "Absolute field (µT)")
    )
    rows = [
        f"{t:.5E},{x:.6E},{y:.6E},{z:.6E},{np.sqrt(x * x + y * y + z * z):.6E}"
        for t, (x, y, z) in zip(time, field / 1e3, strict=True)
    ]
    return MakerLog(_write(folder / "Raw Data.csv", [head, *rows]), {"reference": "49.2 uT"}, field, time)


def arduino(folder: Path) -> MakerLog:
    """A serial monitor's text: chatter of the program, tabs, milliseconds since power-on, CR LF."""
    field, time = ground(seed=3), 1.234 + 0.8 * np.arange(600)
    head = ["LIS3MDL test", "Found sensor at 0x1C", "", "millis\tmag_x [uT]\tmag_y [uT]\tmag_z [uT]\ttempC"]
    rows = [
        f"{t * 1e3:.0f}\t{x:.2f}\t{y:.2f}\t{z:.2f}\t24.{i % 10}"
        for i, (t, (x, y, z)) in enumerate(zip(time, field / 1e3, strict=True))
    ]
    path = _write(folder / "monitor.txt", [*head, *rows], "\r\n")
    return MakerLog(path, {"reference.constant": "49.2 uT"}, field, time)


def ardupilot(folder: Path) -> MakerLog:
    """An autopilot's MAG messages: whole milligauss, offsets beside them, microseconds since boot."""
    field, time = np.round(ground(seed=4) / 100.0) * 100.0, 61.5 + 1.0 * np.arange(600)
    head = "timestamp,TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"
    rows = [
        f"{START_S + t:.6f},{t * 1e6:.0f},0,{x:.0f},{y:.0f},{z:.0f},-90,60,-40,0,0,0,1,{t * 1e6 - 40:.0f}"
        for t, (x, y, z) in zip(time, field / 100.0, strict=True)
    ]
    return MakerLog(_write(folder / "MAG.csv", [head, *rows]), {"reference": "0.492 G"}, field, START_S + time)


def matlab(folder: Path) -> MakerLog:
    """A MATLAB export where commas are decimal signs: month names, semicolons, nanotesla, a reference's magnitude."""
    flight = orbit()
    head = "Zeit;Bx [nT];By [nT];Bz [nT];F_ref [nT];Temp [°C]"
    rows = []
    for t, (x, y, z), f in zip(flight.time_s, flight.field_nt, flight.magnitude_nt, strict=True):
        stamp = datetime.datetime.fromtimestamp(t, datetime.UTC).strftime("%d-%b-%Y %H:%M:%S")
        rows.append(f"{stamp};{x:.2f};{y:.2f};{z:.2f};{f:.2f};21,50".replace(".", ","))
    return MakerLog(_write(folder / "export.csv", [head, *rows]), {}, flight.field_nt, flight.time_s)


def gps_week(folder: Path) -> MakerLog:
    """Telemetry in GPS week and seconds, positions in ECEF metres, milligauss."""
    flight = orbit()
    head = "gps_week,tow_s,bx_mG,by_mG,bz_mG,ecef_x_m,ecef_y_m,ecef_z_m,i_bus_mA,gyro_x_dps,gyro_y_dps,gyro_z_dps"
    rows = []
    for t, (x, y, z), r in zip(flight.time_s, flight.field_nt / 100.0, flight.ecef_km * 1e3, strict=True):
        week, tow = divmod(t - GPS_EPOCH_S + LEAP_S, 604800.0)
        rows.append(f"{week:.0f},{tow:.3f},{x:.3f},{y:.3f},{z:.3f},{r[0]:.1f},{r[1]:.1f},{r[2]:.1f},212,0.1,-0.2,1.7")
    return MakerLog(_write(folder / "tlm_0042.csv", [head, *rows]), {}, flight.field_nt, flight.time_s)


def excel(folder: Path) -> MakerLog:
    """A spreadsheet saved as text: days since 1899-12-30, pipes, latitude, longitude, altitude without units."""
    flight = orbit()
    head = "Date/Time|Mag X|Mag Y|Mag Z|Latitude|Longitude|Altitude"
    rows = [
        f"{t / 86400.0 + 25569.0:.9f}|{x:.3f}|{y:.3f}|{z:.3f}|{lat:.5f}|{lon:.5f}|500.0"
        for t, (x, y, z), lat, lon in zip(
            flight.time_s, flight.field_nt / 1e3, flight.latitude_deg, flight.longitude_deg, strict=True
        )
    ]
    return MakerLog(_write(folder / "sheet.csv", [head, *rows]), {}, flight.field_nt, flight.time_s)


def headless(folder: Path) -> MakerLog:
    """Blanks between columns of a fixed width and no header: what each column is has to be answered."""
    field, time = ground(seed=7), 0.6 * np.arange(600)
    rows = [f"{t:9.3f} {x:10.4f} {y:10.4f} {z:10.4f}  1" for t, (x, y, z) in zip(time, field / 1e3, strict=True)]
    answers = {"time.column": "1", "magnetometer.columns": "2,3,4", "magnetometer.unit": "uT", "reference": "49.2 uT"}
    return MakerLog(_write(folder / "run7.dat", rows), answers, field, time)


def preamble(folder: Path) -> MakerLog:
    """A laboratory's logger: a commented preamble, a line of units under the names, comments between the rows."""
    flight = orbit()
    head = [
        "# Recorder 4.1",
        "# Serial: 0017, channel 3",
        "#",
        "Time;B_x;B_y;B_z;lat;lon;alt;T_sensor",
        "[UTC];[G];[G];[G];[deg];[deg];[km];[K]",
    ]
    rows = []
    for i, (t, (x, y, z), lat, lon) in enumerate(
        zip(flight.time_s, flight.field_nt / 1e5, flight.latitude_deg, flight.longitude_deg, strict=True)
    ):
        if i == 300:
            rows.append("# range changed")
        stamp = datetime.datetime.fromtimestamp(t, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")
        rows.append(f"{stamp};{x:.6f};{y:.6f};{z:.6f};{lat:.5f};{lon:.5f};500.0;293.4")
    return MakerLog(_write(folder / "lab.csv", [*head, *rows]), {}, flight.field_nt, flight.time_s)


MAKERS = (phone, arduino, ardupilot, matlab, gps_week, excel, headless, preamble)
