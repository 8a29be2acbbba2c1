"""The workers of a dask cluster as an engine."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from magcal_service.base.errors import ConfigError, ExtraMissingError, Fault, MagcalError
from magcal_service.many.pieces import THREAD_COUNTS, Failed, Outcome, Refused, Task, failure, perform

_ANSWER_S: Final = 10.0
"""Choice: a distant network, doubled."""

_GONE: Final = "the dask scheduler is gone; what had finished is kept, and --resume goes on from there"
_LOGGERS: Final = ("distributed", "distributed.client", "tornado.application")
"""Each has a level of its own."""


class LostError(MagcalError):
    """The scheduler is gone; what had finished is kept."""


class Cluster:
    """An engine of workers that a dask scheduler has, on this machine or others.

    Parameters
    ----------
    address: ``HOST:PORT`` of the scheduler.
    answer_s: how long it may take to answer, and its first worker to be there [s].
    """

    def __init__(self, address: str, answer_s: float = _ANSWER_S) -> None:
        self.address, self.answer_s = address, answer_s

    def run(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        """Number and outcome of each task as it ends.

        As many are on their way as there are workers, so a worker's death concerns one.  The scheduler begins that one
        again elsewhere, as often as its ``allowed-failures`` says.

        Raises ``ExtraMissingError`` without dask, ``ConfigError`` where no scheduler or worker answers, ``LostError``
        where the scheduler goes away meanwhile.
        """
        if not tasks:
            return
        try:
            import distributed  # noqa: F401
        except ImportError:
            raise ExtraMissingError("distributed", "cluster", "--executor dask://HOST:PORT") from None
        with _silence():
            client = self._client()
            try:
                yield from _outcomes(client, tasks)
            except OSError:  # of a connection; what a piece raises is an outcome
                raise LostError(_GONE) from None
            finally:
                client.close()

    def _client(self) -> Any:
        from distributed import Client

        try:
            client = Client(f"tcp://{self.address}", timeout=self.answer_s, set_as_default=False)
        except (OSError, TimeoutError):
            accepted = "no scheduler answers there; start one with: dask scheduler --host HOST --port PORT"
            raise ConfigError([Fault("--executor", f"dask://{self.address}", accepted)]) from None
        try:
            client.wait_for_workers(1, timeout=self.answer_s)
        except TimeoutError:
            client.close()
            accepted = f"its scheduler has no worker; start some with: dask worker tcp://{self.address} --nthreads 1"
            raise ConfigError([Fault("--executor", f"dask://{self.address}", accepted)]) from None
        return client


@contextmanager
def _silence() -> Iterator[None]:
    """Dask logs traces of what is an outcome here, or an error with a text of its own."""
    before = {logger: logger.level for logger in map(logging.getLogger, _LOGGERS)}
    for logger in before:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)


def _outcomes(client: Any, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
    from distributed import as_completed

    waiting = deque(range(len(tasks)))
    numbers: dict[Any, int] = {}
    ended = as_completed(loop=client.loop, raise_errors=False)

    def give() -> None:
        while waiting and len(numbers) < max(1, len(client.nthreads())):
            number = waiting.popleft()
            future = client.submit(_perform_alone, tasks[number], pure=False)
            numbers[future] = number
            ended.add(future)

    give()
    for future in ended:
        number = numbers.pop(future)
        yield number, _outcome(future)
        future.release()
        give()


def _outcome(future: Any) -> Outcome:
    from distributed import KilledWorker

    if future.status in ("cancelled", "lost"):
        raise LostError(_GONE)
    exc = future.exception()
    if exc is None:
        outcome: Outcome = future.result()
        return outcome
    if isinstance(exc, KilledWorker):
        return Failed("its worker died each time it was begun; was there memory enough?")
    return failure(exc)


def _perform_alone(task: Task) -> Outcome:
    """``perform``, on a worker whose linear algebra has one thread, as everywhere else."""
    many = {name: os.environ.get(name, "as many as cores") for name in THREAD_COUNTS if os.environ.get(name) != "1"}
    if not many:
        return perform(task)
    accepted = "1 is accepted, which a worker's nanny sets; start it with: dask worker ADDRESS --nthreads 1"
    return Refused("\n".join(str(Fault(f"worker's {name}", value, accepted)) for name, value in many.items()), 2)
