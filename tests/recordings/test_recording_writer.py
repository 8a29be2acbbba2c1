from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.channels import Axes, ChannelSpec, QuaternionOrder
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Channel, Position, Recording
from magcal_service.recordings.specs import SpinSpec
from magcal_service.recordings.writer import make_channel, write_recording
from magcal_service.wire.messages import Clock, Frame

N = 40
AXIS = (-0.17372923075826835, 0.8512732307155149, 0.49512830766106475)  # of length 1 but for rounding
ATTITUDE = ChannelSpec(
    "attitude", ("a", "b", "c", "d"), order=QuaternionOrder.WXYZ, from_axes=Axes.ECI, to_axes=Axes.BODY
)


def arrays(seed: int = 3) -> dict[str, object]:
    """Everything a recording can hold, at full precision, with what awkwardness a log may have."""
    rng = np.random.default_rng(seed)
    temperature = rng.normal(20.0, 5.0, N)
    temperature[[0, 7]] = np.nan
    reference_nt = rng.normal(0.0, 2e4, (N, 3))
    reference_nt[5] = np.nan
    return {
        "time_ns": 1_700_000_000_123_456_789 + np.cumsum(rng.integers(1, 10**9, N)),
        "clock": Clock.UTC,
        "field_body_nt": rng.normal(0.0, 3e4, (N, 3)),
        "reference_nt": reference_nt,
        "frame": Frame.ECI,
        "position": Position(rng.normal([6900.0, 10.0, -20.0], 1.0, (N, 3)), Frame.ECI),
        "channels": [
            make_channel("temperature", temperature, "degC"),
            make_channel("time", rng.normal(size=(N, 3)), "A m2", Axes.BODY),
            make_channel("time_0", rng.normal(size=N)),
            make_channel('odd "name".1', rng.normal(size=N), "A"),
            Channel(ATTITUDE, rng.normal(size=(N, 4))),
        ],
        "spin": SpinSpec(AXIS, -7.5),
        "noise_nt": 300.25,
    }


def same_bits(first: np.ndarray, second: np.ndarray) -> bool:
    return first.dtype == second.dtype and first.shape == second.shape and first.tobytes() == second.tobytes()


@pytest.fixture(params=["plain", "packed"])
def back(request: pytest.FixtureRequest, tmp_path: Path) -> Recording:
    return read_recording(write_recording(tmp_path, **arrays(), compress=request.param == "packed"))


@pytest.mark.parametrize("name", ["time_ns", "field_body_nt"])
def test_samples_come_back_bit_for_bit(back: Recording, name: str) -> None:
    assert same_bits(getattr(back, name), arrays()[name])


def test_the_reference_comes_back_bit_for_bit(back: Recording) -> None:
    assert back.reference.frame is Frame.ECI
    assert same_bits(back.reference.vector_nt, arrays()["reference_nt"])


def test_the_position_comes_back_bit_for_bit(back: Recording) -> None:
    assert (back.position.frame, same_bits(back.position.km, arrays()["position"].km)) == (Frame.ECI, True)


def test_every_channel_comes_back_bit_for_bit(back: Recording) -> None:
    written = {channel.spec.name: channel for channel in arrays()["channels"]}
    assert list(back.channels) == list(written)
    assert all(same_bits(back.channels[name].values, channel.values) for name, channel in written.items())


def test_what_a_channel_is_comes_back(back: Recording) -> None:
    for channel in arrays()["channels"]:
        read, spec = back.channels[channel.spec.name].spec, channel.spec
        assert (read.unit, read.frame, read.order) == (spec.unit, spec.frame, spec.order)
        assert (read.from_axes, read.to_axes) == (spec.from_axes, spec.to_axes)


def test_spin_and_noise_come_back(back: Recording) -> None:
    assert (back.descriptor.spin, back.descriptor.magnetometer.noise_nt) == (arrays()["spin"], 300.25)


def test_elapsed_time_and_a_magnitude_come_back(tmp_path: Path) -> None:
    times = np.array([-1, 0, 10**18 + 1])
    magnitudes = np.array([1e-3, 45000.1, np.nan])
    path = write_recording(
        tmp_path, time_ns=times, clock=Clock.ELAPSED, field_body_nt=np.ones((3, 3)), reference_nt=magnitudes
    )
    back = read_recording(path)
    assert (back.clock, back.reference.vector_nt) == (Clock.ELAPSED, None)
    assert same_bits(back.time_ns, times)
    assert same_bits(back.reference.magnitude_nt, magnitudes)


FIELDS = hnp.arrays(np.float64, (4, 3), elements=st.floats(-5e5, 5e5, allow_subnormal=True))
TIMES = hnp.arrays(np.int64, 4, elements=st.integers(-(2**62), 2**62))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50, deadline=None)
@given(FIELDS, TIMES, st.sampled_from(Clock))
def test_any_field_at_any_time_comes_back_bit_for_bit(
    tmp_path: Path, field_nt: np.ndarray, times: np.ndarray, clock: Clock
) -> None:
    path = write_recording(tmp_path, time_ns=times, clock=clock, field_body_nt=field_nt, reference_nt=np.full(4, 4e4))
    back = read_recording(path)
    assert same_bits(back.field_body_nt, field_nt)
    assert same_bits(back.time_ns, times)


@pytest.mark.parametrize("compress", [False, True])
def test_the_same_arrays_give_the_same_bytes(tmp_path: Path, compress: bool) -> None:
    contents = []
    for folder in ("a", "b"):
        write_recording(tmp_path / folder, **arrays(), compress=compress)
        contents.append({path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()})
    assert contents[0] == contents[1]
    assert len(contents[0]) == 2


def test_a_packed_recording_carries_no_time_of_writing(tmp_path: Path) -> None:
    write_recording(tmp_path, **arrays(), compress=True)
    assert (tmp_path / "samples.csv.gz").read_bytes()[4:8] == bytes(4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("field_body_nt", np.ones((N, 2))),
        ("reference_nt", np.ones(N)),
        ("time_ns", np.zeros(0, dtype=np.int64)),
        ("position", Position(np.ones((N - 1, 3)), Frame.ECI)),
        ("channels", [Channel(ATTITUDE, np.ones((N, 3)))]),
        ("field_body_nt", np.full((N, 3), np.nan)),
        ("field_body_nt", np.full((N, 3), 1e6)),
    ],
)
def test_what_the_reader_would_refuse_is_not_written(tmp_path: Path, name: str, value: object) -> None:
    with pytest.raises(RecordingError, match=name):
        write_recording(tmp_path, **{**arrays(), name: value})
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_unit_of_a_channel_is_refused() -> None:
    with pytest.raises(RecordingError, match="'celsius'"):
        make_channel("temperature", np.ones(3), "celsius")
