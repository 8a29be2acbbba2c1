"""Figures of a running daemon, assembled for the status, the metrics and the log."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from magcal_service.base.version import __version__
from magcal_service.daemon.health.figures import BOUNDS_S, Flow, Process, TickLateness, troubles
from magcal_service.daemon.health.metrics import Labels, Metrics
from magcal_service.daemon.health.overload import Overload
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.links.base import Link
from magcal_service.ticks.rejection import Rejection
from magcal_service.wire.messages import Verdict

FRESH_S: Final = 1.0
"""Figures of the process up to this old go into a status as they are: a thousand craft each have one [s]."""


_MOST_NAMED: Final = 3  # craft that a log line names: more make it too long to read


class Health:
    """Keeps the figures of one daemon.

    Parameters
    ----------
    link: its link.
    """

    def __init__(self, link: Link) -> None:
        self.lateness = TickLateness()
        self._link = link
        self._flow = Flow()
        self.overload = Overload(link.overflows)
        self._started_s = time.monotonic()
        self._figures, self._figured_s = Counter[str](), 0.0

    @property
    def uptime_s(self) -> float:
        """Time since the daemon began [s]."""
        return time.monotonic() - self._started_s

    def troubles(self, pipeline: Pipeline) -> list[str]:
        """Faults of a craft."""
        overload = self.overload.trouble(pipeline.config.name)
        return [*troubles(pipeline, self._flow.silent_s(pipeline)), *([overload] if overload else [])]

    def counters(self) -> Counter[str]:
        """Figures of the process that go into every craft's status, to a second; times in us, memory in kB."""
        now_s = time.monotonic()
        if not self._figures or now_s - self._figured_s > FRESH_S:
            self._figures, self._figured_s = self._of_the_process(), now_s
        return self._figures.copy()

    def _of_the_process(self) -> Counter[str]:
        half_s, most_s = self.lateness.quantiles_s()
        process = Process.now()
        return Counter(
            {
                "tick_late_p50_us": round(1e6 * half_s),
                "tick_late_p99_us": round(1e6 * most_s),
                "rss_kb": process.rss_bytes // 1024,
                "open_files": process.open_files,
                "threads": process.threads,
            }
        )

    def summary(self, pipelines: Iterable[Pipeline]) -> dict[str, Any]:
        """One object for the log."""
        craft = {
            pipeline.label: {
                "verdict": str(pipeline.trust.verdict),
                "reasons": [str(reason) for reason in pipeline.trust.reasons],
                "troubles": self.troubles(pipeline),
                "accepted": pipeline.ticks.counters["accepted"],
                "ticks": pipeline.ticks.counters["ticks"],
                "residual_rms_nt": round(pipeline.monitor.residual_rms_nt, 1),
                "model_doubt": pipeline.model_doubt,
            }
            for pipeline in pipelines
        }
        return {"uptime_s": round(self.uptime_s, 1), **self.counters(), "craft": craft}

    def metrics(self, pipelines: Iterable[Pipeline], others: Counter[str]) -> str:
        """The Prometheus text; ``others`` are the daemon's counters, such as those of the checkpoints."""
        metrics, crafts = Metrics(), list(pipelines)
        self._daemon(metrics, others)
        self._samples(metrics, crafts)
        self._estimates(metrics, crafts)
        return metrics.render()

    def _daemon(self, metrics: Metrics, others: Counter[str]) -> None:
        process = Process.now()
        gauges = (
            ("uptime_seconds", "Time since the daemon began.", self.uptime_s),
            ("resident_memory_bytes", "Resident memory.", process.rss_bytes),
            ("open_files", "Open file descriptors.", process.open_files),
            ("threads", "Threads.", process.threads),
        )
        metrics.add("build_info", "gauge", "Version of the daemon.", [({"version": __version__}, 1)])
        for name, text, value in gauges:
            metrics.add(name, "gauge", text, [({}, value)])
        lateness = self.lateness
        text = "Time from the arrival of a tick's last message to its estimate, at the most."
        metrics.add_histogram("tick_lateness_seconds", text, BOUNDS_S, lateness.counts, lateness.total_s)
        link = [({"event": name}, count) for name, count in sorted(self._link.counters.items())]
        metrics.add("link_events_total", "counter", "What happened on the link, by the names of docs/links.md.", link)
        own = [({"event": name}, count) for name, count in sorted(others.items())]
        metrics.add("daemon_events_total", "counter", "What happened to checkpoints, recordings and rows.", own)
        shed = [({"craft": craft}, count) for craft, count in sorted(self._link.overflows.items())]
        metrics.add("messages_shed_total", "counter", "Messages that a full queue has dropped.", shed)
        records = self._link.sources()
        for name, of in (("received", "received"), ("lost", "lost"), ("doubled", "doubled"), ("late", "late")):
            rows = [({"craft": one.craft, "source": one.source, "kind": one.kind}, getattr(one, of)) for one in records]
            metrics.add(f"messages_{name}_total", "counter", f"Messages {name}, by their sequence numbers.", rows)

    def _samples(self, metrics: Metrics, crafts: list[Pipeline]) -> None:
        rows = [
            (_whose(craft) | {"outcome": name}, craft.ticks.counters[name])
            for craft in crafts
            for name in ("accepted", *(each.value for each in Rejection))
        ]
        metrics.add("samples_total", "counter", "Magnetometer samples by what became of them.", rows)
        rows = [
            (_whose(craft) | {"outcome": name}, craft.ticks.counters[name])
            for craft in crafts
            for name in ("ticks", "ticks_skipped", "ticks_empty")
        ]
        metrics.add("ticks_total", "counter", "Ticks used, skipped without reference, and without samples.", rows)
        rows = [(_whose(craft), craft.counters["failed"]) for craft in crafts]
        metrics.add("craft_failures_total", "counter", "Times that a defect made the craft begin anew.", rows)
        rows = [(_whose(craft), craft.counters["rejected"]) for craft in crafts]
        metrics.add("samples_rejected_total", "counter", "Samples that the filter's gate stopped.", rows)

    def _estimates(self, metrics: Metrics, crafts: list[Pipeline]) -> None:
        rows = [
            (_whose(craft) | {"verdict": str(verdict)}, int(craft.trust.verdict is verdict))
            for craft in crafts
            for verdict in Verdict
        ]
        metrics.add("verdict", "gauge", "1 for the verdict that holds.", rows)
        gauges: tuple[tuple[str, str, Callable[[Pipeline], float]], ...] = (
            ("troubles", "What is amiss, counted.", lambda craft: len(self.troubles(craft))),
            ("frozen", "1 while nothing is learned.", lambda craft: int(craft.frozen)),
            ("residual_rms_tesla", "Running rms of the scalar residual.", lambda c: 1e-9 * c.monitor.residual_rms_nt),
            ("residual_floor_tesla", "White part of the residual.", lambda c: 1e-9 * c.monitor.white_noise_nt),
            ("innovation_ratio", "Mean normalised innovation squared.", lambda craft: craft.monitor.innovation),
            ("rejected_ratio", "Share of samples stopped by the gate.", lambda craft: craft.monitor.rejected_share),
        )
        doubts: list[tuple[Labels, float]] = [
            (_whose(craft) | {"effect": effect}, found.nats if found is not None else 0.0)
            for craft, found in ((craft, craft.watch.finding) for craft in crafts)
            for effect in (("none",) if found is None else found.effects)
        ]
        metrics.add("model_doubt_nats", "gauge", "Evidence for what the model leaves out, by its looks.", doubts)
        levels: list[tuple[Labels, float]] = [
            (_whose(craft) | {"hazard": str(craft.trust.protection_by)}, 1e-9 * craft.trust.protection_nt)
            for craft in crafts
            if craft.trust.protection_nt is not None
        ]
        text = "How far a vector may be off by what would not have been seen yet, by what sets it."
        metrics.add("protection_tesla", "gauge", text, levels)
        for name, text, value in gauges:
            each: list[tuple[Labels, float]] = [(_whose(craft), value(craft)) for craft in crafts]
            metrics.add(name, "gauge", text, each)


def in_words(summary: Mapping[str, Any]) -> str:
    """A ``summary`` as a sentence: the verdict of each craft, of many how many have which, and what is amiss."""
    craft = summary["craft"]
    if len(craft) <= _MOST_NAMED:
        amiss = "" if any(one["troubles"] for one in craft.values()) else "; no troubles"
        return ", ".join(_in_words(name, one) for name, one in craft.items()) + amiss
    counts = Counter(one["verdict"] for one in craft.values())
    troubled = [_in_words(name, one) for name, one in craft.items() if one["troubles"]]
    more = f" and {len(troubled) - _MOST_NAMED} more with troubles" if len(troubled) > _MOST_NAMED else ""
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return f"{verdicts}; {', '.join(troubled[:_MOST_NAMED]) or 'no troubles'}{more}"


def _in_words(name: str, craft: Mapping[str, Any]) -> str:
    """A craft with its verdict, and its troubles without saying that verdict again."""
    verdict = craft["verdict"]
    amiss = "; ".join(trouble.removeprefix(f"{verdict}: ") for trouble in craft["troubles"])
    return f"{name} {verdict} ({amiss})" if amiss else f"{name} {verdict}"


def _whose(pipeline: Pipeline) -> dict[str, str]:
    """Labels of a pipeline's figures: its craft, and its source where it is not the craft's own magnetometer."""
    source = pipeline.config.source
    return {"craft": pipeline.config.name, **({"source": source} if source else {})}
