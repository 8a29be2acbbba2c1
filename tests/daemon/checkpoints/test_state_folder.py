"""The folder of a craft's state is one daemon's own: locked, and nothing is taken up that is none of its files."""

from __future__ import annotations

import base64
import hashlib
import os
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.checkpoints.files import MAGIC, Checkpoint, StateError, StateStore, encode
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.recordings.state_text import state_from_text

ONE, OTHER = CraftConfig("one"), CraftConfig("other")


def checkpoint(samples: int = 3) -> Checkpoint:
    return Checkpoint("one", "v", "c", 0.0, 0, 1, samples, 1, 0, {"a": 1})


@pytest.fixture
def store(tmp_path: Path) -> StateStore:
    return StateStore(StateConfig(tmp_path, keep=2), "one")


def newest(store: StateStore) -> list[tuple[str, str]]:
    """Each checkpoint's name, and why it is refused, empty where it is not."""
    return [(name, str(found) if isinstance(found, StateError) else "") for name, found in store.newest()]


def test_two_daemons_do_not_keep_the_same_craft_in_one_folder(tmp_path: Path) -> None:
    config = StateConfig(tmp_path)
    with Checkpoints(config, [ONE]):
        with Checkpoints(config, [OTHER]), Checkpoints(StateConfig(tmp_path / "elsewhere"), [ONE]):
            pass
        with pytest.raises(InputRefusedError, match=f"state.directory: '{tmp_path}/one' is refused; .*no other daemon"):
            Checkpoints(config, [OTHER, ONE]).__enter__()
        with Checkpoints(config, [OTHER]):  # the one before has left nothing locked
            pass
    with Checkpoints(config, [ONE]):
        pass


def test_what_another_daemon_is_writing_is_not_swept_away(tmp_path: Path, store: StateStore) -> None:
    half = store.folder / "0000000001.state.part"
    half.write_bytes(b"half")
    with store.held():
        StateStore(StateConfig(tmp_path), "one")
        assert half.exists()
    StateStore(StateConfig(tmp_path), "one")
    assert not half.exists()


def test_a_pipe_a_link_and_a_folder_are_no_checkpoints(store: StateStore, tmp_path: Path) -> None:
    """A pipe without a writer would hold the daemon for good; the one before them is taken up."""
    store.write(checkpoint())
    planted = tmp_path / "planted"
    planted.write_bytes(encode(checkpoint(99)))
    os.mkfifo(store.folder / "0000000002.state")
    (store.folder / "0000000003.state").symlink_to(planted)
    (store.folder / "0000000004.state").mkdir()
    assert newest(store) == [
        ("0000000004.state", "this is a folder, not a file"),
        ("0000000003.state", "a link, not a file"),
        ("0000000002.state", "not a file"),
        ("0000000001.state", ""),
    ]
    store.write(checkpoint(4))
    store.write(checkpoint(5))
    store.write(checkpoint(6))  # and the folder is in nobody's way
    assert [name for name, why in newest(store) if not why] == ["0000000007.state", "0000000006.state"]


@pytest.mark.parametrize(
    ("planted", "kept"),
    [
        (["9999999997"], ["9999999998", "9999999997"]),
        (["9999999998"], ["0000000002", "0000000001"]),
        (["9999999999", "9999999998"], ["0000000002", "0000000001"]),
    ],
)
def test_a_number_after_which_there_is_no_room_is_none_to_count_from(
    store: StateStore, planted: list[str], kept: list[str]
) -> None:
    """Ten digits end: what stands at the end was not written here, and is set aside rather than overtaken."""
    store.write(checkpoint(1))
    for number in planted:
        (store.folder / f"{number}.state").write_bytes(encode(checkpoint(99)))
    store.write(checkpoint(2))
    assert newest(store) == [(f"{number}.state", "") for number in kept]
    aside = [number for number in planted if number not in kept]
    assert sorted(path.stem for path in store.folder.glob("*.dropped")) == sorted(aside)


def test_a_checkpoint_that_everybody_could_have_written_is_dropped(store: StateStore) -> None:
    store.write(checkpoint())
    (store.folder / "0000000001.state").chmod(0o602)
    assert newest(store) == [("0000000001.state", "everybody can write it (mode 0602)")]


def test_a_pipe_and_a_link_are_no_named_checkpoints(store: StateStore, tmp_path: Path) -> None:
    planted = tmp_path / "planted"
    planted.write_bytes(encode(checkpoint(99)))
    os.mkfifo(store.folder / "pipe.named")
    (store.folder / "link.named").symlink_to(planted)
    store.write_named("mine", checkpoint())
    assert store.named() == ["mine"]
    for name in ("pipe", "link"):
        with pytest.raises(StateError, match=f"no checkpoint '{name}'; there are: mine"):
            store.read_named(name)


def test_a_map_whose_key_is_a_list_is_no_state(store: StateStore) -> None:
    """msgpack can say it and Python cannot hold it: a checkpoint and a recorded state alike are dropped."""
    body = b"\x81\x90\xc0"
    (store.folder / "0000000001.state").write_bytes(MAGIC + hashlib.sha256(body).digest() + body)
    assert newest(store) == [("0000000001.state", "not msgpack: unhashable type: 'list'")]
    assert state_from_text(base64.b64encode(zlib.compress(body)).decode()) is None


def test_as_many_craft_as_the_process_may_have_files_open_are_kept_or_refused_in_words(tmp_path: Path) -> None:
    """In a process of its own; the soft limit is raised where the hard one allows it."""
    code = """
import resource, sys
from pathlib import Path
from magcal_service.base.errors import InputRefusedError
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
resource.setrlimit(resource.RLIMIT_NOFILE, (64, int(sys.argv[1])))
try:
    with Checkpoints(StateConfig(Path(sys.argv[2])), [CraftConfig(f"c{number}") for number in range(100)]):
        print("kept")
except InputRefusedError as error:
    print(error)
"""

    def told(hard: int) -> str:
        run = [sys.executable, "-c", code, str(hard), str(tmp_path)]
        return subprocess.run(run, capture_output=True, text=True, check=True).stdout.strip()

    assert told(400) == "kept"
    assert told(64).endswith(
        "too many open files; a folder that can be opened is accepted; each craft takes one open file (ulimit -n)"
    )
