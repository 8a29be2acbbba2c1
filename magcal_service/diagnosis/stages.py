"""The steps of a diagnosis in their order, for whoever shows how far it has come.

How long a step takes is not known before: the search ends where no further effect is found, and is made again where the
noise, the field model or pulses of torquers ask for it.  ``forecast`` says what is usual.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

Progress = Callable[[str], None]
"""Called with the step that begins."""

READING: Final = "reading"
SIMULATING: Final = "simulating with nine errors alone"
SEARCHING: Final = (
    "looking for an effect",
    "looking for a second effect",
    "looking for a third effect",
)
"""One for each effect that a search may keep."""

RIVALS: Final = "comparing the effects with their rivals"
COMPARING: Final = "comparing the recordings with one another"
LEFT: Final = "looking for what is left"
TURNING: Final = "looking at attitude and noise"
MODELLING: Final = "modelling what has no name"
WRITING: Final = "writing the results"

STEPS: Final = (READING, SIMULATING, *SEARCHING, RIVALS, LEFT, TURNING, MODELLING, WRITING)
"""Of one recording; what is not needed is passed over."""

JOINT_STEPS: Final = (READING, SIMULATING, *SEARCHING, RIVALS, COMPARING, LEFT, WRITING)
"""Of several recordings together."""


def untold(_: str) -> None:
    """Nobody is shown how far it is."""
