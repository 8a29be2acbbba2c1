"""Messages of a small craft: a sensor with a bias, its reference, its results."""

from __future__ import annotations

import math
from collections.abc import Iterator

from magcal_service.wire.messages import (
    CalibratedVector,
    Estimate,
    MagnetometerSample,
    Message,
    ReferenceSample,
    Status,
    Vector,
    Verdict,
)

FIELD_NT = 40_000.0
BIAS_NT: Vector = (3000.0, 0.0, 0.0)


def direction(second: int, turn_hz: float = 0.1) -> Vector:
    """The field in the body at a second [nT]: it turns about z."""
    angle = math.tau * turn_hz * second
    return FIELD_NT * 0.8 * math.cos(angle), FIELD_NT * 0.8 * math.sin(angle), FIELD_NT * 0.6


def second_of(
    second: int, craft: str = "demo", source: str = "mag", ripple_nt: float = 0.0, verdict: Verdict = Verdict.TRUSTED
) -> Iterator[Message]:
    """Reference, raw sample and calibrated vector of a second; the latter is too long and too short by turns."""
    stamp = {"craft": craft, "sequence": second, "time_ns": second * 1_000_000_000}
    x, y, z = direction(second)
    stretch = 1.0 + (-1) ** second * ripple_nt / FIELD_NT
    yield ReferenceSample(**stamp, source="igrf", magnitude_nt=FIELD_NT)
    yield MagnetometerSample(**stamp, source=source, field_body_nt=(x + BIAS_NT[0], y, z))
    yield CalibratedVector(
        **stamp,
        source=source,
        field_body_nt=(stretch * x, stretch * y, stretch * z),
        covariance_nt2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
        verdict=verdict,
    )


def estimate(second: int, craft: str = "demo", source: str = "magcal", verdict: Verdict = Verdict.TRUSTED) -> Estimate:
    """Nine errors: the bias alone, each with a sigma of 2 nT or 2."""
    covariance = [4.0 if row == column else 0.0 for row in range(9) for column in range(row, 9)]
    return Estimate(
        craft=craft,
        source=source,
        sequence=second,
        time_ns=second * 1_000_000_000,
        method="ukf",
        tick=second,
        bias_nt=BIAS_NT,
        D=(0.0,) * 6,
        covariance=tuple(covariance),
        verdict=verdict,
        reasons=("model_doubtful",) if verdict is Verdict.DOUBTFUL else (),
        protection_nt=120.0,
        protection_by="gain_step",
    )


def status(second: int, text: str, craft: str = "demo", source: str = "magcal") -> Status:
    """A status that says ``text``."""
    return Status(
        craft=craft,
        source=source,
        sequence=second,
        time_ns=second * 1_000_000_000,
        uptime_s=1.0,
        verdict=Verdict.TRUSTED,
        counters={"accepted": second},
        text=text,
    )
