"""How many commands a craft takes: what is beyond is refused before it costs a write, a checkpoint or a log line."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

from magcal_service.config.daemon_settings import CommandsConfig
from magcal_service.links.rate_limit import RateLimit
from magcal_service.wire.messages import Command

log = logging.getLogger("magcal")

LIMITED: Final = "commands_limited"
"""Counts commands that were refused for the limit."""


class CommandLimit:
    """An allowance for each craft, whoever the commands say they are from: a source's name can be invented.

    Parameters
    ----------
    config: rate and burst.
    counters: where refused commands are counted, as ``LIMITED``.
    clock: monotonic time [s].
    """

    def __init__(
        self, config: CommandsConfig, counters: Counter[str], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._config, self._counters, self._clock = config, counters, clock
        self._taken: dict[str, RateLimit] = {}
        self._answered: dict[str, RateLimit] = {}

    def refusal(self, command: Command) -> str:
        """Why a command is refused now, and when to try again; empty where it may pass, and is then counted off."""
        craft, now_s = command.craft, self._clock()
        bucket = self._bucket(self._taken, craft)
        if bucket.allows(craft, now_s):
            return ""
        settings, wait_s = self._config, math.ceil(bucket.wait_s(craft, now_s))
        why = (
            f"too many commands: {settings.burst} at once and {settings.rate_per_min:g} a minute are accepted for "
            f"craft {craft}; try again in {wait_s} s"
        )
        if craft not in self._answered:  # the first that is refused
            text = "%s: command %s of %s is refused: %s; the next ones are counted (commands_limited), not logged"
            log.warning(text, craft, command.name, command.source, why)
            self._bucket(self._answered, craft)
        self._counters[LIMITED] += 1
        return why

    def answers(self, craft: str) -> bool:
        """Whether one more refused command of a craft is answered now: as many as are accepted, and no more."""
        return self._bucket(self._answered, craft).allows(craft, self._clock())

    def _bucket(self, buckets: dict[str, RateLimit], craft: str) -> RateLimit:
        if craft not in buckets:
            buckets[craft] = RateLimit(self._config.rate_per_min / 60.0, self._config.burst)
        return buckets[craft]
