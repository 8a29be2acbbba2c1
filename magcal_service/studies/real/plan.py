"""Which real recordings there are, what is asked of them, and what is known of each from elsewhere.

The recordings are no part of the project; a name is the descriptor's path below its folder, without the suffix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.physics.effects import (
    bias_step,
    current_loop,
    position_offset,
    quantisation,
    spin_rate,
    thermal_scale,
)

DEFAULT_FOLDER: Final = Path("../shared/data")
"""Where the recordings lie beside a checkout."""

CASES: Final = "cases"
"""Folder beside the recordings', with small inputs that have one fault each; taken along where it is there."""


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of a recording without the diagnosis.

    Parameters
    ----------
    causes: effects that act there; empty: none does; None: nobody knows.
    beside: effects that are true besides and need not be found.
    witness: what says so.
    """

    causes: tuple[str, ...] | None = None
    beside: tuple[str, ...] = ()
    witness: str = "none"

    def is_false(self, name: str) -> bool | None:
        """Whether a name is false here; None where nobody knows."""
        return None if self.causes is None else name not in (*self.causes, *self.beside)


@dataclass(frozen=True, slots=True)
class Question:
    """One diagnosis that is asked for.

    Parameters
    ----------
    name: of the recording, or of several that are diagnosed together.
    paths: absolute paths of their descriptors.
    hidden: channels that are taken away before.
    known: what the answer is held against.
    """

    name: str
    paths: tuple[Path, ...]
    hidden: tuple[str, ...]
    known: Known


_SUNLIT: Final = Known(
    (thermal_scale.EFFECT.name, current_loop.EFFECT.name),
    beside=(spin_rate.EFFECT.name,),
    witness="photodiodes (edges of the shadow), the other days, gyro",
)
_CURRENT: Final = Known((current_loop.EFFECT.name,), witness="battery current, compass on the mast")
_MAGNET: Final = Known((bias_step.EFFECT.name,), witness="a magnet was attached and taken off")
_NOTHING: Final = Known((), witness="simulated without any physics beyond the sensor")

KNOWN: Final[Mapping[str, Known]] = {
    "aero-vista/recording": Known(
        (thermal_scale.EFFECT.name,), witness="thermometer on the sensor, reference in the coil"
    ),
    "ardupilot/log171-internal": _CURRENT,
    "ardupilot/log171-internal-attitude": _CURRENT,
    "broad/magnet-32": _MAGNET,
    "broad/magnet-34": _MAGNET,
    "iss-2022-ir/recording": Known(
        (position_offset.EFFECT.name,),
        (quantisation.EFFECT.name,),
        "element sets of the station; values in steps of 0.1 uT",
    ),
    "suchai3/2023-08-24": _SUNLIT,
    "suchai3/2023-11-13": _SUNLIT,
    "suchai3/2023-12-11": _SUNLIT,
    "suchai3/2024-passes": _SUNLIT,
    **{
        f"{case}/RECORDING": _NOTHING
        for case in (
            "altitude-unit",
            "control-characters",
            "cr-line-ends",
            "held-readings",
            "many-zero-rows",
            "millisecond-times",
            "minute-stamps",
            "position-without-fix",
            "zero-row",
        )
    },
}
"""By name.  That a spin changed is told by the gyro on every day of SUCHAI-3."""

DAYS: Final = ("suchai3/2023-08-24", "suchai3/2023-11-13", "suchai3/2023-12-11")
"""Days of one craft, to be diagnosed together."""

PLAN: Final[Sequence[tuple[tuple[str, ...], tuple[str, ...]]]] = (
    (("aero-vista/recording",), ("temperature",)),
    *(((day,), ("photodiodes",)) for day in DAYS),
    (DAYS, ("photodiodes",)),
    (DAYS, ()),
)
"""What is asked besides each recording as it is: names and hidden channels, where the recordings are there."""


def folders_of(given: Sequence[Path]) -> tuple[Path, ...]:
    """The folders to take: those given, or the default; to a single one the cases that lie beside it.

    Raises ``ConfigError`` for a folder that is not there.
    """
    folders = tuple(given) or (DEFAULT_FOLDER,)
    missing = [folder for folder in folders if not folder.is_dir()]
    if missing:
        accepted = (
            "a folder with descriptors of recordings (*.toml, also in folders below it) is accepted; recordings are no "
            "part of the project: name yours"
        )
        raise ConfigError([Fault("--recordings", str(folder), accepted) for folder in missing])
    beside = folders[0].absolute().parent / CASES
    return (*folders, beside) if len(folders) == 1 and beside.is_dir() else folders


def questions_of(given: Sequence[Path]) -> list[Question]:
    """Every descriptor below the folders as it is, then what ``PLAN`` asks of those that are there.

    Raises ``ConfigError`` for a folder that is not there, or holds no descriptor.
    """
    found: dict[str, tuple[Path, Known]] = {}
    for number, folder in enumerate(folders_of(given)):
        paths = sorted(folder.absolute().rglob("*.toml"))
        if not paths:
            accepted = (
                "a folder with descriptors (*.toml) is accepted; write one for each log (docs/recording-format.md)"
            )
            raise ConfigError([Fault("--recordings", str(folder), accepted)])
        for path in paths:
            name = path.relative_to(folder.absolute()).with_suffix("").as_posix()
            told = name if number == 0 else f"{folder.name}/{name}"
            found[told] = path, KNOWN.get(name, Known())
    asked = [Question(name, (path,), (), known) for name, (path, known) in found.items()]
    for names, hidden in PLAN:
        if all(name in found for name in names):
            together = tuple(found[name][0] for name in names)
            asked.append(Question(_together(names), together, hidden, found[names[0]][1]))
    return asked


def _together(names: Sequence[str]) -> str:
    """One name for several recordings: the first in full, of the others what differs."""
    folder, _, first = names[0].rpartition("/")
    return f"{folder}/{' + '.join([first, *(name.rpartition('/')[2] for name in names[1:])])}".lstrip("/")
