"""A disturbance locked to the Sun's direction in the body: thermoelectric currents, heated structure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import LIGHT, ActsOn, Watched
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.held import Form, HeldAt, at_zero_of
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene, is_sun_vector


def _fixed(signals: Array) -> Callable[[Array], Columns]:
    return lambda _: along_axes(signals)


_HARMONICS = ("Sun xy", "Sun xz", "Sun yz", "Sun x2 - y2", "Sun 3 z2 - 1")


def harmonics(sun: Array) -> Array:
    """The five second-degree harmonics of a direction (n, 3): xy, xz, yz, x^2 - y^2, 3 z^2 - |s|^2 -> (n, 5)."""
    x, y, z = sun.T
    return np.stack([x * y, x * z, y * z, x * x - y * y, 2.0 * z * z - x * x - y * y], axis=1)


def _directions(scene: Scene) -> Iterator[tuple[str, Array, dict[str, float]]]:
    """Names of drivers, the Sun in the body (n, 3), zero in shadow, and constants."""
    for channel in scene.channels.values():
        if is_sun_vector(channel) and (float(np.std(channel.values)) > 0.0 or scene.is_given):
            own = float(np.percentile(np.linalg.norm(channel.values, axis=1), 99))
            size = scene.constant("full_sun", own if channel.quantity == "counts" else 1.0)
            yield f"channel:{channel.name}", channel.values / size, {"full_sun": size}
    if scene.sun_body is not None and scene.lit is not None:
        yield "inferred:sun_direction", scene.sun_body * scene.lit[:, None], {}


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    for driver, sun, constants in _directions(scene):
        linear = Block("nt", "nT", (3, 3), labels=(("Sun along x", "Sun along y", "Sun along z"), AXES))
        yield Hypothesis("sun_disturbance", driver, _fixed(sun), (linear,), constants=constants)
        square = Block("second_nt", "nT", (5, 3), labels=(_HARMONICS, AXES), completes=True)
        both = np.concatenate([sun, harmonics(sun)], axis=1)
        second = Hypothesis(
            "sun_disturbance",
            driver,
            _fixed(both),
            (linear, square),
            "second degree",
            constants=constants,
            if_completed=("current_loop",),  # of panels in any direction, whose half waves are of second degree
        )
        yield second
        light = np.linalg.norm(sun, axis=1, keepdims=True)
        if float(np.std(light)) > 0.05 or scene.is_given:
            whole = np.concatenate([sun, harmonics(sun), light], axis=1)
            blocks = (linear, square, Block("light_nt", "nT", completes=True))
            form = "second degree and light"
            yield replace(second, columns=_fixed(whole), blocks=blocks, variant=form)


def _held_at(form: Form) -> HeldAt:
    """Shadow: there the Sun's direction is none."""
    if form.driver.startswith("channel:"):
        return at_zero_of(form, "")
    return HeldAt(form.driver, 0.0, "1", "no sunlight")


EFFECT = Effect(
    name="sun_disturbance",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_BY, "sun"), (Watched.BIAS_BY, LIGHT)),
    title="a disturbance locked to the Sun's direction in the body",
    equation="d = lit (F s + second-degree harmonics of s), s the Sun's direction in the body",
    units={"nt": "nT", "second_nt": "nT", "light_nt": "nT"},
    in_orbit_only=True,
    prior=(1.0, 300.0),
    valid="no thermal delay: structure that follows the light within a sample",
    confused_with=("current_loop", "thermal_bias"),
    separated_by="a craft that turns its panels: panels give half waves, heat full ones",
    or_record=(("current", "array currents beside it"),),
    source="Toeffner-Clausen et al. 2016 and Lesur et al. 2016 (Swarm, Sun-driven disturbance, 1-5 nT)",
    says=(
        "A field of up to {nt.size} ({nt.place}) turns with the Sun's direction in the body, by {driver}, and is "
        "gone in shadow.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    held_at=_held_at,
)
