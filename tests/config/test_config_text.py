"""A craft's configuration as text: reading it back gives the same, to the last bit."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.base.errors import ConfigError
from magcal_service.base.typed_toml import Table
from magcal_service.config.reader import read_config
from magcal_service.config.settings import (
    CraftConfig,
    FilterConfig,
    MagnetometerConfig,
    ReferenceConfig,
    ReferenceModel,
    SensorConfig,
    SpinConfig,
    SpinWindow,
    TickConfig,
    TrustConfig,
)
from magcal_service.config.text import craft_as_toml, craft_from_toml, digest
from tests.physics.live_models import THERMAL, physics

CRAFT = CraftConfig(
    "demo",
    SensorConfig(299.99999999999994, 12),
    SpinConfig((0.6, 0.0, 0.8), -7.500000000000001, SpinWindow.MEAN, 3, 9, True),
    FilterConfig("two-step", 5000.1, 0.1, (0.1, 0.2, 0.3), (1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6), 99.0, gate_sigma=5.1),
    TickConfig(hold_s=1.1),
    TrustConfig(min_ticks=20),
)


LISTED = (
    MagnetometerConfig("mag1"),
    MagnetometerConfig("mag2", 50.1, stuck_samples=7, process_noise_bias_nt=(0.1, 0.2, 0.3), spin=SpinConfig()),
)


@pytest.mark.parametrize(
    "craft",
    [
        CRAFT,
        replace(CRAFT, max_sources=3, magnetometers=LISTED),
        CraftConfig("a"),
        CraftConfig("b", spin=SpinConfig()),
        CraftConfig("c", physics=physics(*THERMAL, origin_ns=0), reference=ReferenceConfig(ReferenceModel.IGRF)),
    ],
)
def test_a_craft_comes_back_as_it_was(craft: CraftConfig) -> None:
    assert craft_from_toml(craft_as_toml(craft), "text") == craft


@given(st.tuples(*[st.floats(-1e3, 1e3)] * 3).filter(lambda axis: math.hypot(*axis) > 1e-3), st.floats(0.01, 3000.0))
def test_any_axis_that_was_read_once_comes_back_bit_for_bit(axis: tuple[float, float, float], rate_rpm: float) -> None:
    content = {"version": 1, "craft": [{"name": "a", "spin": {"axis": list(axis), "rate_rpm": rate_rpm}}]}
    (craft,) = read_config(Table(content, "file", "", [])).crafts
    assert craft_from_toml(craft_as_toml(craft), "text") == craft


@pytest.mark.parametrize("setting", fields(SensorConfig), ids=lambda setting: setting.name)
def test_the_digest_changes_with_a_setting(setting: object) -> None:
    name = setting.name  # type: ignore[attr-defined]
    other = replace(CRAFT, sensor=replace(CRAFT.sensor, **{name: 50}))
    assert digest([other]) != digest([CRAFT]) == digest([replace(CRAFT)])


@pytest.mark.parametrize("text", ["version = ", "version = 1\n", "version = 1\n[[craft]]\nname = 'a'\nmore = 1\n"])
def test_a_text_that_is_no_configuration_is_refused_by_its_name(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^text"):
        craft_from_toml(text, "text")
