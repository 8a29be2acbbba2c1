"""What a study is: a name, a question, and a function from a request to its findings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from magcal_service.many.executor import Executor
from magcal_service.studies.report import Findings


@dataclass(frozen=True, slots=True)
class Request:
    """How a study is to be run.

    Parameters
    ----------
    runs: Monte-Carlo runs; None: the study's default (``run_study`` fills it in).
    seed: of the whole study; every run draws from a child of it.
    executor: where the work is done.
    methods: names of the estimators to compare, where the study compares any; empty: its default.
    duration_s: length of a flight [s]; None: the study's default.  Shorter ones give a quick result.
    """

    runs: int | None
    seed: int
    executor: Executor
    methods: tuple[str, ...] = ()
    duration_s: int | None = None


@dataclass(frozen=True, slots=True)
class Study:
    """An entry of the registry: name, one line about it, its usual number of runs, and how it is done."""

    name: str
    summary: str
    runs: int
    run: Callable[[Request], Findings]
