"""Whether a channel shows the light that was computed: dark in the shadow and lit elsewhere, and no other one."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from magcal_service.diagnosis.joint.light import light_seen
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.scenes import scene

TURN_S = 60.0


def shaded(quantity: str, values: Array, dark: slice = slice(600, 1100)) -> Scene:
    """A scene whose shadow is those rows, with one channel."""
    made = scene()
    made = replace(made, channels={"cells": Telemetry("cells", quantity, values)})
    lit = np.ones(len(made))
    lit[dark] = 0.0
    made.__dict__["lit"] = lit
    return made


def cells(count: int, late: int = 0) -> Array:
    """(n, 2) counts of two cells on opposite sides of a craft that turns, the Sun across its axis; 20 in the dark."""
    phase = 2.0 * np.pi * 4.0 * np.arange(count) / TURN_S
    light = np.roll(np.where((np.arange(count) >= 600) & (np.arange(count) < 1100), 0.0, 1.0), late)
    both = np.maximum(np.stack([np.cos(phase), -np.cos(phase)], axis=1), 0.0)
    return 20.0 + 400.0 * both * light[:, None] + np.random.default_rng(3).normal(0.0, 3.0, (count, 2))


def test_cells_that_turn_through_the_light_agree_with_the_shadow() -> None:
    count = len(scene())
    (seen,) = light_seen(shaded("counts", cells(count)), 2.0 * np.pi / TURN_S)
    assert seen.channel == "cells"
    assert seen.share > 0.98
    assert seen.rows == count
    assert "agrees with the computed shadow" in str(seen)
    assert json.loads(json.dumps(seen.to_dict())) == {**asdict(seen), "share": round(seen.share, 4)}


@pytest.mark.parametrize("late", [300, -300, 800])
def test_light_that_is_elsewhere_does_not_agree(late: int) -> None:
    assert light_seen(shaded("counts", cells(len(scene()), late)), 2.0 * np.pi / TURN_S) == ()


def test_what_follows_no_light_does_not_agree() -> None:
    count = len(scene())
    rising, noise = np.linspace(0.0, 1.0, count), np.random.default_rng(4).normal(size=count)
    for values in (rising, noise, np.sin(np.arange(count) / 40.0)):
        assert light_seen(shaded("counts", values[:, None]), None) == ()


def test_without_a_shadow_or_as_a_temperature_nothing_is_said() -> None:
    count = len(scene())
    assert light_seen(shaded("counts", cells(count), slice(0, 10)), 2.0 * np.pi / TURN_S) == ()
    assert light_seen(shaded("temperature", cells(count)), 2.0 * np.pi / TURN_S) == ()
