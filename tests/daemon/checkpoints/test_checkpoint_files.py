"""Checkpoint files: whole or not there, known by their owner's marks, read without trust."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import msgpack
import pytest

from magcal_service.base.errors import ConfigError, InputRefusedError
from magcal_service.base.version import __version__
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import default_craft
from magcal_service.daemon.checkpoints.files import (
    MAGIC,
    SCHEMA,
    SIGNED_MAGIC,
    Checkpoint,
    StateError,
    StateStore,
    config_digest,
    decode,
    encode,
)
from magcal_service.daemon.pipeline import Pipeline

CRAFT = default_craft("demo")


def checkpoint(samples: int = 7) -> Checkpoint:
    """A checkpoint of a craft that has seen nothing."""
    return Checkpoint(
        craft="demo",
        version=__version__,
        config=config_digest(CRAFT),
        written_s=1.5,
        first_time_ns=1,
        last_time_ns=2,
        samples=samples,
        writes=1,
        written_bytes=0,
        state=Pipeline(CRAFT).export_state(),
    )


@pytest.fixture
def store(tmp_path: Path) -> StateStore:
    return StateStore(StateConfig(tmp_path / "state", keep=3), "demo")


def test_what_is_written_comes_back() -> None:
    assert decode(encode(checkpoint())) == checkpoint()


KEY = bytes(range(32))


@pytest.mark.parametrize(
    ("written", "read", "why"),
    [
        (KEY, None, "signed, and no key is configured"),
        (None, KEY, "not signed, and a key is configured"),
        (KEY, KEY[::-1], "damaged or forged: the signature of its"),
    ],
)
def test_a_checkpoint_is_restored_with_the_key_that_signed_it_alone(
    written: bytes | None, read: bytes | None, why: str
) -> None:
    assert decode(encode(checkpoint(), written), written) == checkpoint()
    with pytest.raises(StateError, match=why):
        decode(encode(checkpoint(), written), read)


def test_a_signed_checkpoint_notices_every_changed_byte() -> None:
    raw = encode(checkpoint(), KEY)
    for place in (*range(len(SIGNED_MAGIC) + 32), len(raw) // 2, len(raw) - 1):
        spoiled = bytearray(raw)
        spoiled[place] ^= 1
        with pytest.raises(StateError):
            decode(bytes(spoiled), KEY)


def test_a_store_signs_with_the_key_of_a_file_that_is_its_owners_alone(tmp_path: Path) -> None:
    """A plain checkpoint that somebody put there is dropped, and the signed one before it is restored."""
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o644)
    config = StateConfig(tmp_path / "state", keep=3, key=key)
    with pytest.raises(ConfigError, match="its owner alone"):
        StateStore(config, "demo")
    key.chmod(0o600)
    signed = StateStore(config, "demo")
    signed.write(checkpoint(7))
    StateStore(replace(config, key=None), "demo").write(checkpoint(9))
    (_, planted), (_, own) = signed.newest()
    assert str(planted) == "not signed, and a key is configured"
    assert isinstance(own, Checkpoint)
    assert own.samples == 7


def test_every_changed_byte_is_noticed() -> None:
    """A bit flipped at every 97th place, and every one of the head."""
    raw = encode(checkpoint())
    for place in (*range(len(MAGIC) + 32), *range(len(MAGIC) + 32, len(raw), 97)):
        spoiled = bytearray(raw)
        spoiled[place] ^= 1 << (place % 8)
        with pytest.raises(StateError):
            decode(bytes(spoiled))


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_file_cut_off_anywhere_is_refused(share: float) -> None:
    raw = encode(checkpoint())
    with pytest.raises(StateError):
        decode(raw[: int(share * len(raw))])


@pytest.mark.parametrize("name", SCHEMA)
@pytest.mark.parametrize("value", [None, [], "text", -1.0])
def test_content_of_another_type_is_refused_by_name(name: str, value: object) -> None:
    content = {key: getattr(checkpoint(), key) for key in SCHEMA} | {name: value}
    if type(value) is SCHEMA[name]:
        return
    with pytest.raises(StateError, match=name):
        decode(sealed(msgpack.packb(content)))


def sealed(body: bytes) -> bytes:
    """A file with the right checksum of any content."""
    import hashlib

    return MAGIC + hashlib.sha256(body).digest() + body


@pytest.mark.parametrize("body", [b"", b"\xc1", b"\x90", b"\x81\xa1a\x01", b"\xdd\xff\xff\xff\xff", b"\x91" * 5000])
def test_any_content_with_the_right_checksum_is_read_without_harm(body: bytes) -> None:
    with pytest.raises(StateError):
        decode(sealed(body))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"craft": "other"}, "craft is other, not demo"),
        ({"version": "0.0.1"}, "version is 0.0.1"),
        ({"config": "0" * 64}, "configuration is 000000000000"),
    ],
)
def test_a_checkpoint_of_another_owner_says_whose_it_is(change: dict[str, str], told: str) -> None:
    assert told in replace(checkpoint(), **change).refusal(CRAFT)
    assert checkpoint().refusal(CRAFT) == ""


def test_any_setting_of_the_craft_changes_its_digest() -> None:
    other = replace(CRAFT, trust=replace(CRAFT.trust, min_ticks=301))
    assert config_digest(other) != config_digest(CRAFT)


def test_as_many_are_kept_as_asked_for_and_the_newest_comes_first(store: StateStore) -> None:
    for samples in range(7):
        store.write(checkpoint(samples))
    found = [one.samples for _, one in store.newest() if isinstance(one, Checkpoint)]
    assert (found, [path.name for path in store.numbered()]) == (
        [6, 5, 4],
        ["0000000007.state", "0000000006.state", "0000000005.state"],
    )


def test_writes_and_bytes_are_counted_over_restarts(store: StateStore, tmp_path: Path) -> None:
    """Each checkpoint carries the sums of those before it, so that they outlive the files."""
    for _ in range(5):
        store.write(replace(checkpoint(), writes=store.writes + 1, written_bytes=store.written_bytes))
    other = StateStore(StateConfig(tmp_path / "state"), "demo")
    next(iter(other.newest()))
    assert (other.writes, other.written_bytes) == (5, store.written_bytes)


def test_a_half_written_one_is_removed_at_the_next_start(store: StateStore, tmp_path: Path) -> None:
    part = store.folder / "0000000001.part"
    part.write_bytes(b"half")
    StateStore(StateConfig(tmp_path / "state"), "demo")
    assert not part.exists()


def test_nobody_else_can_read_them(store: StateStore) -> None:
    store.write(checkpoint())
    assert (store.folder.stat().st_mode & 0o077, store.numbered()[0].stat().st_mode & 0o077) == (0, 0)


def test_a_disk_without_room_leaves_what_was_there(store: StateStore, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(checkpoint(1))

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        store.write(checkpoint(2))
    assert [path.name for path in store.folder.iterdir()] == ["0000000001.state"]


def test_named_ones_stay_and_are_bounded(store: StateStore) -> None:
    for number in range(16):
        store.write_named(f"n{number}", checkpoint(number))
    store.write_named("n3", checkpoint(99))
    assert store.read_named("n3").samples == 99
    with pytest.raises(StateError, match="16 named checkpoints"):
        store.write_named("n16", checkpoint())


@pytest.mark.parametrize("name", ["", "a/b", "..", "a" * 33, "a b", "ä"])
def test_a_name_that_could_leave_the_folder_is_refused(store: StateStore, name: str) -> None:
    with pytest.raises(StateError, match="is refused"):
        store.write_named(name, checkpoint())


def test_a_name_that_is_not_there_is_told_with_those_that_are(store: StateStore) -> None:
    store.write_named("before", checkpoint())
    with pytest.raises(StateError, match="no checkpoint 'after'; there are: before"):
        store.read_named("after")


def test_a_folder_that_cannot_be_made_is_refused_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefusedError, match="file/state"):
        StateStore(StateConfig(tmp_path / "file" / "state"), "demo")
