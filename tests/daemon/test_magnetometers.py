"""Several magnetometers of one craft: each is calibrated by itself, and they are witnesses of each other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.cli.status import _complete, as_text
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import Config, CraftConfig, FilterConfig, MagnetometerConfig, SpinConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links import Link, Role, open_link
from magcal_service.trust.modes import MODES, Mode
from magcal_service.wire.messages import (
    CalibratedVector,
    Command,
    CommandReply,
    Estimate,
    MagnetometerSample,
    Message,
    Status,
    Verdict,
)
from tests.daemon.magnetometer_streams import MAGNET_S, PAIR, messages, of_source, pair
from tests.daemon.pipeline_streams import handle_all
from tests.daemon.real_links import ends
from tests.links.link_messages import settle

_names = itertools.count()


@contextmanager
def served(craft: CraftConfig = PAIR, state: StateConfig | None = None) -> Iterator[tuple[Service, Link]]:
    """A service and the node's end of its link."""
    address = f"loop:magnetometers-{next(_names)}"
    with open_link(address, Role.SERVICE) as link, open_link(address, Role.NODE) as node:
        checkpoints = None if state is None else Checkpoints(state, (craft,))
        service = Service(Config(address, (craft,), state=state), link, checkpoints=checkpoints)
        service.restore()
        yield service, node


def give(service: Service, node: Link, given: list[Message]) -> list[Message]:
    """What is published for messages, in order."""
    published: list[Message] = []
    for message in given:
        service.handle(message)
        published += node.receive(0.0)
    return published


def vectors(published: list[Message], source: str) -> list[CalibratedVector]:
    return [one for one in published if isinstance(one, CalibratedVector) and one.source == source]


@pytest.mark.parametrize(("apart_nt", "offset_s"), [(150.0, 0.0), (1000.0, 0.5)])
def test_each_is_right_within_its_sigma_and_a_magnet_near_one_is_named(apart_nt: float, offset_s: float) -> None:
    simulation = pair(MAGNET_S + 40.0, apart_nt, offset_s)
    stream = list(simulation.messages())
    magnet_ns = simulation.truth.start_ns + round(MAGNET_S * 1e9)
    with served() as (service, node):
        give(service, node, [one for one in stream if one.time_ns < magnet_ns])
        own, other = service.pipelines["pair"], service.pipelines["pair/mag2"]
        sensors = (simulation.truth.sensor, simulation.truth.beside[0].sensor)
        for pipeline, sensor in zip((own, other), sensors, strict=True):
            estimate = pipeline.estimator.estimate()
            truth = np.array([*sensor.bias_nt, *sensor.D])
            error = (estimate.x - truth) / np.sqrt(np.diagonal(estimate.covariance))
            assert np.abs(error).max() < 3.5
            assert pipeline.trust.verdict is Verdict.TRUSTED

        published = give(service, node, [one for one in stream if one.time_ns >= magnet_ns])
        told = [one for one in published if isinstance(one, Estimate) and "local_disturbance" in one.reasons]
        row = MODES[Mode.LOCAL_DISTURBANCE]
        assert {(one.source, one.verdict, one.reasons[0]) for one in told} == {("mag2", row.verdict, row.reason)}
        assert told[0].time_ns - magnet_ns <= 30_000_000_000
        assert own.trust.verdict is Verdict.TRUSTED
        service.publish_status()
        texts = {one.source: one.text for one in node.receive(0.0) if isinstance(one, Status)}
        assert all("local disturbance near mag2" in text for text in texts.values())
        assert set(texts) == {"magcal", "mag2"}


def test_each_publishes_what_it_would_alone() -> None:
    """To the bit, vectors and estimates, but for sequence numbers, which count the statuses as well."""

    def results(published: list[Message], source: str) -> list[Message]:
        mine = (source, "magcal" if source == "mag" else source)
        kept = [one for one in published if isinstance(one, CalibratedVector | Estimate) and one.source in mine]
        return [replace(one, sequence=0, source=source) for one in kept]

    with served() as (service, node):
        together = give(service, node, list(messages()))
    for source in ("mag", "mag2"):
        alone = handle_all(Pipeline(PAIR), of_source(source, messages()))
        assert results(together, source) == [replace(one, sequence=0, source=source) for one in alone]
        assert len(alone) == 60 + 59


@pytest.mark.parametrize("kind", ["zenoh", "serial"])
def test_both_are_served_over_a_real_link(kind: str) -> None:
    with ends(kind) as (link, node):
        service = Service(Config(link.address, (PAIR,)), link)
        published: list[Message] = []
        for message in messages(20.0):
            node.send(message)

        def come() -> bool:
            for message in link.receive(0.0):
                service.handle(message)
            published.extend(node.receive(0.0))
            return len(vectors(published, "mag")) == len(vectors(published, "mag2")) == 20

        settle(come)
        estimates = {one.source for one in published if isinstance(one, Estimate)}
    assert (len(vectors(published, "mag")), len(vectors(published, "mag2"))) == (20, 20)
    assert estimates == {"magcal", "mag2"}


def test_a_source_beyond_the_bound_is_refused_by_name() -> None:
    craft = replace(PAIR, max_sources=2)
    third = [replace(one, source="mag3") for one in messages() if isinstance(one, MagnetometerSample)][:5]
    with served(craft) as (service, node):
        published = give(service, node, [*messages(), *third])
        assert vectors(published, "mag3") == []
        status = service.statuses.of(service.pipelines["pair"])
    assert status.counters[MODES[Mode.SOURCE_REFUSED].counter] == 5
    assert status.counters["magnetometers"] == 2
    assert "magnetometer samples of source mag3 are refused: max_sources = 2, served: mag, mag2" in status.text
    assert set(service.pipelines) == {"pair", "pair/mag2"}


def test_the_daemons_own_name_is_no_sources_of_another_magnetometer() -> None:
    """Its results could not be told from those of the craft's own."""
    impostor = [replace(one, source="magcal") for one in messages() if isinstance(one, MagnetometerSample)][:3]
    with served() as (service, node):
        give(service, node, [*messages(10.0), *impostor])
        assert service.pipelines["pair"].counters["sources_refused"] == 3


def test_a_source_that_the_method_cannot_serve_is_refused_and_the_craft_goes_on() -> None:
    """An axis is one of the sensor's own axes, so the craft's is not taken for another magnetometer."""
    craft = replace(PAIR, spin=SpinConfig(rate_rpm=7.5), filter=FilterConfig("plkf"))
    with served(craft) as (service, node):
        published = give(service, node, list(messages(10.0)))
        assert (len(vectors(published, "mag")), vectors(published, "mag2")) == (10, [])
        text = service.statuses.of(service.pipelines["pair"]).text
    assert "source mag2 are refused: list it in [[craft.magnetometer]]; spin" in text


def test_the_first_that_is_listed_is_the_crafts_own_and_each_has_its_settings() -> None:
    listed = (MagnetometerConfig("mag2", noise_nt=50.0), MagnetometerConfig("mag", prior_D=0.1))
    craft = replace(PAIR, magnetometers=listed)
    with served(craft) as (service, node):
        published = give(service, node, list(messages()))
        own, other = service.pipelines["pair"], service.pipelines["pair/mag"]
        assert [own.heard, other.heard] == ["mag2", "mag"]
        assert [one.config.sensor.noise_nt for one in (own, other)] == [50.0, 100.0]
        assert [one.config.filter.prior_D for one in (own, other)] == [0.2, 0.1]
        assert {one.source for one in published if isinstance(one, Estimate)} == {"magcal", "mag"}


@pytest.mark.parametrize("first", ["mag", "mag2"])
def test_after_a_restart_each_goes_on_with_its_own_state_whoever_is_heard_first(first: str, tmp_path: Path) -> None:
    stream = list(messages())
    before, after = stream[:90], stream[90:]
    after.sort(key=lambda one: (isinstance(one, MagnetometerSample) and one.source != first, 0))
    state = StateConfig(tmp_path)
    with served() as (service, node):
        give(service, node, [*before, *after])
        expected = {name: one.export_state()["estimator"] for name, one in service.pipelines.items()}
    with served(state=state) as (service, node):
        give(service, node, before)
        assert service.save()
    with served(state=state) as (service, node):
        assert {name: one.heard for name, one in service.pipelines.items()} == {"pair": "mag", "pair/mag2": "mag2"}
        give(service, node, after)
        assert {name: one.export_state()["estimator"] for name, one in service.pipelines.items()} == expected


def command(name: str, **arguments: str) -> Command:
    return Command(craft="pair", source="desk", sequence=7, time_ns=0, name=name, arguments=arguments)


def test_a_command_is_for_all_or_for_the_one_that_it_names() -> None:
    with served() as (service, node):
        give(service, node, list(messages(10.0)))

        def replies(asked: Command) -> list[CommandReply]:
            return [one for one in give(service, node, [asked]) if isinstance(one, CommandReply)]

        def frozen() -> list[bool]:
            return [one.frozen for one in service.pipelines.values()]

        assert [one.accepted for one in replies(command("freeze"))] == [True]
        assert frozen() == [True, True]
        assert [one.accepted for one in replies(command("resume", source="mag2"))] == [True]
        assert frozen() == [True, False]
        (refused,) = replies(command("resume", source="mag3"))
        assert (refused.accepted, refused.text) == (False, "source is 'mag3'; one of mag, mag2 is accepted")
        published = give(service, node, [command("status")])
        statuses = [one for one in published if isinstance(one, Status)]
        assert _complete({("pair", one.source): one for one in statuses}) == {"pair"}
        assert _complete({("pair", one.source): one for one in statuses[:1]}) == set()
        assert [line.split(":")[0] for line in as_text(statuses).splitlines()[::2]] == ["pair", "pair/mag2"]
        assert [one.source for one in published if isinstance(one, Status)] == ["magcal", "mag2"]


def test_one_that_appears_later_is_as_commands_have_made_the_craft() -> None:
    with served() as (service, node):
        give(service, node, of_source("mag", messages(10.0)))
        for asked in (command("freeze"), replace(command("process_noise"), arguments={"bias_nt": 0.5})):
            give(service, node, [asked])
        give(service, node, list(messages(12.0)))
        own, later = service.pipelines.values()
    assert later.frozen
    assert later.summary().startswith("frozen, not_started (frozen")
    assert (later._process_noise, own._process_noise) == ((0.5, 0.0), (0.5, 0.0))
