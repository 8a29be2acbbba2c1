"""What a study is: a name, a question, and a function from a request to its findings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from magcal_service.many.executor import Executor
from magcal_service.studies.report import Findings


@dataclass(frozen=True, slots=True)
class Request:
    """How a study is to be run.

    Parameters
    ----------
    runs: Monte-Carlo runs; None: the study's default (``run_study`` fills it in), and where it draws none.
    seed: of the whole study; every run draws from a child of it.
    executor: where the work is done.
    methods: names of the estimators to compare, where the study compares any; empty: its default.
    duration_s: length of a flight [s]; None: the study's default.  Shorter ones give a quick result.
    recordings: folders with descriptors, for a study of recordings; empty: its default.
    scenarios, noises_nt, motions: which of its scenarios, noises [nT] and ways to turn, for a study that has some;
        empty: all.
    """

    runs: int | None
    seed: int
    executor: Executor
    methods: tuple[str, ...] = ()
    duration_s: int | None = None
    recordings: tuple[Path, ...] = ()
    scenarios: tuple[str, ...] = ()
    noises_nt: tuple[float, ...] = ()
    motions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Study:
    """An entry of the registry.

    Parameters
    ----------
    name, summary: what it is called, and one line about it.
    runs: its usual number of Monte-Carlo runs; 0: it draws none, but takes recordings.
    run: how it is done.
    scenarios, motions: names of the scenarios and of the ways to turn it can be asked for; empty where it has none.
    """

    name: str
    summary: str
    runs: int
    run: Callable[[Request], Findings]
    scenarios: tuple[str, ...] = ()
    motions: tuple[str, ...] = ()

    @property
    def takes_recordings(self) -> bool:
        """Whether it asks recordings that are there, instead of drawing flights."""
        return self.runs == 0
