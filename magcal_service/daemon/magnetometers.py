"""The magnetometers of one craft: a pipeline for each, by the source of the samples, and what they say of each other.

References, positions, telemetry and commands are the craft's: every pipeline is given them.  The craft's own
magnetometer is the first that is listed, or where none is, the first that is heard; others appear as they are heard.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from magcal_service.base.errors import ConfigError
from magcal_service.config.magnetometers import beside, label, own_magnetometer
from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.command_table import WHICH
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.fields import fitting
from magcal_service.wire.messages import Command, CommandReply, MagnetometerSample, Message

log = logging.getLogger("magcal")

Build = Callable[[CraftConfig], Pipeline]
"""Makes the pipeline of a magnetometer."""

_OF_THE_CRAFT: Final = ("shutdown", "load_physics")
"""Commands that are not for every magnetometer: the daemon ends once, and a physics file is of one sensor."""

_MOST_TOLD: Final = 4
"""Sources that are refused by name; others are only counted."""


class Magnetometers:
    """Which pipelines of one craft a message is for.

    Parameters
    ----------
    config: the craft's configuration.
    pipelines: the daemon's, by ``label``; those of this craft are added to it.
    build: makes a pipeline.

    Raises ConfigError where a listed one cannot be calibrated as it is configured.
    """

    def __init__(self, config: CraftConfig, pipelines: dict[str, Pipeline], build: Build = Pipeline) -> None:
        self.config = config
        self._pipelines, self._build = pipelines, build
        self._labels = [config.name]
        self._refused: dict[str, str] = {}  # why, by source; the first few
        pipelines[config.name] = build(own_magnetometer(config))
        for one in config.magnetometers[1:]:
            self._add(one.source)

    @property
    def own(self) -> Pipeline:
        """The pipeline of the craft's own magnetometer."""
        return self._pipelines[self.config.name]

    @property
    def all(self) -> list[Pipeline]:
        """All pipelines of the craft, its own magnetometer's first."""
        return [self._pipelines[name] for name in self._labels]

    @property
    def several(self) -> bool:
        """Whether the craft has more than its own magnetometer."""
        return len(self._labels) > 1

    @property
    def sources(self) -> list[str]:
        """Sources of the magnetometers, as far as they are known."""
        return [one.heard for one in self.all if one.heard]

    def heard(self, source: str) -> Pipeline:
        """The pipeline of a source's samples; the craft's own magnetometer's where there is none of its own."""
        return self._pipelines.get(label(self.config.name, source), self.own)

    def _add(self, source: str) -> Pipeline:
        pipeline = self._build(beside(self.config, source))
        self._pipelines[pipeline.label] = pipeline
        self._labels.append(pipeline.label)
        return pipeline

    def of(self, message: Message) -> list[Pipeline]:
        """The pipelines that a message is for; none for a sample of a source that is not served."""
        if not isinstance(message, MagnetometerSample):
            return self.all
        name = label(self.config.name, message.source)
        if name in self._labels:
            return [self._pipelines[name]]
        if self.own.heard in ("", message.source):
            return [self.own]
        appeared = self.appear(message.source)
        return [] if appeared is None else [appeared]

    def appear(self, source: str) -> Pipeline | None:
        """A pipeline for a source that is new, with what the craft has been told so far; None where it is refused."""
        why = ""
        if source == RESERVED_SOURCE:
            why = "that name is the daemon's own"
        elif len(self._labels) >= self.config.max_sources:
            why = f"max_sources = {self.config.max_sources}, served: {', '.join(self.sources)}"
        else:
            try:
                pipeline = self._add(source)
            except ConfigError as error:
                why = f"list it in [[craft.magnetometer]]; {error}"
        if why:
            self._refuse(source, why)
            return None
        own = self.own
        told = own.ticks if own.plain is None else own.plain.ticks  # as it came, without the craft's own physics
        pipeline.ticks.references.restore_state(told.references.export_state())
        pipeline.ticks.rates.restore_state(told.rates.export_state())
        pipeline.take_commands(own)
        pipeline.note("magnetometer", f"source {source} has appeared, beside {', '.join(self.sources[:-1])}")
        return pipeline

    def _refuse(self, source: str, why: str) -> None:
        self.own.counters["sources_refused"] += 1
        if source not in self._refused and len(self._refused) < _MOST_TOLD:
            self._refused[source] = f"magnetometer samples of source {source} are refused: {why}"
            log.warning("%s: %s", self.config.name, self._refused[source])

    def commanded(self, command: Command) -> tuple[Command, list[Pipeline]]:
        """A command without the argument that names its magnetometer, and those it is for; none for an unknown one.

        Without the argument it is for all of them, but for what is the daemon's or the craft's own.
        """
        if WHICH not in command.arguments:
            return command, [self.own] if command.name in _OF_THE_CRAFT else self.all
        named = command.arguments[WHICH]
        rest = {name: value for name, value in command.arguments.items() if name != WHICH}
        return replace(command, arguments=rest), [one for one in self.all if one.heard == named]

    def unknown(self, command: Command) -> str:
        """Why a command for a magnetometer that there is not is refused."""
        return f"{WHICH} is {command.arguments[WHICH]!r}; one of {', '.join(self.sources) or 'none yet'} is accepted"

    @staticmethod
    def one_reply(pipelines: Sequence[Pipeline], replies: Sequence[CommandReply]) -> list[CommandReply]:
        """The one reply to a command for several: carried out where one of them has, with what the others refused."""
        refused = [
            f"{pipeline.heard}: {reply.text}"
            for pipeline, reply in zip(pipelines, replies, strict=False)
            if not reply.accepted
        ]
        done = [reply for reply in replies if reply.accepted]
        if not (refused and done):
            return list(replies[:1])
        return [replace(done[0], text=fitting("; ".join((done[0].text, "refused: ", *refused))))]

    def remarks(self, pipeline: Pipeline) -> list[str]:
        """What a status says of the craft's magnetometers beside the pipeline's own state."""
        found = [f"local disturbance near {one.heard}" for one in self.all if one.witness.local]
        beside = [one.heard for one in self.all if one is not self.own]
        if pipeline is self.own and beside:
            found.append(f"magnetometer {pipeline.heard or 'not heard yet'}, beside it {', '.join(beside)}")
        return found

    def troubles(self, pipeline: Pipeline) -> list[str]:
        """Sources that are refused, in the status of the craft's own magnetometer."""
        return list(self._refused.values()) if pipeline is self.own else []
