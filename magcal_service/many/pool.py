"""A pool of processes in which a worker's death costs its piece alone.

``concurrent.futures`` breaks the whole pool, and nobody can say whose piece it was.  Here each worker has a pipe of its
own, so the piece it held is known: it is begun again, by another process, ``ATTEMPTS`` times in all.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Final

from magcal_service.many.pieces import ATTEMPTS, THREAD_COUNTS, Outcome, Task, died, failure, perform

_SPAWN: Final = multiprocessing.get_context("spawn")
"""Fresh processes: a fork would copy threads' locks, and linear algebra that has its threads already."""


class Pool:
    """An engine of processes on this machine, one thread of linear algebra each.

    Parameters
    ----------
    workers: processes; 0: one per core.
    """

    def __init__(self, workers: int = 0) -> None:
        self.workers = workers or os.cpu_count() or 1

    def run(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        """Number and outcome of each task as it ends; the processes live as long as outcomes are asked for."""
        waiting = deque(range(len(tasks)))
        begun: Counter[int] = Counter()
        workers = [_Worker() for _ in range(min(self.workers, len(tasks)))]
        try:
            while waiting or any(worker.task is not None for worker in workers):
                for worker in workers:
                    if worker.task is None and waiting:
                        number = waiting.popleft()
                        begun[number] += 1
                        worker.give(number, tasks[number])
                for worker in _ended(workers):
                    number, outcome = worker.take()
                    if outcome is None:
                        code = worker.end()
                        workers[workers.index(worker)] = _Worker()
                        if begun[number] < ATTEMPTS:
                            waiting.append(number)
                            continue
                        outcome = died(code)
                    yield number, outcome
        finally:
            for worker in workers:
                worker.end()


WORKER: Final = "magcal piece worker"
"""Name of each of the pool's processes, as ``multiprocessing.active_children`` has it."""


class _Worker:
    """One process, its pipe, and the number of the task that it holds."""

    def __init__(self) -> None:
        self.connection, theirs = _SPAWN.Pipe()
        self.task: int | None = None
        self._process = _SPAWN.Process(target=_serve, args=(theirs,), name=WORKER, daemon=True)
        with _one_thread_each(), _interrupts_blocked():
            self._process.start()
        theirs.close()

    def give(self, number: int, task: Task) -> None:
        """Hand over a task; a worker that is dead shows that when its answer is taken."""
        self.task = number
        with suppress(OSError):
            self.connection.send(task)

    def take(self) -> tuple[int, Outcome | None]:
        """Number and outcome of its task; None where the process died."""
        assert self.task is not None
        number, self.task = self.task, None
        try:
            outcome: Outcome = self.connection.recv()
        except (EOFError, OSError):
            return number, None
        return number, outcome

    def end(self) -> int | None:
        """End the process, whatever it does; its exit code."""
        self.connection.close()
        self._process.terminate()
        self._process.join()
        return self._process.exitcode


def _ended(workers: Sequence[_Worker]) -> list[_Worker]:
    """Those of the busy workers that have something to say, or are dead; waits for the first."""
    busy = {worker.connection: worker for worker in workers if worker.task is not None}
    return [busy[connection] for connection in wait(list(busy)) if isinstance(connection, Connection)]


def _serve(connection: Connection) -> None:
    """The life of a worker: a task, its outcome, until whoever asks is gone."""
    while True:
        try:
            answer = perform(connection.recv())
        except (EOFError, OSError):
            return
        except Exception as exc:  # a task whose function is not to be found here
            answer = failure(exc)
        try:
            connection.send(answer)
        except OSError:
            return
        except Exception as exc:  # a result that cannot leave its process
            connection.send(failure(exc))


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile keep their linear algebra to one thread: the pool is what fills the cores."""
    before = {name: os.environ.get(name) for name in THREAD_COUNTS}
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes started meanwhile do not hear Ctrl-C, which reaches the whole group: the parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
