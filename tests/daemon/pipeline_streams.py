"""Messages for one craft: the paper's simulation, and hostile streams that a broken sensor or reference could send."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig, TrustConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Clock, Frame, MagnetometerSample, Message, ReferenceSample
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

START_NS = 1_750_000_000_000_000_000
EARLY = TrustConfig(protection_nt=1e5)
"""Trusted as soon as its errors are known, whatever may act on it unseen."""

LIMIT_NT = 1e6 / np.sqrt(3.0) * (1.0 - 1e-12)


@cache
def paper(seed: int, duration_s: float) -> Simulation:
    """The paper's scenario."""
    return Simulation(load_scenario("paper"), seed, duration_s)


def paper_craft(**changes: object) -> CraftConfig:
    """What an operator of the paper's craft configures."""
    settings = {"sensor": SensorConfig(noise_nt=300.0), "spin": SpinConfig(rate_rpm=7.5), "trust": EARLY} | changes
    return CraftConfig("paper", **settings)


def quick_craft(noise_nt: float | None = 300.0, spin: SpinConfig | None = None) -> CraftConfig:
    """A craft whose filter starts after 10 s."""
    return CraftConfig("paper", SensorConfig(noise_nt=noise_nt), spin, FilterConfig(start_s=10.0), trust=EARLY)


def handle_all(pipeline: Pipeline, messages: Iterable[Message]) -> list[Message]:
    """Everything published for these messages."""
    return [answer for message in messages for answer in pipeline.handle(message)]


def rows(field_nt: np.ndarray, reference: np.ndarray, first_s: int) -> Iterator[Message]:
    """1 Hz messages: measured vectors (n, 3), and references (n, 3) ECI or magnitudes (n,)."""
    for second, (field, found) in enumerate(zip(field_nt.tolist(), reference.tolist(), strict=True), first_s):
        common = {
            "craft": "paper",
            "sequence": second,
            "time_ns": START_NS + second * 10**9,
            "clock": Clock.UTC,
        }
        if isinstance(found, list):
            yield ReferenceSample(source="ref", **common, field_nt=tuple(found), frame=Frame.ECI)
        else:
            yield ReferenceSample(source="ref", **common, magnitude_nt=found)
        yield MagnetometerSample(source="mag", **common, field_body_nt=tuple(field))


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


FIELDS = {
    "zero": lambda rng, n: np.zeros((n, 3)),
    "tiny": lambda rng, n: rng.normal(size=(n, 3)) * 1e-300,
    "small": lambda rng, n: rng.normal(size=(n, 3)) * 1e-3,
    "usual": lambda rng, n: 40_000.0 * _directions(rng, n) + rng.normal(size=(n, 3)) * 300.0,
    "line": lambda rng, n: rng.normal(size=(n, 1)) * np.array([[20_000.0, -10_000.0, 5_000.0]]),
    "plane": lambda rng, n: 40_000.0 * _directions(rng, n) * np.array([[1.0, 1.0, 0.0]]),
    "limit": lambda rng, n: rng.choice([-LIMIT_NT, LIMIT_NT], size=(n, 3)),
    "spikes": lambda rng, n: np.where(rng.random((n, 1)) < 0.3, LIMIT_NT, 40_000.0 * _directions(rng, n)),
    "microtesla": lambda rng, n: 40.0 * _directions(rng, n),
}

REFERENCES = {
    "zero": lambda rng, n: np.zeros(n),
    "zero_vector": lambda rng, n: np.zeros((n, 3)),
    "tiny": lambda rng, n: np.full(n, 5e-324),
    "constant": lambda rng, n: np.full(n, 40_000.0),
    "usual": lambda rng, n: 40_000.0 + rng.normal(size=n) * 3000.0,
    "vector": lambda rng, n: 40_000.0 * _directions(rng, n),
    "limit": lambda rng, n: np.full(n, 1e6),
    "mixed": lambda rng, n: rng.choice([0.0, 1.0, 40_000.0, 1e6], size=n),
}
