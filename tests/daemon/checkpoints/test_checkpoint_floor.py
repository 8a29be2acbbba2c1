"""An older signed checkpoint that is put in place of the newest is not taken up, wherever a daemon was killed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.reader import load_config
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.checkpoints.files import Checkpoint, StateStore
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.run import check_directories
from tests.daemon.checkpoints.test_checkpoint_files import KEY, checkpoint

CRAFT = CraftConfig("demo")


class Killed(BaseException):
    """The process ends here."""


@pytest.fixture
def config(tmp_path: Path) -> StateConfig:
    key = tmp_path / "key"
    key.touch(mode=0o600)
    key.write_text(KEY.hex())
    return StateConfig(tmp_path / "state", keep=3, key=key, counters=tmp_path / "elsewhere")


def started(config: StateConfig) -> tuple[StateStore, int]:
    """A store as a daemon opens it, and the samples of the checkpoint that it takes up; 0 where it takes up none."""
    store = StateStore(config, CRAFT.name)
    found = next((one.samples for _, one in store.newest() if isinstance(one, Checkpoint)), 0)
    return store, found


def write(store: StateStore, samples: int) -> None:
    store.write(replace(checkpoint(samples), writes=store.writes + 1))


def files(store: StateStore) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in store.numbered()}


def put(store: StateStore, found: dict[str, bytes]) -> None:
    """Put these files in place of all that are there."""
    for path in store.numbered():
        path.unlink()
    for name, raw in found.items():
        (store.folder / name).write_bytes(raw)


def test_an_older_one_under_a_newer_name_gives_way_to_the_newest(config: StateConfig) -> None:
    store, _ = started(config)
    write(store, 1)
    old = files(store)["0000000001.state"]
    for samples in range(2, 6):
        write(store, samples)
    (store.folder / "0000000099.state").write_bytes(old)
    (_, played), (_, own) = list(StateStore(config, "demo").newest())[:2]
    assert str(played) == "older than the newest: its number is 1, 4 or more is accepted"
    assert isinstance(own, Checkpoint)
    assert own.samples == 5
    (_, believed), *_ = StateStore(replace(config, counters=None), "demo").newest()
    assert isinstance(believed, Checkpoint)  # as it is without the folder
    assert believed.samples == 1


def test_a_folder_of_old_ones_begins_anew_and_what_is_written_then_is_believed(config: StateConfig) -> None:
    store, _ = started(config)
    write(store, 1)
    old = files(store)
    for samples in range(2, 6):
        write(store, samples)
    put(store, old)
    with Checkpoints(config, [CRAFT]) as checkpoints:
        _, (event,) = checkpoints.restore(Pipeline(CRAFT))
        assert (event.what, checkpoints.counters["state.dropped"]) == ("state_dropped", 1)
        assert "older than the newest" in event.cause
    store, _ = started(config)
    write(store, 7)
    assert started(config)[1] == 7


def test_a_damaged_newest_gives_way_to_the_one_before_it_and_to_no_older_one(config: StateConfig) -> None:
    store, _ = started(config)
    for samples in range(1, 6):
        write(store, samples)
    third, second, newest = sorted(files(store))
    (store.folder / newest).write_bytes(b"damaged")
    assert started(config)[1] == 4
    (store.folder / second).write_bytes(b"damaged")
    assert (third, started(config)[1]) == ("0000000003.state", 0)


def test_a_daemon_killed_at_any_step_finds_its_newest_whole_checkpoint(
    config: StateConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each call that the disk sees, over four checkpoints and the start of the next daemon."""
    steps = 0

    def step(call):
        def counted(*arguments, **named):
            nonlocal steps
            steps -= 1
            if steps == 0:
                raise Killed
            return call(*arguments, **named)

        return counted

    for name in ("replace", "fsync"):
        monkeypatch.setattr(os, name, step(getattr(os, name)))
    written = 0
    for kill_at in range(1, 30):
        store, found = started(config)
        assert found in (written, written + 1)  # the one under way was whole, or was not there yet
        written, steps = found, kill_at
        try:
            for samples in range(written + 1, written + 5):
                write(store, samples)
                written = samples
        except Killed:
            pass
        steps = 0
    assert written > 50


def test_a_damaged_counter_is_told_and_the_next_checkpoint_believed(config: StateConfig) -> None:
    store, _ = started(config)
    write(store, 1)
    write(store, 2)
    (counter,) = (config.counters or Path()).iterdir()
    counter.write_bytes(b"magcal counter 1 00000000\n")
    store = StateStore(config, "demo")
    assert {str(one) for _, one in store.newest()} == {
        f"{counter} is damaged, so it may be an old one that was played again"
    }
    write(store, 3)
    write(store, 4)
    assert started(config)[1] == 4


def test_a_folder_without_a_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text('version = 1\n[[craft]]\nname = "a"\n[state]\ndirectory = "state"\ncounters = "c"\n')
    with pytest.raises(ConfigError, match=r"counters: .* together with their key"):
        load_config(path)


@pytest.mark.parametrize("place", ["state", "state/demo", "state/../state/c", "link"])
def test_a_folder_within_that_of_the_checkpoints_is_refused(config: StateConfig, tmp_path: Path, place: str) -> None:
    config.directory.mkdir()
    (tmp_path / "link").symlink_to(config.directory)
    with pytest.raises(ConfigError, match=f"a folder outside {config.directory} is accepted"):
        check_directories(Config(crafts=(CRAFT,), state=replace(config, counters=tmp_path / place)))
