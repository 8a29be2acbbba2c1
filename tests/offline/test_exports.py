"""Each form of the nine numbers, read back as its target reads it, calibrates as the result does."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.model import Array, d_matrix
from magcal_service.offline.exports import FORMS
from magcal_service.offline.given import Given, read_given
from magcal_service.offline.result_head import SCHEMAS, schema
from tests.cli.cli_inputs import run

X = np.array([23_000.0, -4_100.0, 7_700.0, 0.05, -0.08, 0.02, 0.031, -0.017, 0.044])
FIELDS_NT = np.random.default_rng(5).uniform(-50_000.0, 50_000.0, (50, 3))
GCC = shutil.which("gcc")


def written(folder: Path, **changes: object) -> Path:
    """A result as calibrate writes it, cut to what matters."""
    d = d_matrix(X)
    content = {
        "schema": "magcal-calibration-1",
        "trusted": True,
        "reasons": [],
        "bias_nt": X[:3].tolist(),
        "D": d.tolist(),
        "covariance": np.diag(np.arange(1.0, 10.0)).tolist(),
        "residual_rms_nt": {"noise_floor": 100.0},
    }
    path = folder / "result.json"
    path.write_text(json.dumps({**content, **changes}))
    return path


@pytest.fixture
def given(tmp_path: Path) -> Given:
    return read_given(written(tmp_path))


def calibrated(given: Given) -> Array:
    """By equation (5), written out once more: (I + D) B - b."""
    d = np.array([[X[3], X[6], X[7]], [X[6], X[4], X[8]], [X[7], X[8], X[5]]])
    np.testing.assert_allclose(given.apply(FIELDS_NT), FIELDS_NT @ (np.eye(3) + d).T - X[:3], rtol=0.0, atol=1e-8)
    return given.apply(FIELDS_NT)


def exported(folder: Path, name: str, *more: str) -> str:
    done = run("export", written(folder), "--format", name, *more)
    assert done.code == 0, done
    return done.out


def parameters(text: str, separator: str) -> dict[str, float]:
    """As mavros reads both forms (``param.py``): cells by csv, # begins a comment, a value without a point is whole.

    An autopilot keeps them as 32-bit floats under names of at most 16 characters.
    """
    cells, at = (5, 2) if separator == "\t" else (2, 0)
    found = {}
    for row in csv.reader(text.splitlines(), delimiter=separator, quoting=csv.QUOTE_NONE):
        if row[0].startswith("#"):
            continue
        assert len(row) == cells
        name, value = row[at].strip(), row[at + 1]
        assert "." in value
        assert "e" not in value
        assert 0 < len(name) <= 16
        found[name] = float(np.float32(value))
    return found


def symmetric(diagonal: list[float], beside: list[float]) -> Array:
    """Of xx, yy, zz and xy, xz, yz."""
    (xx, yy, zz), (xy, xz, yz) = diagonal, beside
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_ardupilot(given: Given, tmp_path: Path) -> None:
    """field = M (raw + OFS) in mGauss."""
    for index, nth in ((0, ""), (1, "2")):
        found = parameters(exported(tmp_path, "ardupilot", "--index", str(index)), ",")
        ofs, dia, odi = ([found[f"COMPASS_{name}{nth}_{axis}"] for axis in "XYZ"] for name in ("OFS", "DIA", "ODI"))
        field_mg = (FIELDS_NT / 100.0 + np.array(ofs)) @ symmetric(dia, odi)
        np.testing.assert_allclose(100.0 * field_mg, calibrated(given), rtol=0.0, atol=0.02)
        assert found[f"COMPASS_SCALE{nth}"] == 0.0


def test_ardupilot_by_pymavlink(given: Given, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """pymavlink's own reader of parameter files takes each line, and says nothing of any."""
    reader = pytest.importorskip("pymavlink.mavparm", reason="pymavlink, which reads ArduPilot's files, is not here")
    for index, nth in ((0, ""), (1, "2"), (2, "3")):
        text = exported(tmp_path, "ardupilot", "--index", str(index))
        file = tmp_path / "compass.param"
        file.write_text(text)
        capsys.readouterr()
        found = reader.MAVParmDict()
        assert found.load(str(file))
        said = capsys.readouterr().out
        assert "Invalid" not in said
        assert f"{len(parameters(text, ','))} parameters" in said
        ofs, dia, odi = ([found[f"COMPASS_{name}{nth}_{axis}"] for axis in "XYZ"] for name in ("OFS", "DIA", "ODI"))
        field_mg = (FIELDS_NT / 100.0 + np.array(ofs)) @ symmetric(dia, odi)
        np.testing.assert_allclose(100.0 * field_mg, calibrated(given), rtol=0.0, atol=0.02)


@pytest.mark.parametrize("name", ["ardupilot", "px4"])
def test_parameters_of_a_sensor_that_is_nearly_right_are_floats(name: str, tmp_path: Path) -> None:
    """A zero or a 0.00001 is no whole number and no power of ten to the target."""
    result = written(tmp_path, bias_nt=[0.0, 1.0, -3e-3], D=[[0.0, 1e-5, 0.0], [1e-5, 0.0, -2e-7], [0.0, -2e-7, 0.0]])
    done = run("export", result, "--format", name)
    assert done.code == 0
    assert len(parameters(done.out, "," if name == "ardupilot" else "\t")) == (10 if name == "ardupilot" else 9)


def test_px4(given: Given, tmp_path: Path) -> None:
    """field = SCALE (raw - OFF) in Gauss."""
    text = exported(tmp_path, "px4")
    found = parameters(text, "\t")
    off, scale, odiag = ([found[f"CAL_MAG0_{axis}{name}"] for axis in "XYZ"] for name in ("OFF", "SCALE", "ODIAG"))
    field_g = (FIELDS_NT / 1e5 - np.array(off)) @ symmetric(scale, odiag)
    np.testing.assert_allclose(1e5 * field_g, calibrated(given), rtol=0.0, atol=0.02)
    assert all(line.split("\t")[::4] == ["1", "9"] for line in text.splitlines() if not line.startswith("#"))


def test_betaflight_says_what_it_cannot_carry(given: Given, tmp_path: Path) -> None:
    path = written(tmp_path)
    done = run("export", path, "--format", "betaflight", "--lsb-nt", "150")
    assert done.code == 3
    counts = [int(one) for one in re.search(r"set mag_calibration = (.*)", done.out).group(1).split(",")]  # type: ignore[union-attr]
    field = FIELDS_NT / 150.0 - np.array(counts)
    level = np.mean(np.linalg.norm(calibrated(given), axis=1)) / np.mean(np.linalg.norm(field, axis=1))
    left = np.linalg.norm(field * level - calibrated(given), axis=1) / np.linalg.norm(calibrated(given), axis=1)
    told = float(re.search(r"up to (\d+) nT of 50 uT", done.err).group(1))  # type: ignore[union-attr]
    assert 0.5 * told < 50_000.0 * left.max() < 1.3 * told
    assert run("export", path, "--format", "betaflight").code == 2


def test_csv(tmp_path: Path) -> None:
    rows = [line.split(",") for line in exported(tmp_path, "csv").splitlines() if not line.startswith("#")]
    assert rows[0] == ["name", "value", "sigma", "unit"]
    assert [float(row[1]) for row in rows[1:]] == X.tolist()
    assert [float(row[2]) for row in rows[1:]] == np.sqrt(np.arange(1.0, 10.0)).tolist()
    assert [row[3] for row in rows[1:]] == ["nT"] * 3 + ["1"] * 6


PROGRAM = """
#include <stdio.h>
{include}
int main(void) {{ double b[3]; while (scanf("%lf %lf %lf", b, b + 1, b + 2) == 3) {{ {apply} }} return 0; }}
"""
BY_HEADER = """float m[3] = {(float)b[0], (float)b[1], (float)b[2]}, w[3]; magcal_result_apply(m, w);
    printf("%.9g %.9g %.9g\\n", w[0], w[1], w[2]);"""
BY_TABLE = """for (int i = 0; i < 3; ++i) printf("%.17g ", MagcalResult.Matrix[i][0] * b[0]
    + MagcalResult.Matrix[i][1] * b[1] + MagcalResult.Matrix[i][2] * b[2] - MagcalResult.Bias_nT[i]); puts("");"""
CFE = """typedef struct { char a[64], b[64], c[64], d[64]; unsigned n; } CFE_TBL_FileDef_t;
#define CFE_TBL_FILEDEF(ObjName, TblName, Desc, Filename) \\
    CFE_TBL_FileDef_t CFE_TBL_FileDef = {#ObjName, #TblName, #Desc, #Filename, sizeof(ObjName)};
"""


@pytest.mark.skipif(GCC is None, reason="gcc is not installed")
@pytest.mark.parametrize(
    ("name", "file", "body", "within_nt"),
    [("c-header", "result.h", BY_HEADER, 0.05), ("cfs-table", "table.c", BY_TABLE, 1e-7)],
)
def test_c(name: str, file: str, body: str, within_nt: float, given: Given, tmp_path: Path) -> None:
    """Compiled without a warning and run."""
    assert GCC is not None
    (tmp_path / file).write_text(exported(tmp_path, name))
    (tmp_path / "cfe_tbl_filedef.h").write_text(CFE)
    (tmp_path / "main.c").write_text(PROGRAM.format(include=f'#include "{file}"', apply=body))
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([GCC, *options, "main.c", "-o", "main"], cwd=tmp_path, check=True, timeout=60)
    sent = "\n".join(" ".join(map(repr, row)) for row in FIELDS_NT.tolist())
    done = subprocess.run([tmp_path / "main"], input=sent, capture_output=True, text=True, check=True, timeout=60)
    found = np.array([[float(one) for one in line.split()] for line in done.stdout.splitlines()])
    np.testing.assert_allclose(found, calibrated(given), rtol=0.0, atol=within_nt)


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_schemas(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(schema(name))
    assert schema(name)["properties"]["schema"] == {"const": name}


def test_the_schema_of_a_result_is_given(tmp_path: Path) -> None:
    assert json.loads(exported(tmp_path, "json-schema")) == schema("magcal-calibration-1")


@pytest.mark.parametrize("name", [name for name in FORMS if name != "json-schema"])
def test_each_says_equation_source_and_doubts(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, trusted=False, reasons=["poor_coverage"])
    out = tmp_path / "out"
    done = run("export", path, "--format", name, "--lsb-nt", "100", "--out", out)
    text = out.read_text()
    assert done.code == 3
    assert "not to be trusted: poor_coverage" in done.err
    assert "DO NOT FLY THIS: not to be trusted: poor_coverage" in text
    assert "w = (I + D) B - b: B measured, w calibrated, both in nT in the sensor's own axes" in text
    assert read_given(path).sha256 in text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--format", "px"), "--format: 'px' is refused; did you mean 'px4'?"),
        (("--format", "px4", "--index", "9"), "PX4 takes 0 to 3 compasses after the first"),
        (("--format", "betaflight", "--lsb-nt", "-1"), "--lsb-nt: -1.0 is refused"),
        (("--format", "csv", "--out", "no/such/place"), "give a file in a folder that is there"),
    ],
)
def test_what_no_target_takes_is_refused(arguments: tuple[str, ...], told: str, tmp_path: Path) -> None:
    done = run("export", written(tmp_path), *arguments)
    assert (done.code, done.out) == (2, "")
    assert told in done.err


def test_texts_of_a_result_end_no_comment(tmp_path: Path) -> None:
    path = written(tmp_path, trusted=False, reasons=["x */\n#define EVIL 1\n/* "])
    for name in ("c-header", "cfs-table", "ardupilot", "px4"):
        text = run("export", path, "--format", name).out
        assert "x * /?#define EVIL 1?/* " in text
        assert not any(line.startswith("#define EVIL") for line in text.splitlines())


def test_a_folder_is_refused_with_the_files_in_it(tmp_path: Path) -> None:
    """As the folder that a diagnosis wrote is given in place of its physics file."""
    for name in ("report.html", "physics.toml", "diagnosis.json"):
        (tmp_path / name).write_text("", encoding="utf-8")
    with pytest.raises(InputRefusedError, match=r"give one of its files: diagnosis\.json, physics\.toml$"):
        read_given(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputRefusedError, match="a folder, not a file; give a readable file"):
        read_given(tmp_path / "empty")


def test_numbers_beyond_the_target_are_refused(tmp_path: Path) -> None:
    far = run("export", written(tmp_path, bias_nt=[300_000.0, 0.0, 0.0]), "--format", "ardupilot")
    assert far.code == 2
    assert "length of COMPASS_OFS" in far.err
    assert "ArduPilot takes 0 to 1800 mGauss" in far.err
