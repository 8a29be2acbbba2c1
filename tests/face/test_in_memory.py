"""Recordings of arrays and data frames: the same numbers as from a file, the same refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.base.errors import RecordingError
from magcal_service.wire.messages import Clock, Frame
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

TABLES = {
    "time": {"column": "t", "format": "elapsed_s"},
    "magnetometer": {"columns": ["x", "y", "z"], "unit": "uT"},
    "reference": {"magnitude": "f", "unit": "nT"},
}
N = 80
TIME = np.arange(float(N))
RNG = np.random.default_rng(9)
B = RNG.normal(0.0, 20_000.0, (N, 3))
H = RNG.normal(0.0, 20_000.0, (N, 3))
COLUMNS = {"t": TIME, "x": B[:, 0] / 1e3, "y": B[:, 1] / 1e3, "z": B[:, 2] / 1e3, "f": np.linalg.norm(H, axis=1)}


def test_arrays_and_the_file_of_the_same_flight_give_the_same_calibration(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Bit for bit: from a recording that was written and read, and from its arrays."""
    path = record_simulation(Simulation(load_scenario("paper"), seed=5, duration_s=1500.0), tmp_path)
    file = magcal.read_recording(path)
    arrays = magcal.Recording.from_arrays(
        file.time_ns.astype("datetime64[ns]"),
        file.field_body_nt,
        file.reference.vector_nt,
        noise_nt=file.descriptor.magnetometer.noise_nt,
        spin_axis=file.descriptor.spin.axis,  # type: ignore[union-attr]
        spin_rpm=file.descriptor.spin.rate_rpm,  # type: ignore[union-attr]
        craft=file.of_craft,
    )
    assert arrays.clock is Clock.UTC
    assert json.dumps(magcal.calibrate(arrays).to_dict()) == json.dumps(magcal.calibrate(file).to_dict())


def test_rows_without_a_vector_are_refused_and_counted() -> None:
    spoiled = B.copy()
    spoiled[3, 0] = np.nan
    recording = magcal.Recording.from_arrays(TIME, spoiled, H)
    assert (len(recording), recording.report.refused) == (N - 1, 1)
    assert recording.time_ns[3] == 4_000_000_000


def test_parts_are_kept_as_given() -> None:
    places = np.full((N, 3), 7000.0)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))
    recording = magcal.Recording.from_arrays(
        TIME, B, H, frame="ecef", position_ecef_km=places, channels={"t_mag": (TIME, "K")}, attitude=turn
    )
    assert recording.reference.frame is Frame.ECEF
    assert recording.position is not None
    assert recording.position.km.tolist() == places.tolist()
    assert recording.channels["t_mag"].spec.quantity == "temperature"
    assert recording.channels["attitude"].spec.quantity == "attitude"
    assert "attitude" in repr(recording)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"B": B[:10]}, r"shape of B: \(10, 3\) is refused; \(80, 3\) is accepted"),
        ({"time": np.full(N, np.nan)}, r"time: nan is refused; finite seconds"),
        ({"time": np.array(["a"] * N)}, r"time: '<U1 of shape \(80,\)' is refused"),
        ({"time": np.full(N, np.datetime64("NaT"), dtype="datetime64[s]")}, r"time: 'NaT' is refused"),
        ({"B": np.full((N, 3), np.nan)}, r"usable rows: 0 is refused"),
        ({"H": ["north"] * N}, r"H: 'list' is refused; numbers are accepted"),
        ({"frame": "ecf"}, r"frame: 'ecf' is refused; did you mean 'ecef'"),
        ({"channels": {"t": (TIME, "fathom")}}, r"unit of channel t: 'fathom' is refused"),
        ({"spin_axis": "w", "spin_rpm": 1.0}, r"spin_axis: 'w' is refused"),
        ({"spin_axis": (0.0, 0.0, 0.0), "spin_rpm": 1.0}, r"spin_axis: \(0.0, 0.0, 0.0\) is refused"),
        ({"attitude": np.ones((N, 3))}, r"shape of attitude: \(80, 3\) is refused; \(80, 4\)"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changes: dict[str, object], says: str) -> None:
    given: dict[str, object] = {"time": TIME, "B": B, "H": H, **changes}
    with pytest.raises(RecordingError, match=says):
        magcal.Recording.from_arrays(**given)  # type: ignore[arg-type]


def frames() -> list[object]:
    """The same columns in every kind of frame that is installed here."""
    found: list[object] = [COLUMNS]
    for name in ("pandas", "polars"):
        try:
            module = __import__(name)
        except ImportError:
            continue
        found.append(module.DataFrame(COLUMNS))
    try:
        import pyarrow
    except ImportError:
        return found
    return [*found, pyarrow.table(COLUMNS)]


@pytest.mark.parametrize("frame", frames(), ids=lambda frame: type(frame).__module__.partition(".")[0])
def test_every_kind_of_frame_gives_the_same_recording(frame: object) -> None:
    recording = magcal.Recording.from_dataframe(frame, TABLES)  # type: ignore[arg-type]
    assert recording.field_body_nt == pytest.approx(B, rel=1e-15)
    assert np.array_equal(recording.reference.magnitude_nt, COLUMNS["f"])
    assert np.array_equal(recording.time_ns, (TIME * 1e9).astype(np.int64))


def test_a_frames_gaps_are_counted_as_a_files() -> None:
    x = COLUMNS["x"].tolist()
    x[7], x[8] = None, "n/a"
    recording = magcal.Recording.from_dataframe({**COLUMNS, "x": np.array(x, dtype=object)}, TABLES)
    assert len(recording) == N - 2
    assert recording.report.counts == {"missing": 1, "unparsable": 1}


def test_times_of_a_frame_may_be_datetimes() -> None:
    times = np.datetime64("2025-06-01T00:00:00") + np.arange(N) * np.timedelta64(1, "s")
    tables = {**TABLES, "time": {"column": "t", "format": "iso8601"}}
    recording = magcal.Recording.from_dataframe({**COLUMNS, "t": times}, tables)
    assert recording.time_ns.tolist() == times.astype("datetime64[ns]").astype(np.int64).tolist()


@pytest.mark.parametrize(
    ("frame", "tables", "says"),
    [
        (COLUMNS, {**TABLES, "reference": {"magnitude": "g", "unit": "nT"}}, r"reference.magnitude: 'g' is refused"),
        (COLUMNS, {**TABLES, "spinn": {}}, r"spinn: .* is refused; unknown key; did you mean 'spin'"),
        (object(), TABLES, r"frame: 'object' is refused; a data frame of pandas, polars or pyarrow"),
    ],
)
def test_a_frame_that_is_described_wrongly_is_refused(frame: object, tables: dict[str, object], says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        magcal.Recording.from_dataframe(frame, tables)  # type: ignore[arg-type]
