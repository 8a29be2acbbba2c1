"""An engine without processes, for what is not about engines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from magcal_service.many.executor import Executor
from magcal_service.many.pieces import Outcome, Task, perform


class Here:
    """Everything in this process, one task after the other."""

    def run(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Outcome]]:
        """See ``Engine``."""
        return ((number, perform(task)) for number, task in enumerate(tasks))


HERE = Executor(Here())
