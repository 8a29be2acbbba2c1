"""Files that unpack to far more than they are: refused while they are read, with a way on; none is held first."""

from __future__ import annotations

import gzip
import io
import os
import re
import struct
import tracemalloc
import zlib
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import zstandard

from magcal_service.base.errors import InputRefusedError, RecordingError
from magcal_service.cli.__main__ import main
from magcal_service.offline.given import read_given
from magcal_service.recordings import export, mcap_limits, mcap_reader, mcap_records, row_limits
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.mcap import MAGIC
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.row_limits import RowLimits
from magcal_service.recordings.session import read_session
from magcal_service.recordings.session_files import recover_in_place
from magcal_service.wire.messages import Clock, MagnetometerSample, Message, TelemetrySample
from tests.recordings.recording_logs import HEADER, descriptor, row, write_log
from tests.recordings.sessions import record, stream

ROWS = [row(1700000000 + second) for second in range(5)]


def limited(folder: Path, rows: int, content: list[str]) -> Path:
    """A log with ``samples.max_rows``."""
    return write_log(folder, descriptor().replace("[time]", f"max_rows = {rows}\n[time]", 1), content)


def test_a_log_of_as_many_rows_as_are_accepted_is_read_and_one_more_refused(tmp_path: Path) -> None:
    assert len(read_recording(limited(tmp_path, 5, ROWS))) == 5
    with pytest.raises(RecordingError, match=r"log\.csv.*more than 4 rows.*at most 4 rows are accepted.*set max_rows"):
        read_recording(limited(tmp_path, 4, ROWS))


@pytest.mark.parametrize("end", ["\r", "\r\n"])
def test_rows_are_counted_whatever_ends_them(tmp_path: Path, end: str) -> None:
    path = limited(tmp_path, 4, ROWS)
    (tmp_path / "log.csv").write_text(end.join([HEADER, *ROWS[:4], ""]), newline="")
    assert len(read_recording(path)) == 4
    (tmp_path / "log.csv").write_text(end.join([HEADER, *ROWS, ""]), newline="")
    with pytest.raises(RecordingError, match="more than 4 rows"):
        read_recording(path)


BOMBS = {
    "rows": (b"0\n" * (1 << 24), "more than 1000 rows"),
    "a line": (b"," * (1 << 25), "line that is too long"),
    "lines": ((b"," * (1 << 19) + b"\n") * (1 << 6), "more than 1048576 bytes unpacked"),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_packed_log_is_refused_long_before_all_of_it_is_unpacked(tmp_path: Path, bomb: str) -> None:
    """32 MiB unpacked; less than a fifth of it is ever held."""
    content, why = BOMBS[bomb]
    text = descriptor(file="log.csv.gz").replace("[time]", "max_rows = 1000\n[time]", 1)
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(content, 9))
    path = write_log(tmp_path, text)
    tracemalloc.start()
    with pytest.raises(RecordingError, match=why):
        read_recording(path)
    assert tracemalloc.get_traced_memory()[1] < 6 << 20
    tracemalloc.stop()


def test_a_log_of_too_many_cells_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each row has 19 cells, and 16 a row are accepted."""
    monkeypatch.setattr(row_limits, "_LEAST_CELLS", 0)
    with pytest.raises(RecordingError, match=r"5 rows of 19 columns.*at most 80 cells"):
        read_recording(limited(tmp_path, 5, ROWS))


def test_a_row_takes_less_than_half_a_kilobyte(tmp_path: Path) -> None:
    """At the peak of reading and inspecting: a text of its own for each cell would take twice as much."""
    path = tmp_path / "RECORDING.toml"
    count = 40_000
    rng = np.random.default_rng(3)
    fields = rng.uniform(-5e4, 5e4, (count, 3))
    lines = [f"{i * 0.01:.2f},{x:.3f},{y:.3f},{z:.3f},48000.00,20.50,7" for i, (x, y, z) in enumerate(fields)]
    (tmp_path / "log.csv").write_text("\n".join(["t,x,y,z,f,temp,n", *lines]))
    path.write_text(
        'version = 1\n[samples]\nfile = "log.csv"\n[time]\ncolumn = "t"\nformat = "elapsed_s"\n'
        '[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n[reference]\nmagnitude = "f"\nunit = "nT"\n'
        '[channels]\ntemperature = { column = "temp", unit = "degC" }\n'
    )
    tracemalloc.start()
    assert len(inspect(read_recording(path)).usable) == count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 400 * count


def test_wide_rows_take_no_more_beside_their_numbers(tmp_path: Path) -> None:
    """Of 300 channels; cells that are not packed yet took ten times as much as all of them as text."""
    path, names = tmp_path / "RECORDING.toml", [f"c{number}" for number in range(300)]
    count = 1000
    cells = ",".join("12.34567" for _ in names)
    lines = [f"{i},{4e4 + i % 7},{i % 11},{i % 13},48000.00,{cells}" for i in range(count)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(["t", "x", "y", "z", "f", *names]), *lines]))
    channels = "".join(f'{name} = {{ column = "{name}", unit = "A" }}\n' for name in names)
    path.write_text(
        'version = 1\n[samples]\nfile = "log.csv"\n[time]\ncolumn = "t"\nformat = "elapsed_s"\n'
        '[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n[reference]\nmagnitude = "f"\nunit = "nT"\n'
        f"[channels]\n{channels}"
    )
    tracemalloc.start()
    assert len(read_recording(path)) == count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4.5 * (tmp_path / "log.csv").stat().st_size


def test_the_messages_of_a_recording_are_made_as_they_are_taken() -> None:
    """All rows as numbers of Python would take 430 bytes each, beside the arrays."""
    count = 60_000
    rng = np.random.default_rng(4)
    fields, references = rng.uniform(-5e4, 5e4, (2, count, 3))
    recording = Recording.from_arrays(np.arange(count) * 0.1, fields, references)
    tracemalloc.start()
    assert sum(1 for _ in messages(recording)) == 2 * count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50 * count


def packed(content: bytes, times: int) -> bytes:
    """The begin of an MCAP file with the same chunk so many times."""
    body = zstandard.ZstdCompressor().compress(content)
    head = struct.pack("<QQQII4sQ", 1, 1, len(content), zlib.crc32(content), 4, b"zstd", len(body))
    return MAGIC + (struct.pack("<BQ", 6, len(head) + len(body)) + head + body) * times


def test_a_recording_that_unpacks_to_far_more_than_it_is_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each chunk has one record of no known use, 64 KiB of zeros; twelve of them are within the limit, forty not."""
    monkeypatch.setattr(mcap_limits, "_AT_LEAST", 1 << 20)
    monkeypatch.setattr(mcap_limits, "_TIMES", 1)
    content = struct.pack("<BQ", 0x80, (1 << 16) - 9) + bytes((1 << 16) - 9)
    assert list(McapReader(io.BytesIO(packed(content, 12)), "file").messages()) == []
    path = tmp_path / "bomb.mcap"
    path.write_bytes(packed(content, 40))
    out = tmp_path.parent / f"{tmp_path.name}.csv"
    exported = (["export", "--out", str(out)], ["export", "--out", str(out), "--kind", "status"])
    for command, *more in (["info"], ["recover"], ["check"], ["describe"], *exported):
        assert main(["record", command, str(path), *more]) == 2
        told = capsys.readouterr().err
        assert re.search(
            rf"bomb\.mcap.*{path.stat().st_size} bytes that unpack to more than .* accepted.*take a copy", told
        )
    assert [one.name for one in tmp_path.iterdir()] == ["bomb.mcap"]
    assert recover_in_place(path).result is None  # as the daemon does at its start: set aside, not deleted
    assert [one.name for one in tmp_path.iterdir()] == ["bomb.unreadable"]


def test_padding_is_refused_long_before_the_limit_of_what_is_a_recording(tmp_path: Path) -> None:
    """Four megabytes, 57 times as much unpacked, of no known use: refused within the first tenth of the file."""
    noise = os.urandom((1 << 22) // 57)
    content = struct.pack("<BQ", 0x80, (1 << 22) - 9) + noise + bytes((1 << 22) - 9 - len(noise))
    file = io.BytesIO(packed(content, 57))
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"unpack to more than \d+ of padding.*4 times the file.*take a copy"):
        list(McapReader(file, "file").messages())
    assert tracemalloc.get_traced_memory()[1] < 20 << 20
    tracemalloc.stop()
    assert file.tell() < len(file.getvalue()) / 10


def test_what_stands_behind_does_not_excuse_what_was_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same chunks are within the limit where as many bytes of metadata stand before them, and refused behind."""
    monkeypatch.setattr(mcap_limits, "_AT_LEAST", 1 << 16)
    monkeypatch.setattr(mcap_limits, "_TIMES", 2)
    content = struct.pack("<BQ", 0x80, (1 << 16) - 9) + bytes((1 << 16) - 9)
    chunks = packed(content, 8)[len(MAGIC) :]
    filling = struct.pack("<BQ", 0x80, 1 << 19) + bytes(1 << 19)
    assert list(McapReader(io.BytesIO(MAGIC + filling + chunks), "file").messages()) == []
    with pytest.raises(RecordingError, match="unpack to more than"):
        list(McapReader(io.BytesIO(MAGIC + chunks + filling), "file").messages())


def test_chunks_that_are_spoilt_are_not_unpacked_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred chunks with a wrong checksum, of 16 MiB each: the search for a sound one ends after some of them."""
    monkeypatch.setattr(mcap_limits, "_AT_LEAST", 1 << 24)
    content = struct.pack("<BQ", 0x80, (1 << 24) - 9) + bytes((1 << 24) - 9)
    one = bytearray(packed(content, 1)[len(MAGIC) :])
    one[9 + 24] ^= 1  # of the checksum
    tried: list[int] = []
    unpack = mcap_reader.unpack
    monkeypatch.setattr(mcap_reader, "unpack", lambda chunk: tried.append(1) or unpack(chunk))
    with pytest.raises(RecordingError, match="spoilt chunks that unpack to more than"):
        list(McapReader(io.BytesIO(MAGIC + bytes(one) * 100), "file").messages())
    assert len(tried) < 10


def test_channels_that_say_something_new_without_end_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten under one number; ten times the same is one."""

    def channel(craft: bytes) -> bytes:
        pairs = b"".join(struct.pack("<I", len(text)) + text for text in (b"craft", craft))
        body = struct.pack("<HH", 1, 0) + bytes(8) + struct.pack("<I", len(pairs)) + pairs
        return struct.pack("<BQ", 4, len(body)) + body

    monkeypatch.setattr(mcap_limits, "_MOST_INTRODUCED", 5)
    assert list(McapReader(io.BytesIO(packed(channel(b"demo") * 10, 1)), "file").messages()) == []
    file = packed(b"".join(channel(b"demo%d" % number) for number in range(10)), 1)
    with pytest.raises(RecordingError, match="more than 5 channels and schemas"):
        list(McapReader(io.BytesIO(file), "file").messages())


def test_a_message_longer_than_any_of_the_wire_is_spoilt() -> None:
    message = struct.pack("<HIQQ", 1, 0, 1, 1) + b" " * mcap_limits.LONGEST_MESSAGE
    channel = struct.pack("<BQHH", 4, 16, 1, 0) + bytes(12)
    reader = McapReader(io.BytesIO(packed(channel + struct.pack("<BQ", 5, len(message)) + message, 1)), "file")
    assert list(reader.messages()) == []
    assert reader.bad_records == 1


def test_more_messages_than_are_held_are_refused_and_a_descriptor_raises_that(tmp_path: Path) -> None:
    (path,) = record(tmp_path, stream(20))
    count = len(read_session(path).messages)
    assert len(read_session(path, limits=RowLimits(count)).messages) == count
    with pytest.raises(RecordingError, match=rf"more than {count - 1} messages that came in.*max_rows"):
        read_session(path, limits=RowLimits(count - 1))
    described = tmp_path / "RECORDING.toml"
    for rows, told in ((count, None), (count - 1, "max_rows")):
        described.write_text(f'version = 1\n[samples]\nfile = "{path.name}"\nmax_rows = {rows}\n')
        with pytest.raises(RecordingError, match=told) if told else nullcontext():
            assert len(read_recording(described))


def many_names(count: int) -> list[Message]:
    """Telemetry that has another channel, and statuses that have another counter, each time."""
    stamp = {"craft": "paper", "source": "s", "clock": Clock.UTC}
    named: list[Message] = []
    for number in range(count):
        time_ns = 1_700_000_000_000_000_000 + number * 10**9
        named.append(
            MagnetometerSample(**stamp, sequence=number, time_ns=time_ns, field_body_nt=(1.0 + number, 2.0, 3.0))
        )
        named.append(
            TelemetrySample(
                **stamp, sequence=number, time_ns=time_ns, channel=f"c{number}", unit="A", values=(1.0,) * 16
            )
        )
    return named


def test_channels_and_counters_that_are_always_new_do_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each channel has a cell in every row: 300 of sixteen values beside 300 samples would be 1.4 million."""
    (path,) = record(tmp_path, tuple(many_names(300)))
    monkeypatch.setattr(row_limits, "_CELLS_PER_ROW", 0)
    tracemalloc.start()
    for command in (["calibrate", str(path)], ["record", "export", str(path), "--out", str(tmp_path / "x.csv")]):
        assert main(command) == 2
        assert "300 rows of 4800 columns is refused; at most 65536 cells" in capsys.readouterr().err.replace("'", "")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 << 20
    monkeypatch.setattr(export, "_MOST_CELLS", 1000)
    assert main(["record", "export", str(path), "--kind", "telemetry", "--out", str(tmp_path / "x.csv")]) == 2
    assert "columns' is refused; at most 1000 cells" in capsys.readouterr().err
    assert not (tmp_path / "x.csv").exists()


def test_a_chunk_that_says_too_much_or_has_more_than_it_says_is_not_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    content = bytes(1 << 20)
    monkeypatch.setattr(mcap_records, "LARGEST_RECORD", 1 << 19)
    monkeypatch.setattr(zstandard, "ZstdDecompressor", lambda: pytest.fail("unpacked"))
    whole = packed(content, 1)
    for size in (1 << 20, 1 << 18):
        changed = bytearray(whole)
        struct.pack_into("<Q", changed, len(MAGIC) + 9 + 16, size)
        reader = McapReader(io.BytesIO(bytes(changed)), "file")
        assert list(reader.messages()) == []
        assert reader.bad_chunks == 1


def test_more_messages_than_the_indices_of_a_file_could_state_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand of no content in one small chunk without an index: the file has room for the index of a few."""
    channel = struct.pack("<HH", 1, 0) + bytes(12)
    message = struct.pack("<HIQQ", 1, 0, 1, 1)
    records = struct.pack("<BQ", 4, len(channel)) + channel
    records += (struct.pack("<BQ", 5, len(message)) + message) * 1000
    file = packed(records, 1)
    assert len(list(McapReader(io.BytesIO(file), "file").messages())) == 1000
    monkeypatch.setattr(mcap_limits, "_MOST_UNSTATED", 100)
    most = 100 + len(file) // 16
    with pytest.raises(RecordingError, match=rf"file.*more than {most} messages in {len(file)} bytes"):
        list(McapReader(io.BytesIO(file), "file").messages())


@pytest.mark.parametrize("size", [100_000_000, 2_000_000])
@pytest.mark.parametrize("name", ["RECORDING.toml", "physics.toml", "result.json"])
def test_a_file_that_is_read_as_a_whole_is_refused_by_its_size(name: str, size: int, tmp_path: Path) -> None:
    """Of 100 MB little more than the limit is held; 2 MB of TOML are not parsed either."""
    path = tmp_path / name
    path.touch()
    os.truncate(path, size)
    read = read_recording if name == "RECORDING.toml" else read_given
    told = "no JSON" if (name, size) == ("result.json", 2_000_000) else rf"{size} bytes.*at most \d+ bytes"
    tracemalloc.start()
    with pytest.raises(InputRefusedError, match=rf"{name}.*{told}"):
        read(path)
    assert tracemalloc.get_traced_memory()[1] < 20 << 20
    tracemalloc.stop()


def test_a_device_that_never_ends_is_refused() -> None:
    with pytest.raises(InputRefusedError, match="bytes"):
        read_given(Path("/dev/zero"))
