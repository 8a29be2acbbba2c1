"""Temperature as a driver: recorded, or inferred as a first-order response to sunlight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import Direct, Term, direct
from magcal_service.physics.columns import Columns, joined
from magcal_service.physics.held import Form, HeldAt
from magcal_service.physics.interface import START, Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene

_AN_ORBIT_S: Final = 5400.0  # of the lowest orbits that last

TIME_CONSTANTS_S: Final = np.geomspace(120.0, 14400.0, 9)
"""2 minutes (an uncovered board) to 4 hours (the middle of a craft)."""

SKINS_S: Final = np.array([0.0, 300.0, 900.0, 2400.0])
"""What is heated first: nothing between, a panel, a structure."""

_AGAINST_GUESSING: Final = 5.0
"""Nats against inferring a temperature where one was recorded: odds of 150 to 1 for the record."""

_CHARGES: Final = "what follows light as slowly as warmth, and no thermometer: a battery's charge"
"""What leaves the same where a temperature was recorded that does not explain it."""

_SELDOM_HEAT: Final = 2.0
"""Nats against heat for what only settles, which is a drift whatever its cause: odds of 7 to 1.  Of sixteen courses
that relaxed in other hands' simulators without a record two were heat."""

_LEAST_SWING_K: Final = 0.05
"""Spread below which a recorded temperature is constant: a step of a coarse sensor; it drives nothing detectable."""

SETTLING: Final = "settling"
"""Form of what was warm or cold at the start and answers to nothing since."""

Act = Callable[[Array], Columns]
"""From a signal (n,) to its columns."""


def recorded(scene: Scene, effect: str, act: Act, block: Block) -> Iterator[Hypothesis]:
    """One hypothesis for each recorded temperature, T - T0 with T0 the recording's mean."""
    for channel in scene.of_quantity("temperature"):
        several = channel.values.shape[1] > 1
        for index, values in enumerate(channel.values.T):
            if channel.swings[0][index] < _LEAST_SWING_K and not scene.is_given:
                continue
            zero = scene.constant("zero_degc", round(float(values.mean()), 1))
            yield Hypothesis(
                effect,
                f"channel:{channel.name}",
                _fixed(act, values, zero),
                (block,),
                variant=f"column {index + 1}" if several else "",
                constants={"zero_degc": zero, "column": float(index)},
            )


def warms_unseen(scene: Scene) -> bool:
    """Whether a sensor may warm with nobody seeing it: without a record, and without an orbit that tells its course, or
    in less than one, when it may still be settling after it was switched on."""
    is_told = scene.in_orbit and float(np.ptp(scene.time_s)) >= _AN_ORBIT_S
    return not is_told and not scene.of_quantity("temperature")


def direct_by_temperature(term: Term, block: str, *, is_gain: bool = False) -> Direct | None:
    """The direct form of a term that a recorded temperature drives; None for another."""
    one_of_several = term.variant.startswith("column ")
    if (term.variant and not one_of_several) or "zero_degc" not in term.constants:
        return None
    column = int(term.constants.get("column", 0.0))
    return direct(term, "temperature", block, [column], term.constants["zero_degc"], is_gain=is_gain)


def held_at(form: Form) -> HeldAt | None:
    """The temperature at which an effect of heat adds nothing."""
    if "zero_degc" in form.constants:
        zero = form.constants["zero_degc"]
        return HeldAt(form.driver, zero, "degC", f"{zero:.1f} degC of channel {form.driver.partition(':')[2]}")
    if "mean_light" in form.constants:
        light = form.constants["mean_light"]
        says = f"the temperature that {light:.3g} of full sunlight keeps up, the mean here"
        return HeldAt(form.driver, light, "1", says)
    if SETTLING in form.variant:
        return HeldAt(form.driver, 0.0, "1", "the temperature that it settles at")
    return None


def _fixed(act: Act, values: Array, zero: float) -> Callable[[Array], Columns]:
    """Made when it is asked for: hundreds of channels have several forms each."""
    return lambda _: act(values - zero)


def inferred(scene: Scene, effect: str, act: Act, block: Block, *, settles: bool = True) -> Iterator[Hypothesis]:
    """Temperature as a response to light, in units of the swing between light and shadow.

    Light heats a skin, dS/dt = (lit - S) / skin, and the sensor follows it, dT/dt = (S - T) / tau.  The temperature at
    the start is free: its decay is a second set of amplitudes, named ``start_`` and the block's name.  Where a
    temperature was recorded, inferring another one from light has odds against it, and what it finds may be no warmth:
    a battery's charge follows light as slowly.  That decay alone is a form of its
    own, where it ``settles``: what was switched on warms up, whatever a thermometer elsewhere has, and no data tell it
    from a drift that relaxes.
    """
    known = any(recorded(scene, effect, act, block))
    start = Block(f"{START}{block.name}", block.unit, block.shape, block.most)
    constants_s = Nonlinear("time_constant_s", "s", TIME_CONSTANTS_S, spans=True)
    if settles:
        yield Hypothesis(
            effect,
            "inferred:temperature",
            lambda theta: act(scene.settling(float(theta[0]))),
            (start,),
            variant=SETTLING,
            nonlinear=(constants_s,),
            odds=_SELDOM_HEAT,
        )
    if scene.lit is None or not scene.eclipses:
        return

    def columns(theta: Array) -> Columns:
        answer, decay = scene.warmed(float(theta[0]), float(theta[1]))
        return joined(act(answer), act(decay))

    yield Hypothesis(
        effect,
        "inferred:temperature",
        columns,
        (block, start),
        variant="answer to light",
        nonlinear=(constants_s, Nonlinear("skin_s", "s", SKINS_S, spans=True)),
        odds=_AGAINST_GUESSING if known else 0.0,
        imitated_by=_CHARGES if known else "",
        constants={"mean_light": scene.mean_light},
    )
