"""Pieces of work for the engines: functions that a worker can import."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError


def squared(value: int) -> int:
    """Nothing to it."""
    return value * value


def solved(seed: np.random.SeedSequence) -> bytes:
    """Bits of a solution that depends on the seed, and on the order in which linear algebra adds."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((120, 120))
    return np.linalg.solve(matrix @ matrix.T, rng.standard_normal(120)).tobytes()


def threads(_: int) -> str | None:
    """How many threads the worker's linear algebra was told to have."""
    return os.environ.get("OPENBLAS_NUM_THREADS")


def noted(job: tuple[Path, int]) -> int:
    """Adds a line to a file, so that it can be counted how often this was done."""
    path, value = job
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{value}\n")
    return value + 100


def length(path: Path) -> int:
    """What is in a file, as far as it goes."""
    return len(path.read_bytes())


def killed_once(job: tuple[Path, int]) -> int:
    """Value 1 kills its process at the first attempt, as the kernel does where memory runs out."""
    path, value = job
    noted(job)
    if value == 1 and path.read_text(encoding="utf-8").split().count("1") == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return value + 100


def killed_always(job: tuple[Path, int]) -> int:
    """Value 1 kills its process at every attempt."""
    noted(job)
    if job[1] == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return job[1] + 100


def divided(value: int) -> float:
    """A defect for 0, a refusal below."""
    if value < 0:
        raise InputRefusedError([Fault("value", value, "0 or more is accepted")])
    return 1.0 / value


def not_to_be_pickled(_: int) -> object:
    """A result that cannot leave its process."""
    return lambda: None
