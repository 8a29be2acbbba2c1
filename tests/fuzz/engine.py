"""Feeds a target mutated inputs, keeps those that end somewhere new, and says what broke.

Where an input ends (what its target returned, or the lines through which its error came and the fields that it names)
stands in for coverage: an input that ends at a new place joins the pool that later ones are made from.  The same seed
gives the same inputs.
"""

from __future__ import annotations

import re
import resource
import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType

from magcal_service.base.errors import InputRefusedError
from tests.fuzz.limits import HANG_S, MOST_MB
from tests.fuzz.mutate import mutate
from tests.fuzz.targets import Target

_MOST_KEPT = 2000  # inputs of at most 64 KB each: a quarter of what ``MOST_MB`` allows
_DIGITS = re.compile(r"\d+")


class HangError(BaseException):
    """An input took longer than ``HANG_S``; no reader's own ``except`` may swallow it."""


@dataclass(frozen=True)
class Crash:
    """An input that did what none may do."""

    target: str
    data: bytes
    told: str


@dataclass
class Totals:
    """What became of a target's inputs."""

    target: str
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    places: set[int] = field(default_factory=set)
    slowest_s: float = 0.0
    seconds: float = 0.0
    crashes: list[Crash] = field(default_factory=list)
    found: list[bytes] = field(default_factory=list)


def fuzz(target: Target, inputs: int, seed: int, most_crashes: int = 10) -> Totals:
    """Run a target.

    Parameters
    ----------
    inputs: how many; the seeds and the corpus come first and count.
    seed: of the random stream; each target has its own.
    most_crashes: the run ends after this many.
    """
    totals = Totals(target.name)
    rng = Random(f"{seed} {target.name}")
    first = [*target.seeds(), *target.corpus()]
    pool = list(first)
    begin = time.monotonic()
    with _limits():
        for number in range(inputs):
            data = first[number] if number < len(first) else _next(rng, first, pool, target)
            before = time.process_time()
            place = _try(target, data, totals)
            totals.slowest_s = max(totals.slowest_s, time.process_time() - before)
            if hash(place) not in totals.places:
                totals.places.add(hash(place))
                if len(totals.found) < _MOST_KEPT:
                    totals.found.append(data)
                    pool.append(data)
            if len(totals.crashes) >= most_crashes:
                break
    totals.seconds = time.monotonic() - begin
    return totals


def _next(rng: Random, first: list[bytes], pool: list[bytes], target: Target) -> bytes:
    """From the sound inputs as often as from those that ended somewhere new, most of which were refused."""
    return mutate(rng, first if rng.random() < 0.5 else pool, target.tokens, target.own)


def _try(target: Target, data: bytes, totals: Totals) -> tuple[object, ...]:
    """Feed one input; where it ended."""
    totals.inputs += 1
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        outcome = target.run(data)
    except target.refuses as error:
        totals.refused += 1
        return (type(error).__name__, *_path(error), *_faults(error))
    except (Exception, HangError, RecursionError) as error:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        path = (type(error).__name__, *_path(error))
        if hash(path) not in totals.places:
            totals.crashes.append(Crash(target.name, data, "".join(traceback.format_exception(error)[-12:])))
        return path
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    totals.accepted += 1
    return ("accepted", outcome)


def _path(error: BaseException) -> Iterator[int]:
    """The lines through which an error came, each once: how deep it was nested is no new place."""
    lines = dict[int, None]()
    entry = error.__traceback__
    while entry is not None:
        lines[entry.tb_lineno] = None
        entry = entry.tb_next
    yield from lines


def _faults(error: BaseException) -> Iterator[str]:
    """What an input was refused for, without the numbers in it."""
    if isinstance(error, InputRefusedError):
        yield from {_DIGITS.sub("#", fault.where) for fault in error.faults}


@contextmanager
def _limits() -> Iterator[None]:
    """Hangs and memory without bound become exceptions."""

    def hang(number: int, frame: FrameType | None) -> None:
        raise HangError(f"more than {HANG_S} s")

    handler = signal.signal(signal.SIGPROF, hang)
    limits = resource.getrlimit(resource.RLIMIT_DATA)
    lines = Path("/proc/self/status").read_text().splitlines()
    used = int(next(line for line in lines if line.startswith("VmData")).split()[1]) * 1024
    resource.setrlimit(resource.RLIMIT_DATA, (used + MOST_MB * 1_000_000, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, limits)
        signal.signal(signal.SIGPROF, handler)
