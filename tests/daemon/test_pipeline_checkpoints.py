"""A craft taken up from its checkpoint goes on as if nothing had happened; one that does not fit is dropped."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magcal_service.base.snapshot import SnapshotError
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import CraftConfig, FilterConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Estimate, Message
from tests.daemon.pipeline_streams import handle_all, paper, paper_craft

SECONDS = 900


def craft(method: str = "ukf", **settings: Any) -> CraftConfig:
    return paper_craft(filter=FilterConfig(method=method, **settings))


def messages(first_s: int, end_s: int) -> list[Message]:
    return list(paper(11, SECONDS).messages())[2 * first_s : 2 * end_s]


def checkpoints(folder: Path, config: CraftConfig) -> Checkpoints:
    return Checkpoints(StateConfig(folder), [config])


@pytest.mark.parametrize("method", ["ukf", "spin"])
@pytest.mark.parametrize("seconds", [50, 700])
def test_all_that_is_published_after_a_restart_is_the_same(method: str, seconds: int, tmp_path: Path) -> None:
    """Vectors and estimates, bit for bit: from the midst of the start and from a running filter."""
    config = craft(method, adaptive=method == "ukf")
    whole = Pipeline(config)
    handle_all(whole, messages(0, seconds))
    checkpoints(tmp_path, config).save([whole])
    restored, events = checkpoints(tmp_path, config).restore(Pipeline(config))
    assert [event.what for event in events] == ["restored"]
    assert handle_all(restored, messages(seconds, SECONDS)) == handle_all(whole, messages(seconds, SECONDS))


def test_samples_that_a_node_sends_again_are_known(tmp_path: Path) -> None:
    """Killed 200 s after its checkpoint, restarted, sent the last 220 s again: none lost, none twice."""
    config = craft()
    whole, before = Pipeline(config), Pipeline(config)
    handle_all(before, messages(0, 700))
    checkpoints(tmp_path, config).save([before])
    handle_all(whole, messages(0, SECONDS))
    restored, _ = checkpoints(tmp_path, config).restore(Pipeline(config))
    handle_all(restored, messages(680, SECONDS))
    np.testing.assert_array_equal(restored.estimator.estimate().x, whole.estimator.estimate().x)
    assert (restored.ticks.counters["accepted"], restored.ticks.counters["doubled"]) == (SECONDS, 20)


def test_without_those_samples_the_estimate_stays_within_half_a_sigma(tmp_path: Path) -> None:
    """After 50 minutes 60 s to the kill and 20 s of outage are lost: at the next tick, and a period later."""
    config, flight = craft(), list(paper(11, 3142).messages())
    whole = Pipeline(config)
    handle_all(whole, flight[:6000])
    checkpoints(tmp_path, config).save([whole])
    restored, _ = checkpoints(tmp_path, config).restore(Pipeline(config))
    handle_all(whole, flight[6000:6160])
    for begin, end in ((6160, 6164), (6164, 6284)):
        handle_all(whole, flight[begin:end])
        handle_all(restored, flight[begin:end])
        one, other = whole.estimator.estimate(), restored.estimator.estimate()
        assert np.all(np.abs(one.x - other.x) < 0.5 * np.sqrt(np.diagonal(one.covariance)))


def test_a_damaged_checkpoint_gives_way_to_the_one_before(tmp_path: Path) -> None:
    config = craft()
    pipeline = Pipeline(config)
    store = checkpoints(tmp_path, config)
    for begin in (0, 300):
        handle_all(pipeline, messages(begin, begin + 300))
        store.save([pipeline])
    newest = max((tmp_path / "paper").iterdir())
    newest.write_bytes(newest.read_bytes()[:-1000])
    restored, events = checkpoints(tmp_path, config).restore(Pipeline(config))
    assert [event.what for event in events] == ["state_dropped", "restored"]
    assert "damaged" in events[0].cause
    assert restored.ticks.counters["accepted"] == 300


def test_another_configuration_drops_the_state_and_says_so(tmp_path: Path) -> None:
    config = craft()
    pipeline = Pipeline(config)
    handle_all(pipeline, messages(0, 300))
    checkpoints(tmp_path, config).save([pipeline])
    other = replace(config, filter=replace(config.filter, gate_sigma=5.0))
    store = checkpoints(tmp_path, other)
    fresh, events = store.restore(Pipeline(other))
    assert [event.what for event in events] == ["state_dropped"]
    assert "configuration is" in events[0].cause
    assert (fresh.ticks.counters["accepted"], store.counters["state.dropped"]) == (0, 1)


def test_nothing_is_written_while_no_sample_comes(tmp_path: Path) -> None:
    config = craft()
    pipeline, store = Pipeline(config), checkpoints(tmp_path, config)
    handle_all(pipeline, messages(0, 10))
    for _ in range(5):
        store.save([pipeline])
    assert store.counters["state.writes"] == 1


def test_a_disk_that_fails_is_counted_and_the_craft_works_on(tmp_path: Path) -> None:
    config = craft()
    pipeline, store = Pipeline(config), checkpoints(tmp_path, config)
    handle_all(pipeline, messages(0, 10))
    (tmp_path / "paper").rmdir()
    (tmp_path / "paper").write_text("")
    store.save([pipeline])
    assert (store.counters["state.failed"], store.trouble) == (1, "a part of this path is a file, not a folder")


def spoiled(state: dict[str, Any], path: tuple[str, ...], value: object) -> dict[str, Any]:
    """The state with one value replaced."""
    changed = copy.deepcopy(state)
    inner = changed
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    return changed


@pytest.fixture(scope="module")
def state() -> dict[str, Any]:
    pipeline = Pipeline(craft())
    handle_all(pipeline, messages(0, 400))
    return pipeline.export_state()


NAN = np.array([np.nan] + [0.0] * 8)


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (("estimator", "_x"), [[9], NAN.tobytes()], "NaN"),
        (("estimator", "_x"), [[8], bytes(64)], "shape"),
        (("estimator", "_x"), [[9], bytes(71)], "bytes"),
        (("estimator", "_x"), [[-1], b""], "axes"),
        (("estimator", "_x"), 3.0, "array"),
        (("estimator", "_covariance"), [[9, 9], bytes(648)], "positive"),
        (("estimator", "_samples"), 3.0, "int"),
        (("estimator", "_samples"), True, "int"),
        (("estimator", "_noise_variance"), float("inf"), "finite"),
        (("estimator", "_phase"), "flying", "starting"),
        (("estimator", "_windows"), [], "map"),
        (("estimator",), {}, "map"),
        (("ticks", "counters"), {"accepted": "many"}, "counts"),
        (("ticks", "_open"), [[1]], "array of 2"),
        (("_clock",), "sundial", "utc"),
        (("monitor", "_residuals"), [None], "float"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_by_name(
    state: dict[str, Any], path: tuple[str, ...], value: object, told: str
) -> None:
    with pytest.raises(SnapshotError, match=told):
        Pipeline(craft()).restore_state(spoiled(state, path, value))


def test_estimates_are_numbered_on_after_a_restart(tmp_path: Path) -> None:
    config = craft()
    pipeline = Pipeline(config)
    before = [m.sequence for m in handle_all(pipeline, messages(0, 100)) if isinstance(m, Estimate)]
    checkpoints(tmp_path, config).save([pipeline])
    restored, _ = checkpoints(tmp_path, config).restore(Pipeline(config))
    after = [m.sequence for m in handle_all(restored, messages(100, 103)) if isinstance(m, Estimate)]
    assert after[0] == before[-1] + 1
