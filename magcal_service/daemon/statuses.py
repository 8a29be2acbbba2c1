"""What a status holds beside its pipeline's own: counters and faults of link, disk and daemon, and the newest event."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from magcal_service.config.magnetometers import MAGNETOMETERS
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.events import Event
from magcal_service.daemon.health.report import Health
from magcal_service.daemon.magnetometers import Magnetometers
from magcal_service.daemon.outputs import Outputs
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.rows import Rows
from magcal_service.links import Link
from magcal_service.trust.verdict import Trust
from magcal_service.watch.diagnosing import of_recording
from magcal_service.wire.fields import fitting
from magcal_service.wire.messages import Status

if TYPE_CHECKING:
    from magcal_service.recordings.recorder import Recorder


class Statuses:
    """Statuses of all craft; the parts are read whenever one is asked for.

    Parameters
    ----------
    link, health, counters: the daemon's.
    magnetometers: by craft.
    rows: the daemon's.
    recorder, checkpoints, outputs: those that there are.
    """

    def __init__(
        self,
        link: Link,
        health: Health,
        counters: Counter[str],
        magnetometers: Mapping[str, Magnetometers],
        rows: Rows,
        recorder: Recorder | None,
        checkpoints: Checkpoints | None,
        outputs: Outputs | None,
    ) -> None:
        self._link, self._health, self._counters, self._magnetometers = link, health, counters, magnetometers
        self._rows, self._recorder, self._checkpoints, self._outputs = rows, recorder, checkpoints, outputs
        self._last_events: dict[str, Event] = {}

    def note(self, event: Event) -> None:
        """Name this event in the statuses of its craft from now on."""
        self._last_events[event.craft] = event

    def parts_counters(self) -> list[Counter[str]]:
        """What recorder, checkpoints and further links have counted."""
        return [part.counters for part in (self._recorder, self._checkpoints, self._outputs) if part is not None]

    def of(self, pipeline: Pipeline) -> Status:
        """With the link's counters as ``link.*``, the craft's newest event, and faults of disk and link."""
        magnetometers = self._magnetometers[pipeline.config.name]
        troubles = self._troubles(pipeline, magnetometers)
        counters = Counter({f"link.{name}": count for name, count in self._link.counters.items()}) + self._counters
        counters = sum(self.parts_counters(), counters) + self._health.counters() + Counter({"troubles": len(troubles)})
        if magnetometers.several:
            counters[MAGNETOMETERS] = len(magnetometers.all)
        event = self._last_events.get(pipeline.label)
        remarks = [
            *_in_words(troubles, pipeline.trust),
            *magnetometers.remarks(pipeline),
            *self._unserved(),
            *self._link.warnings,
            *([f"last event: {event}"] if event is not None else []),
        ]
        status = pipeline.status(self._health.uptime_s, counters)
        said = self._for_its_recording(status.text, pipeline, magnetometers)
        return replace(status, text=fitting("; ".join((said, *remarks))))

    def _for_its_recording(self, text: str, pipeline: Pipeline, magnetometers: Magnetometers) -> str:
        """A status' text whose command is for the session that is being recorded, of this craft and magnetometer."""
        path = None if self._recorder is None else self._recorder.path
        if path is None:
            return text
        craft = ["--craft", pipeline.config.name] if len(self._magnetometers) > 1 else []
        source = ["--source", pipeline.config.source] if magnetometers.several and pipeline.config.source else []
        return of_recording(text, str(path), [*craft, *source])

    def _troubles(self, pipeline: Pipeline, magnetometers: Magnetometers) -> list[str]:
        troubles = [*self._health.troubles(pipeline), *magnetometers.troubles(pipeline)]
        if self._recorder is not None and self._recorder.trouble:
            troubles.append(f"not recording: {self._recorder.trouble}")
        if self._checkpoints is not None and self._checkpoints.trouble:
            troubles.append(f"no checkpoints: {self._checkpoints.trouble}")
        if self._rows.trouble:
            troubles.append(f"no rows: {self._rows.trouble}")
        if self._outputs is not None and self._outputs.trouble:
            troubles.append(self._outputs.trouble)
        if self._link.alone:
            troubles.append(self._link.alone)
        return troubles

    def _unserved(self) -> list[str]:
        strangers = ", ".join(self._link.strangers)
        if not strangers:
            return []
        return [f"messages of craft {strangers} are refused; served: {', '.join(self._magnetometers)}"]


def _in_words(troubles: Iterable[str], trust: Trust) -> list[str]:
    """What is amiss; in place of the reasons of a verdict, which the status has said by then, what to do."""
    is_said = f"{trust.verdict}: "
    return [f"to do: {trust.remedy}" if trust.remedy and one.startswith(is_said) else one for one in troubles]
