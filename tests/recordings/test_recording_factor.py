"""Cells in a unit that has no name here: ``factor`` beside a unit that has one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording

LOG = ("t,x,y,z,f,lat,lon,alt,i", "0,1,2,3,4,10,20,200,7", "1,2,3,4,5,10,20,200,8")


def read(folder: Path, magnetometer: str = "factor = 60.0", channel: str = "factor = 0.1") -> Recording:
    """In counts of 60 nT, a reference in gamma of old (1 nT), heights in nautical miles, currents in dA."""
    (folder / "log.csv").write_text("\n".join(LOG))
    (folder / "RECORDING.toml").write_text(
        'version = 1\n[samples]\nfile = "log.csv"\n[time]\ncolumn = "t"\nformat = "elapsed_s"\n'
        f'[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n{magnetometer}\n'
        '[reference]\nmagnitude = "f"\nunit = "uT"\nfactor = 10\n'
        '[position]\ncolumns = ["lat", "lon"]\naltitude = { column = "alt", unit = "km", factor = 1.852 }\n'
        f'[channels]\ncoil = {{ column = "i", unit = "A", {channel} }}\n'
    )
    return read_recording(folder / "RECORDING.toml")


def test_cells_are_multiplied_into_the_unit_that_is_named(tmp_path: Path) -> None:
    recording = read(tmp_path)
    np.testing.assert_allclose(recording.field_body_nt[0], [60.0, 120.0, 180.0])
    np.testing.assert_allclose(recording.reference.magnitude_nt, [40e3, 50e3])
    np.testing.assert_allclose(recording.channels["coil"].values[:, 0], [0.7, 0.8])
    assert recording.position is not None
    height_km = np.linalg.norm(recording.position.km[0]) - 6378.137
    assert height_km == pytest.approx(200 * 1.852, abs=1.0)  # of the ellipsoid, 10 degrees from the equator


@pytest.mark.parametrize("factor", ["0", "-1.0", "nan", '"1852 m"'])
def test_a_factor_that_is_none_is_refused(factor: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"magnetometer\.factor: .* is refused"):
        read(tmp_path, magnetometer=f"factor = {factor}")


def test_a_unit_without_a_name_is_refused_with_the_way_on(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"'dA' is refused; .*known: %, .*; of another one give factor"):
        read(tmp_path, channel='unit = "dA"'.replace("unit", 'factor = 1.0 }\nother = { column = "i", unit'))
