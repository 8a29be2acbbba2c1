"""Corrupted samples that pass every check of the wire: stopped and counted, from the first sample on."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.errors import DecodeError
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.trust.reasons import Reason
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.messages import MagnetometerSample, Vector, Verdict
from tests.daemon.pipeline_streams import paper, paper_craft

SECONDS = 1500
SHARE = 0.1
LSB_NT = 10.0
TRUTH = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])


def flipped_float(field: Vector, rng: np.random.Generator) -> Vector:
    """One of the 64 bits of one component, as a cosmic ray leaves it in memory."""
    axis, bit = int(rng.integers(3)), int(rng.integers(64))
    (bits,) = struct.unpack("<Q", struct.pack("<d", field[axis]))
    values = list(field)
    (values[axis],) = struct.unpack("<d", struct.pack("<Q", bits ^ (1 << bit)))
    return (values[0], values[1], values[2])


def flipped_integer(field: Vector, rng: np.random.Generator) -> Vector:
    """One of the 16 bits of one component, as it left the converter."""
    axis, bit = int(rng.integers(3)), int(rng.integers(16))
    values = list(field)
    count = round(values[axis] / LSB_NT) & 0xFFFF ^ (1 << bit)
    values[axis] = LSB_NT * (count - 0x10000 if count & 0x8000 else count)
    return (values[0], values[1], values[2])


def turned(field: Vector, rng: np.random.Generator) -> Vector:
    """Another direction, the length kept: no scalar measurement sees it."""
    direction = rng.normal(size=3)
    x, y, z = (np.linalg.norm(field) * direction / np.linalg.norm(direction)).tolist()
    return (x, y, z)


def fly(corrupt: Callable[[Vector, np.random.Generator], Vector], seed: int) -> tuple[Pipeline, int, int]:
    """The pipeline after the paper's flight; corrupted samples that the wire refused, and all that were corrupted."""
    rng = np.random.default_rng([41, seed])
    pipeline, unsendable, corrupted = Pipeline(paper_craft()), 0, 0
    for message in paper(seed, SECONDS).messages():
        if isinstance(message, MagnetometerSample) and rng.random() < SHARE:
            corrupted += 1
            message = replace(message, field_body_nt=corrupt(message.field_body_nt, rng))
            try:
                message = decode(encode(message))
            except DecodeError:
                unsendable += 1
                continue
        pipeline.handle(message)
    return pipeline, unsendable, corrupted


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("corrupt", [flipped_float, flipped_integer])
def test_one_sample_in_ten_with_a_flipped_bit_does_no_harm(
    corrupt: Callable[[Vector, np.random.Generator], Vector], seed: int
) -> None:
    """It starts, never starts anew, and lies within its own sigmas of the truth; what is doubted is the residual alone.

    Flips below the gate add to the residual, which the verdict may say.
    """
    pipeline, unsendable, corrupted = fly(corrupt, seed)
    state = pipeline.estimator.estimate()
    assert (state.restarts, set(pipeline.trust.reasons) - {Reason.STRUCTURED_RESIDUAL}) == (0, set())
    assert np.all(np.abs(state.x - TRUTH) < 4.5 * np.sqrt(np.diagonal(state.covariance)))
    assert corrupted > 100
    assert pipeline.counters["rejected"] + unsendable > 0.1 * corrupted


@pytest.mark.parametrize("seed", range(3))
def test_one_vector_in_ten_turned_anywhere_is_doubted_and_does_not_diverge(seed: int) -> None:
    """Its length is kept, so that a third of them pass the scalar gate: 2 % of the field at most, told as doubtful."""
    pipeline, _, corrupted = fly(turned, seed)
    state = pipeline.estimator.estimate()
    assert (pipeline.trust.verdict, state.restarts) == (Verdict.DOUBTFUL, 0)
    assert np.abs(state.x - TRUTH)[:3].max() < 1000.0
    assert pipeline.counters["rejected"] > 0.4 * corrupted


def test_no_number_that_is_not_finite_gets_past_the_wire() -> None:
    """NaN and infinities are refused where they arrive, so none can reach the state."""
    sample = next(m for m in paper(1, 10).messages() if isinstance(m, MagnetometerSample))
    for value in (float("nan"), float("inf"), -float("inf"), 1e300):
        with pytest.raises(DecodeError):
            encode(replace(sample, field_body_nt=(value, 0.0, 0.0)))
