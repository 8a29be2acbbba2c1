"""A stream that begins where the model's recording did not: its temperature at the start is estimated in minutes.

What follows light with a time constant tau has at time t after the start the unknown part y exp(-t / tau), which enters
linearly: with B_0 the sample compensated for y = 0 and g its field for y = 1,

    e = |(I + D)(B_0 - y g exp(-t / tau)) - b| - |H|.

y and the nine errors are fitted together to the ticks so far, y with a prior of half the swing between light and
shadow.  As long as a vector may be wrong by more than the noise for what is not known of y, nothing is compensated: the
craft is one without ``physics.toml``, and says so.  Then an estimator is given all ticks again, compensated by that y,
and takes over once it has a start; what remains unknown is in the covariance of the vectors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.parts.magnitude_fit import MagnitudeFit, magnitude_fit
from magcal_service.model import Array
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample

_PRIOR: Final = 0.5
"""1 sigma of a temperature at the start, in units of the swing between light and shadow; light keeps it within one."""

_FIRST: Final = 150
"""Ticks before the first look: in fewer the nine errors are not known."""

_LATER: Final = 1.2
"""Times as many ticks before the next one: the ticks are given again at each that may be the last."""

_MOST: Final = 1800
"""Ticks that are kept: half an hour; what is not known by then stays in the covariance."""

_FITTED: Final = 600
"""Ticks that a fit takes at most, evenly of all: its cost is that of one look of the watch."""

_AT_WORST: Final = 0.3
"""By how much a decay exp(-t / tau) is off its mean since the start at most, at twice the time constant."""

_WORSE: Final = 1.02
"""Times the residual without compensation that the one with it may have: else the model does not fit."""

_LATEST: Final = 5400
"""Ticks after which a model that has fitted no better than none with any start does not fit: an orbit."""

_SKIPPED: Final = 1200
"""Ticks without some driver after which none is waited for: the other effects are compensated, these are left out."""

_MOST_OPEN: Final = 6000
"""Samples whose tick is not kept yet, at most: 10 min at 10 Hz, longer than a reference is waited for.

No tick is kept while frozen or without a reference.
"""


@dataclass(init=False, repr=False, eq=False)
class SettlingMemory:
    """What of ``Settling`` outlives a restart, saved and restored whole."""

    ticks: TickAssembler
    _waiting: list[MagnetometerSample]
    _fields: dict[float, Array]
    _raw: dict[float, Array]
    _kept: list[Tick]
    _kept_fields: list[Array]
    _kept_raw: list[Array]
    _skipped: int
    _seen: int
    _look: int


class Settling(Stateful, SettlingMemory):
    """One craft whose start is not known yet.

    Parameters
    ----------
    config: the craft's configuration.
    compensation: its own, whose start is free.
    """

    def __init__(self, config: CraftConfig, compensation: Compensation) -> None:
        self._compensation = compensation
        self.ticks = TickAssembler(config.ticks, config.sensor)
        self.ticks.wait_longer(compensation.wait_s)
        self._waiting = []
        self._fields, self._raw = {}, {}  # of samples whose tick is open, by their time
        self._kept, self._kept_fields, self._kept_raw = [], [], []
        self._skipped, self._seen, self._look = 0, 0, _FIRST

    @property
    def is_late(self) -> bool:
        """Whether an orbit has passed in which no start made the model fit."""
        return self._seen >= _LATEST

    def reference(self, sample: ReferenceSample) -> None:
        """Take a reference, as the model corrects it."""
        self.ticks.add_reference(self._compensation.reference(sample))

    def sample(self, sample: MagnetometerSample) -> None:
        """Take a sample as it was measured; it is worked through in ``advance``, after its vector has left."""
        self._waiting.append(sample)

    def advance(self, *, frozen: bool, flush: bool = False) -> bool:
        """Process what has come; whether it is time to look (``settled``)."""
        waiting, self._waiting = self._waiting, []
        for sample in waiting:
            self._take(sample)
        for tick in self.ticks.flush() if flush else self.ticks.ready():
            if tick.times_s.size and not frozen:
                self._keep(tick)
        if self._seen < self._look:
            return False
        self._look = round(_LATER * self._seen)
        return True

    def _take(self, sample: MagnetometerSample) -> None:
        if self.ticks.rejection(sample) is not None:
            return
        corrected = self._compensation.correct(sample)
        self.ticks.take(sample, corrected)
        if not self._compensation.missing or self._skipped >= _SKIPPED:
            elapsed_s = self.ticks.elapsed_s(sample)
            self._fields[elapsed_s] = self._compensation.start_fields
            self._raw[elapsed_s] = np.array(sample.field_body_nt)
            for open_ones in (self._fields, self._raw):
                if len(open_ones) > _MOST_OPEN:
                    del open_ones[next(iter(open_ones))]  # the oldest

    def _keep(self, tick: Tick) -> None:
        """Keep a tick of whose samples all drivers were there, the oldest no longer than there is room."""
        times_s = tick.times_s.tolist()
        whole = all(time_s in self._fields for time_s in times_s)
        if whole:
            self._seen += 1
            self._kept.append(tick)
            self._kept_fields.append(np.array([self._fields[time_s] for time_s in times_s]))
            self._kept_raw.append(np.array([self._raw[time_s] for time_s in times_s]))
        else:
            self._skipped += 1
        for kept in (self._kept, self._kept_fields, self._kept_raw):
            del kept[:-_MOST]
        for open_ones in (self._fields, self._raw):
            for old in [time_s for time_s in open_ones if time_s <= times_s[-1]]:
                del open_ones[old]

    def settled(self) -> MagnitudeFit | None:
        """The start where it is known well enough and the model fits no worse than none; else None."""
        step = max(1, len(self._kept) // _FITTED)
        ticks, fields = self._kept[::step], np.array([one[-1] for one in self._kept_fields[::step]])
        raw = np.array([one[-1] for one in self._kept_raw[::step]])
        field_nt = np.array([tick.field_body_nt[-1] for tick in ticks])
        magnitude_nt = np.array([tick.reference_magnitude_nt[-1] for tick in ticks])
        x = self._compensation.model.x
        try:
            fit = magnitude_fit(x, field_nt, magnitude_nt, fields, _PRIOR)
            plain = magnitude_fit(x, raw, magnitude_nt)
        except np.linalg.LinAlgError:
            return None
        early = fields[: max(1, len(fields) // 8)]  # hardly decayed
        squares = np.einsum("nki,kl,nli->n", early, fit.covariance, early) / 3.0
        unknown_nt = _AT_WORST * float(np.sqrt(np.mean(squares)))
        is_known = unknown_nt <= fit.sigma_nt or len(self._kept) >= _MOST
        return fit if is_known and fit.sigma_nt <= _WORSE * plain.sigma_nt else None

    def compensated(self, start: Array) -> Iterator[tuple[Tick, Array]]:
        """The ticks that are kept, compensated by a start (k,), and their samples (n, 3) as they came [nT]."""
        for tick, fields, raw in zip(self._kept, self._kept_fields, self._kept_raw, strict=True):
            yield replace(tick, field_body_nt=tick.field_body_nt - np.einsum("nki,k->ni", fields, start)), raw
