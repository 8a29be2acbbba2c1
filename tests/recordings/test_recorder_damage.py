"""Damage within a recording costs the chunk that it touches: reading goes on behind it, and what is gone is counted."""

from __future__ import annotations

import io
import random
import struct
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from magcal_service.cli.__main__ import main
from magcal_service.recordings.mcap import DROPPED, MOST_MISSING, RawMessage
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.session import read_session
from magcal_service.recordings.session_arrays import session_recording
from magcal_service.recordings.session_file import SessionFile
from magcal_service.recordings.session_files import SessionFolder, recover
from magcal_service.recordings.session_info import session_info
from tests.recordings.sessions import craft, stream

SAMPLES = stream(300)
CASES = Path(__file__).parents[3] / "shared/cases/recover-hole"
CHUNKS = 10
IN_CHUNK = len(SAMPLES) // CHUNKS


def _session(folder: Path, name: str = "whole") -> bytes:
    path, file = SessionFolder(folder).create(0)
    session = SessionFile(path, file, {"session": name}, {"paper": craft()})
    for number, message in enumerate(SAMPLES, 1):
        session.add(number, message)
        if number % IN_CHUNK == 0:
            session.flush()
    session.close()
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound session file of ten chunks."""
    return _session(tmp_path_factory.mktemp("whole"))


def read(content: bytes) -> tuple[McapReader, list[RawMessage]]:
    reader = McapReader(io.BytesIO(content), "file")
    return reader, list(reader.messages())


def chunks(content: bytes) -> list[ChunkIndex]:
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def zeroed(content: bytes, begin: int, end: int) -> bytes:
    return content[:begin] + bytes(end - begin) + content[end:]


def without(messages: list[RawMessage], *gone: int) -> list[RawMessage]:
    """The messages of a file but for those of some chunks."""
    return [raw for number, raw in enumerate(messages) if number // IN_CHUNK not in gone]


def test_a_hole_costs_the_chunks_that_it_touches_and_none_behind(whole: bytes) -> None:
    """Zeros over a chunk's head, an end of one and the head of the next, a whole one: reading finds the one behind."""
    _, before = read(whole)
    index = chunks(whole)
    third, fourth = index[2], index[3]
    holes = {
        (2,): (third.chunk_start_offset, third.chunk_start_offset + 20),
        (2, 3): (third.chunk_start_offset + third.chunk_length - 9, fourth.chunk_start_offset + 9),
        (3,): (fourth.chunk_start_offset - 4, fourth.chunk_start_offset + fourth.chunk_length),
    }
    for gone, (begin, end) in holes.items():
        reader, found = read(zeroed(whole, begin, end))
        assert found == without(before, *gone)
        assert (reader.sound, reader.undamaged) == (False, False)
        assert (reader.gone, reader.all_gone_known) == (len(gone) * IN_CHUNK, True)
        lost = reader.size - reader.good_bytes
        assert end - begin <= lost <= sum(index[number].chunk_length + IN_CHUNK * 20 for number in gone)


@pytest.mark.parametrize("length", [0, 8, 1000, 1 << 25, 1 << 63])
def test_a_chunk_whose_length_is_spoilt_is_read_by_the_other_one(whole: bytes, length: int) -> None:
    """A chunk's length stands in its head twice, and the checksum says which is right."""
    _, before = read(whole)
    place = chunks(whole)[4].chunk_start_offset
    for at in (place + 1, place + 45):
        reader, found = read(whole[:at] + struct.pack("<Q", length) + whole[at + 8 :])
        assert found == before
        assert (reader.sound, reader.gone) == (False, 0)
        assert reader.damage == "the length of a chunk is spoilt"


def test_a_flipped_bit_costs_one_chunk_at_most_and_makes_no_message(whole: bytes) -> None:
    _, before = read(whole)
    wanted = {raw.data for raw in before}
    draw = random.Random(4)
    for _ in range(400):
        place, bit = draw.randrange(8, len(whole)), draw.randrange(8)
        spoilt = bytearray(whole)
        spoilt[place] ^= 1 << bit
        reader, found = read(bytes(spoilt))
        assert {raw.data for raw in found} <= wanted
        assert len(found) >= len(before) - IN_CHUNK
        assert not reader.sound or found == before


def test_a_bit_that_makes_a_message_of_a_channel_in_the_summary_makes_none(whole: bytes) -> None:
    summary = whole.rindex(b"/magcal/paper/magnetometer") - 4 - 2 - 2 - 9
    assert whole[summary] == 4
    reader, found = read(whole[:summary] + b"\x05" + whole[summary + 1 :])
    assert found == read(whole)[1]
    assert reader.damage == "its summary is spoilt"


def test_bytes_behind_the_end_are_not_sound(whole: bytes) -> None:
    for behind in (b"\0", bytes(4096), b"more of something"):
        reader, found = read(whole + behind)
        assert found == read(whole)[1]
        assert (reader.sound, reader.damage) == (False, f"{len(behind)} bytes follow its end")
        assert reader.size - reader.good_bytes == len(behind)


def test_two_files_in_one_are_both_read_and_not_sound(whole: bytes, tmp_path: Path) -> None:
    """Each has channel numbers of its own; ``record join`` makes a file of them that is sound."""
    reader, found = read(whole + _session(tmp_path, "other"))
    assert found == 2 * read(whole)[1]
    assert (reader.sound, reader.damage, reader.gone) == (False, "another file follows its end", 0)


def test_the_places_tried_behind_damage_are_bounded(whole: bytes) -> None:
    """A file that says at every few bytes that a chunk begins there, each as long as all the rest."""
    lure = b"\x06" + struct.pack("<Q", 1 << 20) + bytes(28) + b"\x04\0\0\0zstd" + struct.pack("<Q", (1 << 20) - 48)
    content = whole[: chunks(whole)[1].chunk_start_offset] + b"\xff" + lure * 40_000
    reader, found = read(content)
    assert found == read(whole)[1][:IN_CHUNK]
    assert not reader.sound


def test_a_recovered_file_says_what_is_gone_and_the_command_ends_with_three(
    whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    index, path = chunks(whole)[5], tmp_path / "hole.mcap"
    path.write_bytes(zeroed(whole, index.chunk_start_offset + 30, index.chunk_start_offset + 60))
    assert main(["record", "recover", str(path), "--out", str(tmp_path / "out.mcap")]) == 3
    assert f"{len(SAMPLES) - IN_CHUNK} records of hole.mcap recovered, {IN_CHUNK} gone, " in capsys.readouterr().out
    reader, found = read((tmp_path / "out.mcap").read_bytes())
    assert reader.sound
    assert found == without(read(whole)[1], 5)
    assert [content["messages"] for name, content in reader.metadata if name == DROPPED] == [str(IN_CHUNK)]


def test_a_file_that_only_lacks_its_end_is_recovered_with_nothing_gone(whole: bytes, tmp_path: Path) -> None:
    """What a daemon leaves that was killed between two chunks is no damage."""
    path = tmp_path / "killed.mcap"
    path.write_bytes(whole[: chunks(whole)[7].chunk_start_offset])
    assert main(["record", "recover", str(path), "--out", str(tmp_path / "out.mcap")]) == 0
    recovered = recover(path, tmp_path / "again.mcap")
    assert (recovered.undamaged, recovered.messages, recovered.gone) == (True, 7 * IN_CHUNK, 0)


@pytest.mark.skipif(not CASES.is_dir(), reason="the recorded cases are not here")
@pytest.mark.parametrize(("name", "kept", "lost_bytes"), [("hole", 2905, 363_588), ("chunk-length", 4802, 0)])
def test_a_recorded_case_loses_what_the_damage_touches_alone(
    name: str, kept: int, lost_bytes: int, tmp_path: Path
) -> None:
    """Of 4802 records in three chunks: zeros within the second one, and a length of it that is spoilt."""
    recovered = recover(CASES / f"{name}.mcap", tmp_path / "out.mcap")
    assert (recovered.messages, recovered.gone, recovered.all_known) == (kept, 4802 - kept, True)
    assert (recovered.lost_bytes, recovered.undamaged) == (lost_bytes, False)
    assert session_info(tmp_path / "out.mcap").sound


def test_what_is_gone_is_said_by_a_replay_and_a_count_of_none_is_believed(whole: bytes, tmp_path: Path) -> None:
    """As messages that were not recorded; a hostile summary cannot make it more than any file has."""
    index, path = chunks(whole)[5], tmp_path / "hole.mcap"
    path.write_bytes(zeroed(whole, index.chunk_start_offset + 30, index.chunk_start_offset + 60))
    session = read_session(path)
    assert (session.dropped, "1 chunks" in session.damage) == (IN_CHUNK, True)
    lying = tmp_path / "lying.mcap"
    with lying.open("wb", buffering=0) as file:
        writer = McapWriter(file, "test")
        for name, content in read(whole)[0].metadata:
            writer.add_metadata(name, content)
        for raw in read(whole)[1][:IN_CHUNK]:
            writer.add(raw)
        writer.end_chunk()
        writer.messages = (1 << 64) - 1
        for _ in range(20):
            writer.add_metadata(DROPPED, {"messages": "9" * 18})
        writer.finish()
    assert read_session(lying).dropped == MOST_MISSING
    assert session_recording(lying).report.entries
