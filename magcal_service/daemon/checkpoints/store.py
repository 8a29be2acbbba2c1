"""The daemon's checkpoints: which one is restored at the start, when one is written, and the outcome of each."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Final, Self

import numpy as np

from magcal_service.base.disk import allow_open_files
from magcal_service.base.errors import InputRefusedError, why_not
from magcal_service.base.snapshot import SnapshotError
from magcal_service.base.version import __version__
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.magnetometers import label
from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.checkpoints.files import Checkpoint, StateError, StateStore, config_digest, utc_s
from magcal_service.daemon.containment import contained, in_a_line
from magcal_service.daemon.events import Event
from magcal_service.daemon.pipeline import Pipeline

log = logging.getLogger("magcal")

MISFITS: Final = (SnapshotError, StateError, InputRefusedError, np.linalg.LinAlgError, ValueError)
"""What a state that does not fit may raise while it is restored."""


class Checkpoints:
    """The checkpoints of all craft of a daemon.

    Parameters
    ----------
    config: where, how often, how many.
    crafts: whose.

    Attributes
    ----------
    counters: ``state.restored``, ``state.dropped``, ``state.failed``, and since the folder was new ``state.writes``
        and ``state.bytes``.
    trouble: why the last checkpoint could not be written; empty where it could.

    Raises InputRefusedError where the folder cannot be made.  Within ``with``, no other daemon keeps the same craft's
    state in the same folder; InputRefusedError where one does already.
    """

    def __init__(self, config: StateConfig, crafts: Sequence[CraftConfig]) -> None:
        self._config = config
        self._stores = {craft.name: StateStore(config, craft.name) for craft in crafts}
        self._saved: dict[str, int] = {}  # samples accepted at the last checkpoint
        self.counters: Counter[str] = Counter()
        self.trouble = ""

    def __enter__(self) -> Self:
        allow_open_files(len(self._stores))
        with ExitStack() as held:
            for store in self._stores.values():
                held.enter_context(store.held())
            self._held = held.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._held.close()

    def sources(self, craft: str) -> list[str]:
        """Magnetometers beside the craft's own of which there is a checkpoint, by their sources."""
        return [source for source in self._stores[craft].beside() if self._is_kept(label(craft, source))]

    def _is_kept(self, name: str) -> bool:
        """Whether there is a sound checkpoint of a magnetometer: a folder alone makes none."""
        return any(isinstance(found, Checkpoint) for _, found in StateStore(self._config, name).newest())

    def _store(self, pipeline: Pipeline) -> StateStore:
        """That of a magnetometer beside the craft's own is made when it is first asked for."""
        store = self._stores.get(pipeline.label)
        if store is None:
            store = self._stores[pipeline.label] = StateStore(self._config, pipeline.label)
        return store

    def restore(self, pipeline: Pipeline) -> tuple[Pipeline, list[Event]]:
        """The pipeline of the newest checkpoint that is whole and this craft's, or the one given; and what was done.

        After one that is damaged the one before it is tried.  One of another craft, version or configuration ends the
        search: somebody has flown otherwise since those before it, which hold numbers of messages and an estimate that
        were given out already.  A command may still roll back to a named one.
        """
        store, events = self._store(pipeline), list[Event]()
        for name, found in store.newest():
            foreign = found.refusal(pipeline.config) if isinstance(found, Checkpoint) else ""
            restored = foreign or self._restored_or_why(pipeline.config, found)
            if isinstance(restored, Pipeline):
                assert isinstance(found, Checkpoint)
                events.append(restored.event("restored", f"checkpoint {name} of {found.samples} samples"))
                self._count(restored=1)
                return restored, events
            events.append(pipeline.event("state_dropped", f"checkpoint {name}: {restored}"))
            if isinstance(found, StateError):
                store.set_aside(name)
            self._count(dropped=1)
            if foreign:
                break
        return pipeline, events

    def _restored_or_why(self, config: CraftConfig, found: Checkpoint | StateError) -> Pipeline | str:
        """The pipeline of a checkpoint, or why there is none."""
        if isinstance(found, StateError):
            return str(found)
        try:
            return self._restored(config, found)
        except MISFITS as error:
            return str(error)
        except Exception as error:  # a state that a defect has written, or that meets one: the one before may do
            log.exception("%s: a checkpoint could not be restored", config.name)
            return in_a_line(error)

    @staticmethod
    def _restored(config: CraftConfig, checkpoint: Checkpoint) -> Pipeline:
        pipeline = Pipeline(config)
        pipeline.restore_state(checkpoint.state)
        return pipeline

    def save(self, pipelines: Iterable[Pipeline]) -> bool:
        """Write a checkpoint of each craft that has taken samples since its last; what fails is counted and logged.

        Says whether any was written.
        """
        before = self.counters["state.writes"]
        for pipeline in pipelines:
            accepted = pipeline.ticks.counters["accepted"]
            if self._saved.get(pipeline.label) == accepted:
                continue
            with contained(pipeline, "writing its checkpoint"):
                self._save(pipeline, accepted)
        return self.counters["state.writes"] > before

    def _save(self, pipeline: Pipeline, accepted: int) -> None:
        try:
            store = self._store(pipeline)
            store.write(self._checkpoint(pipeline, store))
        except (OSError, InputRefusedError) as error:  # the latter: its folder cannot be made
            self._failed(error)
            return
        self._saved[pipeline.label] = accepted
        self.trouble = ""
        self._count()

    def save_named(self, pipeline: Pipeline, name: str) -> str:
        """Write one under a name; why that failed, empty where it did not."""
        try:
            store = self._store(pipeline)
            store.write_named(name, self._checkpoint(pipeline, store))
        except (OSError, InputRefusedError) as error:  # the latter: its folder cannot be made
            self._failed(error)
            return f"not written: {self.trouble}"
        except StateError as error:
            return str(error)
        self._count()
        return ""

    def restore_estimate(self, pipeline: Pipeline, name: str) -> str:
        """Restore estimate and verdict of a named checkpoint; why that failed, empty where it did not."""
        try:
            checkpoint = self._store(pipeline).read_named(name)
            refusal = checkpoint.refusal(pipeline.config)
            if refusal:
                return f"checkpoint {name!r}: {refusal}"
            pipeline.restore_estimate(self._restored(pipeline.config, checkpoint))
        except MISFITS as error:
            return f"checkpoint {name!r}: {error}"
        return ""

    def _checkpoint(self, pipeline: Pipeline, store: StateStore) -> Checkpoint:
        return Checkpoint(
            craft=pipeline.config.name,
            version=__version__,
            config=config_digest(pipeline.config),
            written_s=utc_s(),
            first_time_ns=pipeline.first_time_ns,
            last_time_ns=pipeline.last_time_ns,
            samples=pipeline.ticks.counters["accepted"],
            writes=store.writes + 1,
            written_bytes=store.written_bytes,
            state=pipeline.export_state(),
        )

    def _failed(self, error: OSError | InputRefusedError) -> None:
        self.counters["state.failed"] += 1
        trouble = why_not(error)
        if trouble != self.trouble:
            text = (
                "no checkpoint could be written into %s: %s; the one before is kept, the next is tried when it is due"
            )
            log.error(text, self._config.directory, trouble)
        self.trouble = trouble

    def _count(self, *, restored: int = 0, dropped: int = 0) -> None:
        self.counters["state.restored"] += restored
        self.counters["state.dropped"] += dropped
        self.counters["state.writes"] = sum(store.writes for store in self._stores.values())
        self.counters["state.bytes"] = sum(store.written_bytes for store in self._stores.values())
