"""Where many pieces of work are done, and what is kept of them.

The pieces depend on the arguments of the command alone, never on the engine or the number of workers, and each has its
own seed; so every engine gives the same bits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, TypeVar

from magcal_service.base.errors import ConfigError, Fault, MagcalError
from magcal_service.base.progress import Work
from magcal_service.many.cluster import Cluster
from magcal_service.many.identity import code_of, content_of, key_of
from magcal_service.many.pieces import Done, Failed, Outcome, Piece, Refused, Task
from magcal_service.many.pool import Pool
from magcal_service.many.progress import shown
from magcal_service.many.store import Store

Job = TypeVar("Job")
Result = TypeVar("Result")

POOL: Final = "pool"
_CLUSTER: Final = re.compile(r"dask://(?P<address>(\[[0-9A-Fa-f:]+\]|[^\s/:@\[\]]+):(?P<port>\d{1,5}))/?")


class Engine(Protocol):
    """Does tasks in whatever order; only outcomes differ from engine to engine where a worker died."""

    def run(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        """Number and outcome of each task as it ends."""


class PieceRefusedError(MagcalError):
    """The input of a piece was refused; the text and the exit code are those of the error there."""

    def __init__(self, refused: Refused) -> None:
        self.exit_code = refused.exit_code
        super().__init__(refused.text)


class PiecesFailedError(MagcalError):
    """Pieces that came to nothing, by name; everything else is done, and kept where there is a store."""

    exit_code = 1

    def __init__(self, failed: Sequence[tuple[str, Failed]]) -> None:
        super().__init__("\n".join(f"{name}: failed: {outcome.text}" for name, outcome in failed))
        for _, outcome in failed:
            self.add_note(outcome.trace)


@dataclass(frozen=True, slots=True)
class Executor:
    """An engine, and a store for what it has finished.

    Parameters
    ----------
    engine: where the work is done.
    store: where results are kept, and found again; None: nowhere.
    """

    engine: Engine
    store: Store | None = None

    def outcomes(self, what: str, pieces: Sequence[Piece]) -> Iterator[Outcome]:
        """The outcome of each piece, in their order, as soon as it and those before it are known.

        Parameters
        ----------
        what: as the progress calls it.
        pieces: all of them; the ones that the store holds are not done again.

        Raises ``InputRefusedError`` where the store cannot be written, and what the engine raises.
        """
        ended: dict[int, Outcome] = {}
        following = 0
        count = Work(what, sum(piece.size for piece in pieces))
        with shown(count) as show:
            for number, outcome, kept in self._ended(pieces):
                ended[number] = outcome
                count.done += pieces[number].size
                count.kept += pieces[number].size if kept else 0
                count.failed += 0 if isinstance(outcome, Done) else pieces[number].size
                show()
                while following in ended:
                    yield ended.pop(following)
                    following += 1

    def _ended(self, pieces: Sequence[Piece]) -> Iterator[tuple[int, Outcome, bool]]:
        """Number and outcome of each piece as it ends, and whether it was kept from before."""
        inputs = [tuple((path, content_of(path)) for path in piece.inputs) for piece in pieces]
        keys: dict[int, str] = {}
        if self.store is not None:
            keys = {n: key_of(p.function, p.argument, i) for n, (p, i) in enumerate(zip(pieces, inputs, strict=True))}
        waiting = []
        for number in range(len(pieces)):
            done = self.store.get(keys[number]) if self.store is not None else None
            if done is None:
                waiting.append(number)
            else:
                yield number, done, True
        tasks = [Task(pieces[n].function, pieces[n].argument, inputs[n], code_of(pieces[n].function)) for n in waiting]
        for place, outcome in self.engine.run(tasks):
            if self.store is not None and isinstance(outcome, Done):
                self.store.put(keys[waiting[place]], outcome)
            yield waiting[place], outcome, False

    def map(
        self,
        function: Callable[[Job], Result],
        jobs: Sequence[Job],
        what: str = "pieces",
        *,
        size: Callable[[Job], int] = lambda job: 1,
        inputs: Sequence[Path] = (),
    ) -> Iterator[Result]:
        """The result of the function for each job, in their order, each as soon as it is known.

        Parameters
        ----------
        what: as the progress calls it.
        size: how much a job counts in the progress.
        inputs: files that every job reads.

        Raises
        ------
        PieceRefusedError: at once, where a job raises a ``MagcalError``.
        PiecesFailedError: at the end, where jobs met a defect or their workers died.
        """
        pieces = [Piece(f"{what}, {n}", function, job, tuple(inputs), size(job)) for n, job in enumerate(jobs)]
        failed: list[tuple[str, Failed]] = []
        for piece, outcome in zip(pieces, self.outcomes(what, pieces), strict=True):
            match outcome:
                case Done():
                    yield outcome.value
                case Refused():
                    raise PieceRefusedError(outcome)
                case Failed():
                    failed.append((piece.name, outcome))
        if failed:
            raise PiecesFailedError(failed)


def engine_for(executor: str = POOL, workers: int | None = None) -> Engine:
    """The engine of the command line.

    Parameters
    ----------
    executor: ``pool`` or ``dask://HOST:PORT``.
    workers: processes of a pool; None: one per core.

    Raises ``ConfigError`` for a word that is neither, fewer workers than one, or workers of a cluster.
    """
    if workers is not None and workers < 1:
        raise ConfigError([Fault("--workers", workers, "1 or more processes are accepted")])
    if executor == POOL:
        return Pool(workers or 0)
    found = _CLUSTER.fullmatch(executor)
    if found is None or not 0 < int(found["port"]) < 65536:
        accepted = f"{POOL} (processes on this machine) or dask://HOST:PORT is accepted, such as dask://127.0.0.1:8786"
        raise ConfigError([Fault("--executor", executor, accepted)])
    if workers is not None:
        accepted = "a cluster has the workers that were started for it; leave --workers out"
        raise ConfigError([Fault("--workers", workers, accepted)])
    return Cluster(found["address"])
