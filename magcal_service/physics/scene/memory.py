"""What an effect with a memory carries along a stream, and when a stream begins as a model's recording did."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from magcal_service.model import Array


@dataclass(slots=True, eq=False)
class Memory:
    """What an effect with a memory carries from one scene of a stream to the next, which begins at row ``next_row``.

    ``begins_anew``: the stream does not begin where the model's recording did, so its start is another.
    """

    next_row: int = -1
    states: dict[str, Array] = field(default_factory=dict)
    begins_anew: bool = False


AT_START_S: Final = 60.0
"""How close to a recording's start a stream has to begin to take its start temperature from it [s].

Choice: half of the shortest time constant that is searched; later, what was free at the start has decayed unseen.
"""
