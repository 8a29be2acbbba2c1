"""What a daemon does with its checkpoints: each craft's own, each loss counted, told once, and never half a file."""

from __future__ import annotations

import errno
import logging
import os
import stat
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.base.version import __version__
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.checkpoints.files import (
    MAGIC,
    Checkpoint,
    StateError,
    StateStore,
    config_digest,
    decode,
    encode,
)
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import MagnetometerSample
from tests.daemon.pipeline_streams import handle_all, paper, quick_craft

ONE, OTHER = CraftConfig("one"), CraftConfig("other")
LARGEST_BYTES = 64 * 1024 * 1024


def fed(config: CraftConfig, samples: int) -> Pipeline:
    """A pipeline that has accepted so many samples."""
    pipeline = Pipeline(config)
    for number in range(samples):
        feed(pipeline, number)
    return pipeline


def feed(pipeline: Pipeline, number: int) -> None:
    """One sample more."""
    sample = MagnetometerSample(
        craft=pipeline.config.name,
        source="mag",
        sequence=number,
        time_ns=10**18 + number * 10**9,
        field_body_nt=(20_000.0 + number, -3000.0 - number, 40_000.0 - number),
    )
    pipeline.handle(sample)


def accepted(pipeline: Pipeline) -> int:
    return pipeline.ticks.counters["accepted"]


def counters(store: Checkpoints) -> dict[str, int]:
    """Its counters, without the bytes."""
    return {name: count for name, count in store.counters.items() if count and name != "state.bytes"}


@pytest.fixture
def store(tmp_path: Path) -> Checkpoints:
    return Checkpoints(StateConfig(tmp_path), [ONE, OTHER])


def test_a_craft_without_new_samples_does_not_keep_the_next_one_from_being_written(
    store: Checkpoints, tmp_path: Path
) -> None:
    one, other = fed(ONE, 3), fed(OTHER, 3)
    store.save([one, other])
    feed(other, 3)
    store.save([one, other])
    written = {name: sorted(path.name for path in (tmp_path / name).iterdir()) for name in ("one", "other")}
    assert written == {"one": ["0000000001.state"], "other": ["0000000001.state", "0000000002.state"]}


def test_a_craft_whose_disk_fails_does_not_keep_the_next_one_from_being_written(
    store: Checkpoints, tmp_path: Path
) -> None:
    (tmp_path / "one").rmdir()
    (tmp_path / "one").write_text("")
    one, other = fed(ONE, 3), fed(OTHER, 3)
    store.save([one, other])
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["0000000001.state"]
    assert counters(store) == {"state.failed": 1, "state.writes": 1}


def test_what_failed_is_tried_again_without_a_new_sample_and_the_trouble_ends(
    store: Checkpoints, tmp_path: Path
) -> None:
    (tmp_path / "one").rmdir()
    (tmp_path / "one").write_text("")
    one = fed(ONE, 3)
    store.save([one])
    assert store.trouble == "a part of this path is a file, not a folder"
    (tmp_path / "one").unlink()
    (tmp_path / "one").mkdir()
    store.save([one])
    assert (store.trouble, counters(store)) == ("", {"state.failed": 1, "state.writes": 1})


def test_the_same_trouble_is_logged_once(
    store: Checkpoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """And each other trouble once more, one without the system's words by its own."""
    failures = [OSError(errno.ENOSPC, "No space left"), OSError(errno.ENOSPC, "No space left"), OSError("odd")]

    def write(store: StateStore, checkpoint: Checkpoint) -> None:
        raise failures.pop(0)

    monkeypatch.setattr(StateStore, "write", write)
    one = fed(ONE, 1)
    with caplog.at_level(logging.ERROR, "magcal"):
        for _ in range(3):
            store.save([one])
    said = [record.getMessage() for record in caplog.records]
    assert [text.rpartition(": ")[2].partition(";")[0] for text in said] == ["no space is left on the disk", "odd"]
    assert all("the one before is kept, the next is tried when it is due" in text for text in said)
    assert counters(store) == {"state.failed": 3}


def test_a_save_counts_its_writes_and_bytes_and_nothing_else(store: Checkpoints, tmp_path: Path) -> None:
    store.save([fed(ONE, 2), fed(OTHER, 3)])
    assert store.save_named(fed(ONE, 4), "kept") == ""
    on_disk = sum(path.stat().st_size for path in tmp_path.rglob("*.*"))
    assert counters(store) == {"state.writes": 3}
    assert store.counters["state.bytes"] == on_disk


def test_sums_of_writes_go_on_over_a_restart(store: Checkpoints, tmp_path: Path) -> None:
    """The one that a checkpoint holds counts itself; a restart counts what it took up, and nothing as dropped."""
    one = fed(ONE, 1)
    for number in range(1, 4):
        store.save([one])
        feed(one, number)
    again = Checkpoints(StateConfig(tmp_path), [ONE, OTHER])
    restored, events = again.restore(Pipeline(ONE))
    assert (accepted(restored), [event.what for event in events]) == (3, ["restored"])
    assert events[0].cause == "checkpoint 0000000003.state of 3 samples"
    assert counters(again) == {"state.restored": 1, "state.writes": 3}
    assert again.counters["state.bytes"] == store.counters["state.bytes"]


def test_every_checkpoint_that_is_passed_over_is_counted_and_told(store: Checkpoints, tmp_path: Path) -> None:
    one = fed(ONE, 1)
    for number in range(1, 4):
        store.save([one])
        feed(one, number)
    for number in (2, 3):
        (tmp_path / "one" / f"{number:010d}.state").write_bytes(b"")
    again = Checkpoints(StateConfig(tmp_path), [ONE])
    restored, events = again.restore(Pipeline(ONE))
    assert accepted(restored) == 1
    assert [event.what for event in events] == ["state_dropped", "state_dropped", "restored"]
    assert counters(again) == {"state.restored": 1, "state.dropped": 2, "state.writes": 1}


def test_a_state_that_does_not_fit_the_pipeline_is_dropped_like_a_damaged_one(
    store: Checkpoints, tmp_path: Path
) -> None:
    one = fed(ONE, 2)
    store.save([one])
    written = decode((tmp_path / "one" / "0000000001.state").read_bytes())
    spoilt = replace(written, state=written.state | {"estimator": {}})
    (tmp_path / "one" / "0000000002.state").write_bytes(encode(spoilt))
    restored, events = Checkpoints(StateConfig(tmp_path), [ONE]).restore(Pipeline(ONE))
    assert (accepted(restored), [event.what for event in events]) == (2, ["state_dropped", "restored"])
    assert events[0].cause.startswith("checkpoint 0000000002.state: ")
    assert "map" in events[0].cause


@pytest.mark.parametrize("damaged", [False, True])
def test_the_search_goes_on_after_a_damaged_checkpoint_and_ends_at_another_configurations(
    tmp_path: Path, damaged: bool
) -> None:
    """Own, another's, and above them nothing or one that is damaged: the older own one is not restored."""
    other = replace(ONE, filter=replace(ONE.filter, gate_sigma=5.0))
    for config, samples in ((ONE, 3), (other, 4)):
        Checkpoints(StateConfig(tmp_path), [config]).save([fed(config, samples)])
    if damaged:
        (tmp_path / "one" / "0000000003.state").write_bytes(b"damaged")
    store, given = Checkpoints(StateConfig(tmp_path), [ONE]), Pipeline(ONE)
    restored, events = store.restore(given)
    assert restored is given
    dropped = ["0000000003.state"] * damaged + ["0000000002.state"]
    assert [(event.what, event.cause.split(":")[0]) for event in events] == [
        ("state_dropped", f"checkpoint {name}") for name in dropped
    ]
    assert counters(store)["state.dropped"] == len(dropped)
    assert "configuration is" in events[-1].cause
    (tmp_path / "one" / "0000000002.state").write_bytes(b"damaged")
    assert Checkpoints(StateConfig(tmp_path), [ONE]).restore(given)[0].ticks.counters["accepted"] == 3


def test_an_empty_folder_leaves_the_pipeline_as_it_is(store: Checkpoints) -> None:
    given = Pipeline(ONE)
    restored, events = store.restore(given)
    assert (restored is given, events, counters(store)) == (True, [], {})


def test_a_roll_back_puts_the_estimate_back_and_says_nothing(tmp_path: Path) -> None:
    flight = list(paper(11, 60.0).messages())
    pipeline = Pipeline(quick_craft())
    store = Checkpoints(StateConfig(tmp_path), [pipeline.config])
    handle_all(pipeline, flight[:20])
    assert store.save_named(pipeline, "before") == ""
    before = repr(pipeline.export_state()["estimator"])
    handle_all(pipeline, flight[20:])
    assert repr(pipeline.export_state()["estimator"]) != before
    assert store.restore_estimate(pipeline, "before") == ""
    assert repr(pipeline.export_state()["estimator"]) == before


def test_a_roll_back_to_another_configurations_checkpoint_is_refused_and_changes_nothing(
    store: Checkpoints, tmp_path: Path
) -> None:
    store.save_named(fed(ONE, 5), "before")
    other = replace(ONE, filter=replace(ONE.filter, gate_sigma=5.0))
    pipeline = fed(other, 8)
    state = repr(pipeline.export_state())
    told = Checkpoints(StateConfig(tmp_path), [other]).restore_estimate(pipeline, "before")
    digests = [config_digest(config)[:12] for config in (ONE, other)]
    assert told == f"checkpoint 'before': configuration is {digests[0]}, not {digests[1]}"
    assert repr(pipeline.export_state()) == state


def test_a_roll_back_to_what_is_not_there_says_so(store: Checkpoints) -> None:
    told = store.restore_estimate(fed(ONE, 1), "before")
    assert told == "checkpoint 'before': no checkpoint 'before'; there are: none"


def test_a_named_checkpoint_that_cannot_be_written_is_told_and_counted(store: Checkpoints, tmp_path: Path) -> None:
    (tmp_path / "one").rmdir()
    (tmp_path / "one").write_text("")
    assert store.save_named(fed(ONE, 1), "kept") == "not written: a part of this path is a file, not a folder"
    assert counters(store) == {"state.failed": 1}
    assert "name 'a b' is refused" in store.save_named(fed(OTHER, 1), "a b")
    assert counters(store) == {"state.failed": 1}


# Files


def checkpoint() -> Checkpoint:
    """One whose state has keys that are no text."""
    state = {"levels": {1: 0.5, 9: 2.5}}
    return Checkpoint("one", __version__, config_digest(ONE), 1.5, 1, 2, 7, 1, 0, state)


def test_a_state_may_have_keys_that_are_no_text() -> None:
    assert decode(encode(checkpoint())) == checkpoint()


def test_every_mark_of_another_owner_is_told_with_both_values() -> None:
    foreign = replace(checkpoint(), craft="two", version="0.0.1", config="0123456789abcdef" * 4)
    own = config_digest(ONE)[:12]
    assert foreign.refusal(ONE) == (
        f"craft is two, not one; version is 0.0.1, not {__version__}; configuration is 0123456789ab, not {own}"
    )


def test_configurations_that_differ_in_nothing_have_one_digest() -> None:
    assert config_digest(CraftConfig("one")) == config_digest(ONE)
    assert len(config_digest(ONE)) == 64


@pytest.mark.parametrize(
    ("size", "told"), [(LARGEST_BYTES, "damaged"), (LARGEST_BYTES + 1, f"larger than {LARGEST_BYTES} bytes")]
)
def test_a_file_beyond_64_mib_is_not_read(tmp_path: Path, size: int, told: str) -> None:
    store = StateStore(StateConfig(tmp_path), "one")
    path = store.folder / "huge.named"
    path.write_bytes(MAGIC)
    os.truncate(path, size)
    with pytest.raises(StateError, match=told):
        store.read_named("huge")


def test_a_checkpoint_that_the_disk_does_not_give_is_an_error_of_its_own(tmp_path: Path) -> None:
    store = StateStore(StateConfig(tmp_path), "one")
    (store.folder / "0000000001.state").mkdir()
    ((name, found),) = store.newest()
    assert (name, str(found)) == ("0000000001.state", "this is a folder, not a file")


def test_a_folder_that_is_refused_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefusedError) as refused:
        StateStore(StateConfig(tmp_path / "file"), "one")
    (fault,) = refused.value.faults
    assert str(fault).startswith(f"{tmp_path / 'file' / 'one'}: a part of this path is a file, not a folder; ")


def test_a_checkpoint_is_on_the_disk_before_its_name_and_the_name_before_it_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is synchronised whole, then renamed, then its folder is synchronised; nothing stays open."""
    store = StateStore(StateConfig(tmp_path), "one")
    done: list[str] = []

    def fsync(descriptor: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        done.append("folder" if is_folder else f"file {os.fstat(descriptor).st_size}")
        assert bool(store.numbered()) == is_folder
        assert store.writes == 0

    monkeypatch.setattr(os, "fsync", fsync)
    open_before = len(os.listdir("/proc/self/fd"))
    store.write(checkpoint())
    assert done == [f"file {len(encode(checkpoint()))}", "folder"]
    assert (store.writes, store.written_bytes) == (1, len(encode(checkpoint())))
    assert len(os.listdir("/proc/self/fd")) == open_before


def test_bytes_written_before_a_restart_are_those_of_the_newest_and_all_before_it(tmp_path: Path) -> None:
    store = StateStore(StateConfig(tmp_path), "one")
    for _ in range(3):
        store.write(replace(checkpoint(), writes=store.writes + 1, written_bytes=store.written_bytes))
    sizes = [path.stat().st_size for path in store.numbered()]
    (store.folder / "0000000003.state").write_bytes(b"damaged")
    again = StateStore(StateConfig(tmp_path), "one")
    found = [isinstance(found, Checkpoint) for _, found in again.newest()]
    assert found == [False, True, True]
    assert (again.writes, again.written_bytes) == (2, sizes[1] + sizes[2])
