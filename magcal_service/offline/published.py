"""What a service that compensates has published and learned from: the residual of the vectors themselves.

Where ``physics.toml`` is compensated live, no formula over the recording says what was done: a driver was missing for a
while, a start was estimated on the way, compensation was stopped.  So the replay keeps what the craft did.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.settling import Settling
from magcal_service.model import Array
from magcal_service.offline.compensated import Tally
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.ticks.assembler import SECOND_NS, Tick
from magcal_service.wire.messages import CalibratedVector, Estimate, MagnetometerSample, Message, Verdict


@dataclass(eq=False)
class Published:
    """What one craft has done with its samples, in the order of its ticks.

    Parameters
    ----------
    times_s: of the samples since the first one [s].
    residual_nt: |B_cal| - |H| of each sample's published vector [nT]; NaN where it was published before the start.
    field_nt, magnitude_nt: B (3,) and |H| of each sample as the estimator was given them [nT].
    measured_nt: B (3,) of each sample as it came [nT].
    """

    times_s: list[float] = field(default_factory=list)
    residual_nt: list[float] = field(default_factory=list)
    field_nt: list[Array] = field(default_factory=list)
    magnitude_nt: list[float] = field(default_factory=list)
    measured_nt: list[Array] = field(default_factory=list)
    _open: dict[float, tuple[float, Array]] = field(default_factory=dict)

    def vector(self, elapsed_s: float, sample: MagnetometerSample, published: CalibratedVector) -> None:
        """Take a published vector and its sample, at a time since the first one [s]."""
        started = published.verdict is not Verdict.NOT_STARTED
        length = float(np.linalg.norm(published.field_body_nt)) if started else np.nan
        self._open[elapsed_s] = length, np.array(sample.field_body_nt)

    def tick(self, tick: Tick) -> None:
        """Take a tick whose vectors are published: now their reference is known."""
        times_s, magnitude_nt = tick.times_s.tolist(), tick.reference_magnitude_nt.tolist()
        known = [self._open.pop(time_s) for time_s in times_s]
        self.times_s += times_s
        self.residual_nt += [one[0] - reference for one, reference in zip(known, magnitude_nt, strict=True)]
        self.measured_nt += [one[1] for one in known]
        self.field_nt += list(tick.field_body_nt)
        self.magnitude_nt += magnitude_nt

    def learned_again(self, ticks: Iterable[Tick]) -> None:
        """Take it that an estimator was given ticks once more, compensated otherwise."""
        again = {
            time_s: one for tick in ticks for time_s, one in zip(tick.times_s.tolist(), tick.field_body_nt, strict=True)
        }
        self.field_nt = [again.get(time_s, one) for time_s, one in zip(self.times_s, self.field_nt, strict=True)]

    def since_start(self) -> Array:
        """|B_cal| - |H| (n,) [nT] of the vectors published after the start."""
        residual = np.array(self.residual_nt)
        return np.asarray(residual[np.isfinite(residual)])

    def used(self, *, as_measured: bool) -> tuple[NDArray[np.int64], Array, Array]:
        """Times (n,) [ns] since the first sample, B (n, 3) and |H| (n,) [nT] as the last estimator was given them.

        ``as_measured``: it is one that is given the samples as they came.
        """
        times_ns = np.rint(np.array(self.times_s) * SECOND_NS).astype(np.int64)
        field_nt = self.measured_nt if as_measured else self.field_nt
        return times_ns, np.array(field_nt).reshape(-1, 3), np.array(self.magnitude_nt)


class ObservedPipeline(Pipeline):
    """A craft's pipeline that keeps what it publishes.

    Parameters
    ----------
    config: the craft's configuration.
    """

    def __init__(self, config: CraftConfig) -> None:
        super().__init__(config)
        self.published = Published()
        self.tally = Tally()

    def _sample(self, sample: MagnetometerSample) -> list[Message]:
        outputs = super()._sample(sample)
        for one in outputs:
            if isinstance(one, CalibratedVector):
                self.tally.sample(self)
                self.published.vector(self.ticks.elapsed_s(sample), sample, one)
        return outputs

    def _try_start(self, settling: Settling, compensation: Compensation) -> None:
        super()._try_start(settling, compensation)
        if self.settling is None:
            again = settling.compensated(compensation.start)
            self.published.learned_again(tick for tick, _ in again)

    def _tick(self, tick: Tick) -> Estimate:
        self.published.tick(tick)
        return super()._tick(tick)
