"""A stream that begins where the model's recording did not: its temperature at the start is estimated in minutes.

What follows light with a time constant tau has at time t after the start the unknown part y exp(-t / tau), which enters
linearly: with B_0 the sample compensated for y = 0 and g its field for y = 1,

    e = |(I + D)(B_0 - y g exp(-t / tau)) - b| - |H|.

y and the nine errors are fitted together to the ticks so far: y with a prior of half the swing between light and
shadow, the nine errors with one about the file's, which are of the same sensor on another day; without it, y would take
as long to know as they do.  As long as a vector may be wrong by more than the noise for what is not known of y, nothing
is compensated: the craft is one without ``physics.toml``, and says so.  Then an estimator goes on from the nine errors
of that fit where vectors are as sure as a start of its own makes them; else it is given all ticks again, compensated by
that y, and takes over once it has a start.  What remains unknown of y is in the covariance of the vectors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.parts.magnitude_fit import MagnitudeFit, magnitude_fit
from magcal_service.estimators.parts.start_gates import BAD_FIT, handover_sigma, vector_sigma
from magcal_service.model import Array
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.model_file import PhysicsModel
from magcal_service.ticks.assembler import Tick, TickAssembler
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample

_PRIOR: Final = 0.5
"""1 sigma of a temperature at the start, in units of the swing between light and shadow; light keeps it within one."""

_OTHER_DAY: Final = 3.0
"""Times their own sigma by which the file's nine errors are off on another day, 1 sigma of the prior.

Choice: a fit's own sigma holds for its recording; what is left out of the model moves each day's fit by some of them.
"""

_ONE_PERCENT: Final = np.array([500.0] * 3 + [0.01] * 6)
"""At least so much of each bias [nT] and each element of D: one percent of the largest field of a low orbit, and of a
gain.  Choice: a quiet day's fit is sure to a few nT, and a small craft's offset moves by hundreds from day to day."""

_CONTRADICTED: Final = 3.0
"""Sigmas of that prior beyond which today's errors are others, and the file's are no prior for them."""

_FIRST: Final = 150
"""Ticks before the first look: in fewer the residual's level is not known."""

_LATER: Final = 1.2
"""Times as many ticks before the next one: the ticks are given again at each that may be the last."""

_MOST: Final = 1800
"""Ticks that are kept: half an hour; what is not known by then stays in the covariance."""

_FITTED: Final = 600
"""Ticks that a fit takes at most, evenly of all: its cost is that of one look of the watch."""

_AT_WORST: Final = 0.3
"""By how much a decay exp(-t / tau) is off its mean since the start at most, at twice the time constant."""

_WORSE: Final = 1.02
"""Times the residual without compensation that the one with it may have, where the file's noise is less: else the model
does not fit."""

_LATEST: Final = 5400
"""Ticks after which a model that has fitted no better than none with any start does not fit: an orbit."""

_SKIPPED: Final = 1200
"""Ticks without some driver after which none is waited for: the other effects are compensated, these are left out."""

_MOST_OPEN: Final = 6000
"""Samples whose tick is not kept yet, at most: 10 min at 10 Hz, longer than a reference is waited for.

No tick is kept while frozen or without a reference.
"""


def other_day_sigma(model: PhysicsModel) -> Array:
    """1 sigma (9,) by which a sensor's nine errors on another day are off a file's [nT, -]."""
    return np.asarray(np.maximum(_OTHER_DAY * model.sigma, _ONE_PERCENT))


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


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A start that is known.

    Parameters
    ----------
    fit: its y, and the nine errors beside it.
    is_sure: whether a filter may go on from those nine errors.
    """

    fit: MagnitudeFit
    is_sure: bool


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

    def settled(self, *, goes_on: bool) -> Settled | None:
        """The start where it is known well enough and the model fits; else None.

        An estimator that goes on from nine errors waits until they are sure: one that starts anew from as few ticks may
        find others that fit as well and are wrong a minute later.

        It fits where it leaves no more than nine errors without it; or than its file says that it leaves, where the
        nine errors are sure: few ticks are fitted by nine that are free and wrong.
        """
        step = max(1, len(self._kept) // _FITTED)
        ticks, fields = self._kept[::step], np.array([one[-1] for one in self._kept_fields[::step]])
        raw = np.array([one[-1] for one in self._kept_raw[::step]])
        field_nt = np.array([tick.field_body_nt[-1] for tick in ticks])
        magnitude_nt = np.array([tick.reference_magnitude_nt[-1] for tick in ticks])
        model = self._compensation.model
        known = other_day_sigma(model)
        try:
            fit = magnitude_fit(model.x, field_nt, magnitude_nt, fields, _PRIOR, known)
            is_same = bool(np.all(np.abs(fit.x - model.x) < _CONTRADICTED * known))
            if not is_same:
                fit = magnitude_fit(model.x, field_nt, magnitude_nt, fields, _PRIOR)
            plain = magnitude_fit(model.x, raw, magnitude_nt)
        except np.linalg.LinAlgError:
            return None
        early = fields[: max(1, len(fields) // 8)]  # hardly decayed
        squares = np.einsum("nki,kl,nli->n", early, fit.covariance, early) / 3.0
        unknown_nt = _AT_WORST * float(np.sqrt(np.mean(squares)))
        is_known = unknown_nt <= fit.sigma_nt or len(self._kept) >= _MOST
        limit_nt = handover_sigma(fit.sigma_nt, float(magnitude_nt.mean()))
        is_sure = is_same and vector_sigma(fit.x_covariance, field_nt) <= limit_nt
        if goes_on and not is_sure and len(self._kept) < _MOST:
            return None
        left_nt = BAD_FIT * model.sample_noise_nt if is_sure else 0.0
        if not is_known or fit.sigma_nt > max(_WORSE * plain.sigma_nt, left_nt):
            return None
        return Settled(fit, is_sure)

    def compensated(self, start: Array) -> Iterator[tuple[Tick, Array]]:
        """The ticks that are kept, compensated by a start (k,), and their samples (n, 3) as they came [nT]."""
        for tick, fields, raw in zip(self._kept, self._kept_fields, self._kept_raw, strict=True):
            yield replace(tick, field_body_nt=tick.field_body_nt - np.einsum("nki,k->ni", fields, start)), raw
