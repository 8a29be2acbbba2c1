"""The reader of ``physics.toml``: what it accepts compensates a craft that has every driver of the catalogue."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from pathlib import Path

import numpy as np

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.config.settings import CraftConfig, PhysicsConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.physics.apply.model_file import parse_model, read_model, text_of
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import Frame, Message, PositionSample, TelemetrySample
from tests.fuzz.inputs import ROOT, file_of, flight
from tests.physics import given_scene
from tests.physics.test_empirical import BIAS, GAIN, GROWTH
from tests.physics.test_model_file import drawn, forms, model


def run_physics(data: bytes) -> Hashable:
    """A model comes back from text as the same; a craft that is compensated by it sends nothing that is no message."""
    text = text_of(read_model(file_of("physics.toml", data)))
    assert text_of(parse_model(text.encode())) == text
    pipeline = Pipeline(CraftConfig("a", physics=PhysicsConfig(Path("physics.toml"), text)))
    answers = [answer for message in driven() for answer in pipeline.handle(message)]
    for answer in [*answers, *pipeline.flush(), pipeline.status(1.0, pipeline.ticks.counters)]:
        encode(answer)
    return frozenset(+(pipeline.ticks.counters + pipeline.counters))


@cache
def driven() -> tuple[Message, ...]:
    """A short flight in which every channel, and the position, is sent before the samples of its second."""
    scene, messages = given_scene.flight(), flight(3)
    assert scene.position_ecef_km is not None
    units = {unit.quantity: unit.base for unit in CHANNEL_UNITS.values()}
    found: list[Message] = []
    for row, time_ns in enumerate(sorted({message.time_ns for message in messages})):
        at = {"craft": "a", "source": "bus", "sequence": row, "time_ns": time_ns}
        x, y, z = scene.position_ecef_km[row].tolist()
        found.append(PositionSample(**at, position_km=(x, y, z), frame=Frame.ECEF))
        for name, channel in scene.channels.items():
            values = tuple(np.atleast_1d(channel.values[row]).tolist())
            found.append(TelemetrySample(**at, channel=name, unit=units[channel.quantity], values=values))
        found += [message for message in messages if message.time_ns == time_ns]
    return tuple(found)


def models() -> list[bytes]:
    """The documentation's, one with curves, and one for each form of each effect."""
    page = (ROOT / "docs/physics-file.md").read_text().split("```toml\n")[1]
    return [
        page.split("```")[0].encode(),
        text_of(model(empirical=(BIAS, GAIN, GROWTH))).encode(),
        *(text_of(model(drawn(form)[0])).encode() for form in forms()),
    ]
