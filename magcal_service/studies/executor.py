"""Where the work of a study is done: here, or in a pool of processes.

A study cuts itself into jobs that depend on its arguments alone and never on the number of workers, and each run draws
from its seed; so every executor gives the same numbers.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Final, Protocol, TypeVar

from magcal_service.errors import ConfigError, Fault

Job = TypeVar("Job")
Result = TypeVar("Result")

_THREADS: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Executor(Protocol):
    """Maps a function over jobs.  Function, jobs and results have to be picklable; the function is one of a module."""

    def map(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """The results in the order of the jobs, each as soon as it is known."""


class InProcess:
    """Everything here, one job after the other."""

    def map(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """See ``Executor``."""
        return map(function, jobs)


class ProcessPool:
    """A pool of fresh processes (spawned, never forked), one thread each.

    Parameters
    ----------
    workers: processes; 0: one per core.
    """

    def __init__(self, workers: int = 0) -> None:
        self.workers = workers or os.cpu_count() or 1

    def map(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        """See ``Executor``; the pool lives as long as its results are asked for."""
        context = multiprocessing.get_context("spawn")
        workers = min(self.workers, max(1, len(jobs)))
        with _one_thread_each(), ProcessPoolExecutor(workers, mp_context=context) as pool:
            futures = [pool.submit(function, job) for job in jobs]
            try:
                for future in futures:
                    yield future.result()
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile keep their linear algebra to one thread: the pool is what fills the cores."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def executor_for(workers: int | None) -> Executor:
    """``InProcess`` for one worker, else a pool; None: one per core.  Raises ConfigError for fewer than one."""
    if workers is not None and workers < 1:
        raise ConfigError([Fault("--workers", workers, "1 or more processes are accepted")])
    return InProcess() if workers == 1 else ProcessPool(workers or 0)
