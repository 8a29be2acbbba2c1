"""The recordings made in orbit and in the laboratory that may lie beside the checkout."""

import time
from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.wire.codec import decode, encode

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"

# samples, |B| range and |H| range [nT]; SUCHAI-3 carries a platform offset of about 1 G
EXPECTED = {
    "suchai3/2023-08-24": (5586, (60e3, 160e3), (19e3, 54e3)),
    "suchai3/2023-11-13": (997, (60e3, 160e3), (19e3, 54e3)),
    "suchai3/2024-passes": (5918, (30e3, 200e3), (19e3, 54e3)),
    "iss-2017/recording": (488, (1e3, 90e3), (18e3, 54e3)),
    "iss-2022-ir/recording": (13723, (1e3, 90e3), (18e3, 54e3)),
    "broad/control-01": (4068, (30e3, 60e3), (43e3, 44e3)),
    "broad/magnet-32": (3403, (10e3, 120e3), (43e3, 44e3)),
    "broad/magnet-34": (3451, (10e3, 120e3), (43e3, 44e3)),
}
_read: dict[str, Recording] = {}


@pytest.fixture(params=EXPECTED)
def name(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    if not (DATA / f"{name}.toml").exists():
        pytest.skip(f"the recording {name} is not in ../shared/data")
    if name not in _read:
        _read[name] = read_recording(DATA / f"{name}.toml")
    return name


def test_every_row_is_used(name: str) -> None:
    assert (len(_read[name]), _read[name].report.refused) == (EXPECTED[name][0], 0)


def test_the_measured_field_is_plausible(name: str) -> None:
    low_nt, high_nt = np.percentile(np.linalg.norm(_read[name].field_body_nt, axis=1), [1, 99])
    assert EXPECTED[name][1][0] < low_nt < high_nt < EXPECTED[name][1][1]


def test_the_reference_is_plausible_on_every_row(name: str) -> None:
    magnitude_nt = _read[name].reference.magnitude_nt
    assert EXPECTED[name][2][0] < magnitude_nt.min() <= magnitude_nt.max() < EXPECTED[name][2][1]


def test_every_message_passes_the_wire(name: str) -> None:
    for number, message in enumerate(messages(_read[name])):
        if number % 97 == 0:
            assert decode(encode(message)) == message


def test_rows_for_offline_use_rise_in_time(name: str) -> None:
    assert (np.diff(_read[name].sorted_unique().time_ns) > 0).all()


def test_against_pygeomag_the_reference_of_suchai_3_agrees_within_100_nt() -> None:
    path = DATA / "suchai3" / "2023-08-24.toml"
    if not path.exists():
        pytest.skip("the recording suchai3/2023-08-24 is not in ../shared/data")
    pygeomag = pytest.importorskip("pygeomag")
    witness = pygeomag.GeoMag(coefficients_file="wmm/WMM_2020.COF")
    table = np.genfromtxt(path.with_suffix(".csv"), delimiter=",", names=True)[::200]
    places = zip(table["lat"], table["lon"], table["alt_km"], strict=True)
    expected_nt = [witness.calculate(glat=a, glon=o, alt=h, time=2023.646).f for a, o, h in places]
    np.testing.assert_allclose(read_recording(path).reference.magnitude_nt[::200], expected_nt, atol=100.0)


def test_the_dropouts_of_the_optical_attitude_are_counted_and_keep_their_rows() -> None:
    path = DATA / "broad" / "magnet-32.toml"
    if not path.exists():
        pytest.skip("the recording broad/magnet-32 is not in ../shared/data")
    recording = read_recording(path)
    missing = np.isnan(recording.channels["attitude"].values).any(axis=1)
    assert (int(missing.sum()), len(recording)) == (recording.report.counts["not_a_number"], 3403)


def test_a_recording_of_18000_rows_of_15_columns_is_read_in_well_under_a_second(tmp_path: Path) -> None:
    from magcal_service.recordings.writer import make_channel, write_recording
    from magcal_service.wire.messages import Clock, Frame

    rng = np.random.default_rng(5)
    path = write_recording(
        tmp_path,
        time_ns=np.arange(18000) * 10**9,
        clock=Clock.UTC,
        field_body_nt=rng.normal(0, 3e4, (18000, 3)),
        reference_nt=rng.normal(0, 3e4, (18000, 3)),
        frame=Frame.ECI,
        channels=[make_channel("many", rng.normal(size=(18000, 8)))],
    )
    best_s = np.inf
    for _ in range(3):  # the best of three, since the machine may be busy with something else
        before_s = time.process_time()
        read_recording(path)
        best_s = min(best_s, time.process_time() - before_s)
    assert best_s < 1.0
