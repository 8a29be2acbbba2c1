"""Where a calibration's nine errors hold, or the range of a temperature that they are constants over."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.offline.published import ObservedPipeline
from magcal_service.physics.catalogue import held_at
from magcal_service.physics.held import HeldAt
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import telemetry


@dataclass(frozen=True, slots=True)
class Over:
    """A recorded temperature that the residual follows, while nine constants were fitted [degC].

    Parameters
    ----------
    driver: ``channel:NAME``.
    low, high, mean: of its course.
    """

    driver: str
    low: float
    high: float
    mean: float

    def __str__(self) -> str:
        name = self.driver.partition(":")[2]
        return f"{self.low:.1f} to {self.high:.1f} degC of channel {name}, {self.mean:.1f} in the mean"

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {**asdict(self), "unit": "degC", "says": str(self)}


def held_of(pipeline: Pipeline) -> tuple[HeldAt, ...]:
    """Where nine errors hold whose samples are compensated by ``physics.toml``; nothing where they are not.

    An effect that was subtracted from no sample is in them as it was.
    """
    if not pipeline.compensates or pipeline.compensation is None:
        return ()
    terms = pipeline.compensation.model.terms
    if isinstance(pipeline, ObservedPipeline):
        terms = tuple(term for term in terms if pipeline.tally.is_ever(term.effect))
    return held_at(terms)


def over_of(recording: Recording, pipeline: Pipeline) -> Over | None:
    """The recorded temperature that the residual follows, as the watch says; None where it follows none."""
    finding = pipeline.watch.finding
    for name, channel in recording.channels.items():
        if finding is None or channel.spec.quantity != "temperature" or finding.driver != f"channel {name}":
            continue
        values = telemetry(channel).values
        if np.isfinite(values).all():
            return Over(f"channel:{name}", float(values.min()), float(values.max()), float(values.mean()))
    return None
