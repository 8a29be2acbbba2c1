"""The live table in the terminal: nine errors, their limits, and how far they can be trusted (extra ``view``)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from magcal_service.base.errors import ExtraMissingError
from magcal_service.views.nine import PARAMETERS, sigmas, values
from magcal_service.wire.messages import Estimate, Verdict
from sim_sensor.view.history import inside

try:
    from rich.console import Console, Group, RenderableType
    from rich.live import Live
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text
except ImportError as exc:
    raise ExtraMissingError(exc.name or "rich", "view", "the live table") from None

__all__ = ["LiveTable", "Screen", "plain_line", "render"]

PLAIN_EVERY_S = 10.0  # a log, unlike a terminal, keeps every line: six a minute are enough
_STYLES = {
    Verdict.NOT_STARTED: "dim",
    Verdict.CONVERGING: "yellow",
    Verdict.TRUSTED: "bold green",
    Verdict.DOUBTFUL: "bold red",
}
_UNKNOWN = "..."


@dataclass(frozen=True, slots=True)
class Screen:
    """All that one picture shows.

    Parameters
    ----------
    estimate: the newest, None before the first.
    truth: the nine true errors [nT and -], None where unknown.
    time_s, duration_s: sample time since the start and at the end [s]; ``duration_s`` None where it has no end.
    speed: sample seconds per wall second.
    counts: anything counted, shown in order, such as ``{"sent": 900, "answered": 899, "lost": 0}``.
    """

    estimate: Estimate | None = None
    truth: Sequence[float] | None = None
    time_s: float = 0.0
    duration_s: float | None = None
    speed: float = 0.0
    counts: Mapping[str, int] = field(default_factory=dict)


def render(screen: Screen) -> RenderableType:
    """The picture, at most 80 columns wide: state of the craft, the nine errors, the progress."""
    return Group(_heading(screen), _table(screen.estimate, screen.truth), _progress(screen))


def plain_line(screen: Screen) -> str:
    """One line for a log: progress, verdict, bias with 3 sigma, largest 3 sigma of D, residual."""
    parts = [
        f"{screen.time_s:.0f} s" if screen.duration_s is None else f"{screen.time_s:.0f}/{screen.duration_s:.0f} s"
    ]
    parts.append(f"x{screen.speed:.0f}")
    estimate = screen.estimate
    if estimate is None:
        return "  ".join([*parts, "waiting for the first estimate"])
    parts.append(estimate.verdict.value)
    if estimate.verdict is not Verdict.NOT_STARTED:
        limits = [3.0 * sigma for sigma in sigmas(estimate)]
        bias = ", ".join(f"{b:.0f}+-{limit:.0f}" for b, limit in zip(estimate.bias_nt, limits[:3], strict=True))
        parts.append(f"b ({bias}) nT  D +-{max(limits[3:]):.1e}")
        parts.append(f"rms {estimate.residual_rms_nt:.0f}/{estimate.noise_nt:.0f} nT")
        if screen.truth is not None:
            parts.append(f"in 3s {sum(_inside_all(estimate, screen.truth))}/{len(PARAMETERS)}")
    return "  ".join(parts)


def _inside_all(estimate: Estimate, truth: Sequence[float]) -> list[bool]:
    triples = zip(values(estimate), truth, sigmas(estimate), strict=True)
    return [inside(value - true, sigma) for value, true, sigma in triples]


def _heading(screen: Screen) -> Table:
    grid = Table.grid(padding=(0, 1))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    estimate = screen.estimate
    if estimate is None:
        grid.add_row("craft", "waiting for the first estimate")
        return grid
    grid.add_row("craft", Text(f"{estimate.craft}, method {estimate.method}, tick {estimate.tick}"))
    verdict = Text(estimate.verdict.value, style=_STYLES[estimate.verdict])
    verdict.append(": " + ", ".join(estimate.reasons) if estimate.reasons else "", style="default")
    grid.add_row("verdict", verdict)
    if estimate.remedy:
        grid.add_row("remedy", Text(estimate.remedy))
    grid.add_row("residual", f"{estimate.residual_rms_nt:.1f} nT rms, sensor noise {estimate.noise_nt:.1f} nT")
    counts = {"used": estimate.samples_used, **screen.counts}
    grid.add_row("samples", Text(", ".join(f"{name} {count}" for name, count in counts.items())))
    return grid


def _table(estimate: Estimate | None, truth: Sequence[float] | None) -> Table:
    table = Table(header_style="bold")
    table.add_column("error")
    table.add_column("unit")
    for name in ("estimate", "3 sigma", *(("truth", "off by") if truth is not None else ())):
        table.add_column(name, justify="right", min_width=8)
    if truth is not None:
        table.add_column("inside (sigmas)", no_wrap=True)
    started = estimate is not None and estimate.verdict is not Verdict.NOT_STARTED
    for i, parameter in enumerate(PARAMETERS):
        cells: list[str | Text] = [_UNKNOWN, _UNKNOWN]
        tail: list[str | Text] = [] if truth is None else [parameter.text(truth[i]), _UNKNOWN, ""]
        if started and estimate is not None:
            value, sigma = values(estimate)[i], sigmas(estimate)[i]
            cells = [parameter.text(value), parameter.text(3.0 * sigma)]
            if truth is not None:
                error = value - truth[i]
                tail = [parameter.text(truth[i]), parameter.text(error, "+"), _mark(error, sigma)]
        table.add_row(parameter.name, parameter.unit, *cells, *tail, end_section=i == 2)
    return table


def _mark(error: float, sigma: float) -> Text:
    ratio = abs(error) / sigma if sigma > 0.0 else math.inf
    good = inside(error, sigma)
    return Text(f"{'yes' if good else 'NO'} ({ratio:.1f})", style="green" if good else "bold red")


def _progress(screen: Screen) -> Table:
    grid = Table.grid(padding=(0, 1))
    grid.add_column(no_wrap=True)
    if screen.duration_s is None:
        grid.add_row(f"{screen.time_s:.0f} s of samples, x{screen.speed:.0f}")
        return grid
    grid.add_column(no_wrap=True)
    bar = ProgressBar(total=screen.duration_s, completed=min(screen.time_s, screen.duration_s), width=40)
    grid.add_row(bar, f"{screen.time_s:.0f} of {screen.duration_s:.0f} s, x{screen.speed:.0f}")
    return grid


class LiveTable:
    """Shows the newest estimate: a picture that is redrawn on a terminal, one line every 10 s elsewhere.

    Parameters
    ----------
    duration_s: sample time at the end [s], None where there is none.
    console: where to show it; standard output where None.
    clock: monotonic wall time [s].
    leave: whether the last picture is left standing at the end.

    Use it as a context; ``update`` is cheap and may be called for every estimate.
    """

    def __init__(
        self,
        duration_s: float | None = None,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
        leave: bool = True,
    ) -> None:
        self.console = console if console is not None else Console()
        self.screen = Screen(duration_s=duration_s)
        self._clock, self._leave = clock, leave
        self._begin_s: float | None = None
        self._line_s = -math.inf
        self._live: Live | None = None

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live = Live(
                get_renderable=lambda: render(self.screen), console=self.console, refresh_per_second=4, transient=True
            )
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.finish()

    def update(
        self,
        time_s: float,
        estimate: Estimate | None,
        truth: Sequence[float] | None = None,
        counts: Mapping[str, int] | None = None,
    ) -> None:
        """Show this from now on; ``time_s`` is the sample time since the start [s]."""
        now_s = self._clock()
        if self._begin_s is None:
            self._begin_s = now_s
        elapsed_s = now_s - self._begin_s
        speed = time_s / elapsed_s if elapsed_s > 0.0 else 0.0
        self.screen = Screen(estimate, truth, time_s, self.screen.duration_s, speed, dict(counts or {}))
        if self._live is None and now_s - self._line_s >= PLAIN_EVERY_S:
            self._line_s = now_s
            self.console.print(plain_line(self.screen), soft_wrap=True, markup=False, highlight=False)

    def finish(self) -> None:
        """Stop redrawing and leave the last picture standing where wanted; may be called twice."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        if self._leave and self._begin_s is not None:
            self._begin_s = None
            self.console.print(render(self.screen))
