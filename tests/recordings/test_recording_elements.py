"""Positions from two-line element sets, against those that the flight's own dataset derived from the same sets."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ExtraMissingError, RecordingError
from magcal_service.earth.orbit_elements import checksum, read_element_sets
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.report import RowFault

pytest.importorskip("sgp4")
pytest.importorskip("ppigrf")

LINES = """1 52191U 22033AL  23230.19186300  .00024213  00000+0  68788-3 0  9997
2 52191  97.3626 311.7534 0006600 276.8465  83.2028 15.36153603 76792
""".splitlines()
EPOCH = "2023-08-18T04:36:16.963Z"
SAMPLES = '[samples]\nfile = "log.csv"\n[time]\ncolumn = "t"\nformat = "iso8601"\n'
REST = (
    '[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n[reference]\nmodel = "igrf"\n[position]\ntle = "tle.txt"\n'
)
DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "suchai3"


def write(folder: Path, times: list[str], lines: list[str], position: str = "") -> Path:
    (folder / "log.csv").write_text("t,x,y,z\n" + "".join(f"{time},1,2,3\n" for time in times))
    (folder / "tle.txt").write_text("\n".join([*lines, ""]))
    (folder / "r.toml").write_text(f"version = 1\n{SAMPLES}{REST}{position}")
    return folder / "r.toml"


@pytest.mark.parametrize("name", ["2023-12-11", "2024-passes"])
def test_the_field_by_element_sets_is_that_of_the_derived_positions(tmp_path: Path, name: str) -> None:
    if not DATA.is_dir():
        pytest.skip(f"recordings of SUCHAI-3 are not in {DATA}")
    text = (DATA / f"{name}.toml").read_text().replace(f'"{name}.csv"', f'"{DATA / name}.csv"')
    derived, _, rest = text.partition("[position]\n")
    after = rest[rest.index("\n[") :]
    (tmp_path / "derived.toml").write_text(text)
    (tmp_path / "tle.toml").write_text(
        f'{derived}[position]\ntle = "{DATA / "tle-52191.txt"}"\nmax_age_days = 30.0\n{after}'
    )
    wanted = read_recording(tmp_path / "derived.toml").reference.magnitude_nt
    recording = read_recording(tmp_path / "tle.toml")
    assert np.sqrt(np.mean((recording.reference.magnitude_nt - wanted) ** 2)) < 0.02
    assert recording.report.lines()[-1].startswith("position: by 171 element sets, 0.")


def test_the_set_nearest_in_time_is_taken(tmp_path: Path) -> None:
    second = "1 52191U 22033AL  23231.16894290  .00026545  00000+0  75235-3 0  9994"
    other = "2 52191  97.3624 312.7309 0006630 272.7402  87.3083 15.36209484 76942"
    both = read_element_sets(
        write(tmp_path, [], ["SUCHAI-3", *LINES, "", "SUCHAI-3", second, other]).parent / "tle.txt"
    )
    alone = read_element_sets(write(tmp_path, [], [second, other]).parent / "tle.txt")
    assert both.epochs_ns.tolist() == [1692333376963200000, 1692417796666560000]
    middle = int(both.epochs_ns.mean())
    times = np.array([middle - 10**9, middle + 10**9, both.epochs_ns[1] + 86_400 * 10**9])
    assert np.array_equal(both.positions_km(times)[1:], alone.positions_km(times)[1:])
    assert 0.1 < np.linalg.norm(both.positions_km(times)[0] - alone.positions_km(times)[0]) < 10.0
    assert (both.ages_ns(times) / 1e9).round(1).tolist() == [42208.9, 42208.9, 86400.0]


def test_rows_far_from_every_epoch_have_no_position(tmp_path: Path) -> None:
    path = write(tmp_path, [EPOCH, "2023-08-20T12:00:00Z", "2023-08-22T00:00:00Z"], LINES)
    recording = read_recording(path)
    assert np.isfinite(recording.reference.magnitude_nt).tolist() == [True, True, False]
    assert recording.report.count("position", RowFault.OLD_ELEMENTS) == 1
    assert recording.report.lines()[-1] == (
        "position: by 1 element sets, 1.2 days from their epoch in the middle, 2.3 at most"
    )
    shorter = read_recording(write(tmp_path, [EPOCH, "2023-08-20T12:00:00Z"], LINES, "max_age_days = 1\n"))
    assert shorter.report.count("position", RowFault.OLD_ELEMENTS) == 1
    assert recording.descriptor.files[-1] == tmp_path / "tle.txt"


REFUSED = {
    "a digit changed": ([LINES[0], LINES[1].replace("15.36", "15.37")], "tle.txt: line 2: .*checksum"),
    "cut": ([LINES[0], LINES[1][:60]], "tle.txt: line 2: .*69 characters"),
    "no second line": ([LINES[0]], "tle.txt: line 2: ''"),
    "no first line": ([LINES[1]], "tle.txt: line 1: .*second line comes after"),
    "nothing": (["SUCHAI-3"], "'no element set'"),
    "of two craft": ([*LINES, *(line[:2] + "52193" + line[7:68] for line in LINES)], "'2 craft' .*52191, 52193"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_of_elements_that_cannot_be_is_refused(tmp_path: Path, case: str) -> None:
    lines, says = REFUSED[case]
    lines = [line + checksum(line) if len(line) == 68 else line for line in lines]
    with pytest.raises(RecordingError, match=says):
        read_recording(write(tmp_path, [EPOCH], lines))


def test_elements_need_a_date(tmp_path: Path) -> None:
    path = write(tmp_path, ["0"], LINES)
    path.write_text(path.read_text().replace("iso8601", "elapsed_s"))
    with pytest.raises(RecordingError, match="required with elapsed_s and position"):
        read_recording(path)


def test_without_sgp4_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sgp4.api", None)
    with pytest.raises(ExtraMissingError, match="sim"):
        read_recording(write(tmp_path, [EPOCH], LINES))
