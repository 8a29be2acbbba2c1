"""The board's IGRF-14 is the daemon's within 0.002 nT in double and 0.1 nT in single precision."""

import runpy
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from magcal_service.earth.geomagnetic import igrf_ecef_nt

KIT = Path(__file__).parents[2] / "deploy" / "firmware"
CC = shutil.which("cc")
STRICT = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
MAIN = """
#include <stdio.h>
#include "magcal_igrf.h"
int main(void) {
    double year, at[3];
    while (scanf("%lf %lf %lf %lf", &year, at, at + 1, at + 2) == 4) {
        const magcal_real place[3] = {(magcal_real)at[0], (magcal_real)at[1], (magcal_real)at[2]};
        magcal_real field[3] = {0, 0, 0};
        const int known = magcal_igrf((magcal_real)year, place, field);
        printf("%d %.9g %.9g %.9g\\n", known, (double)field[0], (double)field[1], (double)field[2]);
    }
    return 0;
}
"""


def test_the_header_is_generated_from_the_daemons_coefficients() -> None:
    assert (KIT / "magcal_igrf.h").read_text() == runpy.run_path(str(KIT / "make_igrf_header.py"))["header"]()


@pytest.mark.skipif(CC is None, reason="no C compiler (cc) here")
@pytest.mark.parametrize(
    ("flags", "within_nt"), [([], 0.002), (["-DMAGCAL_SINGLE_PRECISION"], 0.1)], ids=["double", "float"]
)
def test_the_field_is_the_daemons(tmp_path: Path, flags: list[str], within_nt: float) -> None:
    (tmp_path / "main.c").write_text(MAIN)
    program = tmp_path / "field"
    subprocess.run(
        [str(CC), *STRICT, *flags, f"-I{KIT}", str(tmp_path / "main.c"), "-o", str(program), "-lm"], check=True
    )
    rng = np.random.default_rng(1)
    ways = rng.normal(size=(500, 3))
    places = ways / np.linalg.norm(ways, axis=1)[:, None] * rng.uniform(6371.0, 12000.0, (500, 1))
    places[:2] = [[0.0, 0.0, 6771.0], [0.0, 0.0, -6500.0]]
    first, last = (int(np.datetime64(f"{year}-01-01", "ns").astype(np.int64)) for year in (2025, 2030))
    parts = rng.uniform(0.0, 1.0, 500)
    lines = [f"{2025 + 5 * part:.9f} {x!r} {y!r} {z!r}" for part, (x, y, z) in zip(parts, places.tolist(), strict=True)]
    refused = ["2024.9 7000 0 0", "2030.1 7000 0 0", "2026 7 0 0", "2026 nan 0 0", "2026 61000 0 0"]
    run = subprocess.run([str(program)], input="\n".join(lines + refused), capture_output=True, text=True, check=True)
    rows = np.array([[float(one) for one in line.split()] for line in run.stdout.splitlines()])
    np.testing.assert_array_equal(rows[:, 0], [1.0] * 500 + [0.0] * len(refused))
    expected = igrf_ecef_nt((first + parts * (last - first)).astype(np.int64), places)
    assert np.abs(rows[:500, 1:] - expected).max() < within_nt
