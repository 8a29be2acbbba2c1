"""The watch within the pipeline: what it tells, what it survives, and what makes it quiet."""

from __future__ import annotations

import shlex
import time
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.snapshot import SnapshotError
from magcal_service.cli.status import as_text, is_healthy
from magcal_service.config.daemon_settings import RecordConfig
from magcal_service.config.settings import Config, TrustConfig
from magcal_service.daemon.health.report import Health
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recorder import Recorder, open_recorder
from magcal_service.trust.reasons import Reason
from magcal_service.views.words import finding_of
from magcal_service.wire.messages import Command, Message, Status, TelemetrySample, Verdict
from tests.physics.live_models import ZERO, physics
from tests.watch.watch_runs import craft, flight, fly, stream

COIL = flight(torquer_nt=250.0)
COIL_S = 1700.0
HOT = flight(thermal_nt_per_k=6.0)
HOT_S = 3900.0
BY_TEMPERATURE = ModelTerm(
    "thermal_bias", "channel:temperature", "", {"nt_per_k": np.array([3.0, -2.4, 4.62])}, constants=ZERO
)


def published(pipeline: Pipeline, messages: tuple[Message, ...]) -> list[object]:
    """Everything that goes out, and every event."""
    out: list[object] = []
    for message in messages:
        out += [*pipeline.handle(message), *pipeline.take_events()]
    return out


@pytest.mark.parametrize("cut_s", [700, 1000, 1600])
def test_a_checkpoint_carries_the_watch_on(cut_s: int) -> None:
    """Within a chunk, within a block, after the finding: the same estimates and events, to the last bit."""
    messages = stream(COIL, COIL_S)
    cut = next(i for i, message in enumerate(messages) if message.time_ns > COIL.start_ns + cut_s * 10**9)
    whole, resumed = Pipeline(craft()), Pipeline(craft())
    published(whole, messages[:cut])
    resumed.restore_state(whole.export_state())
    assert published(resumed, messages[cut:]) == published(whole, messages[cut:])
    assert resumed.watch.finding is not None


def test_a_state_whose_parts_do_not_belong_together_is_refused() -> None:
    pipeline = Pipeline(craft())
    published(pipeline, stream(COIL, COIL_S))
    saved = pipeline.export_state()
    saved["watch"]["_samples"] += 1
    with pytest.raises(SnapshotError, match="watch"):
        Pipeline(craft()).restore_state(saved)


def test_a_model_that_is_loaded_makes_the_watch_quiet() -> None:
    """A temperature that is told without physics.toml (test_watch_findings) is not with it: the estimate is trusted."""
    config = craft(physics=physics(BY_TEMPERATURE, origin_ns=HOT.start_ns))
    loaded = fly(Pipeline(config), stream(HOT, HOT_S))
    assert (loaded.findings, loaded.pipeline.trust.verdict) == ((), Verdict.TRUSTED)


def test_a_channel_that_ends_is_left_out_and_the_rest_goes_on() -> None:
    """The torquer's telemetry stops within the window: it is void from then on, and the temperature is still named."""
    until_ns = HOT.start_ns + 1500 * 10**9
    messages = tuple(
        message
        for message in stream(HOT, HOT_S)
        if not (isinstance(message, TelemetrySample) and message.channel == "torquer" and message.time_ns > until_ns)
    )
    watch = fly(Pipeline(craft()), messages).pipeline.watch
    assert watch.finding is not None
    assert watch.finding.effects[0] == "thermal_bias"
    assert not [one for one in watch.explanations(walks=False) if "torquer" in one.effects]


def test_a_reset_takes_the_doubt_away_and_switching_off_prevents_it() -> None:
    messages = stream(COIL, COIL_S)
    pipeline = fly(Pipeline(craft()), messages).pipeline
    assert Reason.MODEL_DOUBTFUL in pipeline.trust.reasons
    pipeline.handle(Command(craft="paper", source="ground", sequence=1, time_ns=0, name="reset"))
    assert (pipeline.watch.finding, pipeline.watch.is_open) == (None, False)
    assert Reason.MODEL_DOUBTFUL not in pipeline.trust.reasons
    off = fly(Pipeline(craft(trust=TrustConfig(watch=False))), messages)
    assert (off.findings, off.pipeline.watch.is_open) == ((), False)


def test_nothing_is_watched_before_the_estimate_has_settled() -> None:
    pipeline = Pipeline(craft())
    for message in stream(COIL, COIL_S):
        before = pipeline.watch.is_open
        out = pipeline.handle(message)
        if not before and pipeline.watch.is_open:
            assert set(out[-1].reasons) <= {Reason.UNPROTECTED}  # type: ignore[union-attr]
            return
    pytest.fail("the watch never began")


def test_status_metrics_and_log_say_what_it_looks_like() -> None:
    """The status's text with the command to run, not healthy, and the evidence as a metric."""
    config = craft()
    with (
        open_link("loop:watch", Role.SERVICE, crafts=["paper"]) as link,
        open_link("loop:watch", Role.VIEWER) as viewer,
    ):
        service = Service(Config("loop:watch", (config,)), link)
        for message in stream(COIL, COIL_S):
            service.handle(message)
        viewer.receive(0.0)
        service.publish_status()
        told = [message for message in viewer.receive(1.0) if isinstance(message, Status)]
        metrics = Health(link).metrics(service.pipelines.values(), service.counters)
    assert not is_healthy(told[-1])
    text = as_text(told[-1:])
    assert "NOT HEALTHY" in text
    assert "model doubtful: looks like torquer (channel torquer), " in text
    assert "run: magcal diagnose RECORDING" in text
    assert 'magcal_model_doubt_nats{craft="paper",effect="torquer"} ' in metrics


def test_where_the_session_is_recorded_the_command_is_for_its_file(tmp_path: Path) -> None:
    """Which can be read while it is being written."""
    config = craft()
    record = RecordConfig(tmp_path / "my sessions", flush_s=0.1)
    with (
        open_link("loop:watch-recorded", Role.SERVICE, crafts=["paper"]) as link,
        open_link("loop:watch-recorded", Role.VIEWER) as viewer,
        open_recorder(record, (config,)) as recorder,
    ):
        assert recorder.path is None or recorder.path.parent == record.directory
        service = Service(Config("loop:watch-recorded", (config,), record=record), link, None, recorder)
        for number, message in enumerate(stream(COIL, COIL_S)):
            service.handle(message)
            if number % 2000 == 0:
                _wait_until_written(recorder, number)
        _wait_until_written(recorder, number)
        viewer.receive(0.0)
        service.publish_status()
        told = [message for message in viewer.receive(1.0) if isinstance(message, Status)]
        finding = finding_of(told[-1].text)
        assert finding is not None
        program, command, path = shlex.split(finding.command)
        assert (program, command, path) == ("magcal", "diagnose", str(recorder.path))
        assert len(read_recording(path)) > 1000


def _wait_until_written(recorder: Recorder, count: int) -> None:
    deadline_s = time.monotonic() + 20.0
    while recorder.counters["record.written"] < count and time.monotonic() < deadline_s:
        time.sleep(0.01)
