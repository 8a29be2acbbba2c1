"""Names held against one signal of each recorded channel: a look-alike is doubted, the right name is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.belief import posterior, unlisted
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.signals import against_signals, strongest_signal
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.interface import UNLISTED, Block, Hypothesis
from magcal_service.physics.scene.scene import Telemetry
from tests.diagnosis.made_up import FLOOR_NT, OTHER, QUICK, SLOW, TIME_S, along, body_form, flown, searching
from tests.physics.scenes import scene

WARMTH = np.sin(TIME_S / 400.0)
CHANGE = np.cos(TIME_S / 400.0)  # what the warmth changes by, but for its size


def compared(field_nt: Array, form: Hypothesis, **channels: Array) -> Explained:
    """A form fitted to a field (n, 3), with rivals among itself and the channels' signals."""
    of = flown(field_nt)
    made = {name: Telemetry(name, "pressure", values[:, None]) for name, values in channels.items()}
    search, fit = searching(replace(of, channels=made), form)
    term = Term(search.hypotheses[0], np.zeros(0), np.array([1.0]))
    found = search.compared(solve(search.problem, fit.x, [term]), FLOOR_NT)
    return against_signals(search, found, FLOOR_NT)


def near(signal: Array) -> Hypothesis:
    """A name whose field resembles a signal (n,) to nine tenths."""
    return body_form("one", "", along(0, 0.9 * signal + 0.435 * QUICK))


def test_a_name_that_resembles_the_change_of_a_channel_loses_to_it() -> None:
    found = compared(along(0, 300.0 * CHANGE), near(CHANGE), hull=WARMTH)
    assert posterior(found, 0).own < 1e-3
    assert posterior(found, 0).rivals[0][0] == UNLISTED
    assert unlisted(found, 0) == "a field that follows the change of the recorded hull"


@pytest.mark.parametrize("channel", [WARMTH, np.sin(TIME_S / 900.0), CHANGE])
def test_the_right_name_keeps_its_probability(channel: Array) -> None:
    """Even beside a channel that is its own driver: what was looked for is believed before what was not."""
    found = compared(along(0, 300.0 * CHANGE), body_form("one", "", along(0, CHANGE)), hull=channel)
    assert posterior(found, 0).own > 0.969  # what a name leaves to the unlisted at the least
    assert unlisted(found, 0) == ""


def test_a_gain_by_a_channel_beats_a_field_that_resembles_it() -> None:
    field = scene().calibrated_nt * (0.01 * SLOW)[:, None]
    found = compared(field, body_form("one", "", along(0, SLOW * scene().calibrated_nt[:, 0])), hull=SLOW)
    assert unlisted(found, 0) == "a gain that follows the recorded hull"


def test_the_own_driver_by_a_lag_is_no_rival() -> None:
    """A record's noise is smoother behind a lag, whoever drives; of another channel it is one."""
    lagging = along(0, 300.0 * np.sin((TIME_S - 60.0) / 400.0))
    form = replace(body_form("one", "", along(0, WARMTH)), driver="channel:hull")
    assert not unlisted(compared(lagging, form, hull=WARMTH), 0).endswith("s")
    other = replace(form, driver="channel:other")
    assert (
        unlisted(compared(lagging, other, hull=WARMTH), 0) == "a field that follows the recorded hull by a lag of 60 s"
    )


def test_the_own_driver_as_it_is_recorded_is_no_rival() -> None:
    """Of what follows it with a lag it holds nearly all, and is the same cause; as another effect it is another."""
    lagging = np.sin((TIME_S - 8.0) / 400.0)
    own = replace(body_form("one", "", along(0, lagging)), driver="channel:hull")

    def rival(form: Hypothesis) -> str:
        ranked = compared(along(0, 300.0 * lagging), form, hull=WARMTH).rivals[0]
        return next(c.hypothesis.variant for c in ranked if c.hypothesis.effect == UNLISTED)

    assert rival(own) != "field"
    assert rival(replace(own, driver="channel:other")) == "field"
    assert rival(replace(own, blocks=(Block("per_unit", "1", (1,)),))) == "field"


def test_what_a_channel_adds_up_to_is_a_rival() -> None:
    """The charge that a current leaves."""
    amps = np.sign(CHANGE)
    charge = np.cumsum(amps) / 100.0
    found = compared(along(0, 300.0 * charge), near(charge), amps=amps)
    assert unlisted(found, 0) == "a field that follows the sum of the recorded amps"


def test_a_clock_drives_nothing() -> None:
    """A column of time is no cause, and two columns that say the same are tried alike."""
    of = replace(flown(along(0, 300.0 * CHANGE)), channels={"up": Telemetry("up", "time", CHANGE[:, None])})
    search, fit = searching(of)
    found = strongest_signal(search, fit, FLOOR_NT)
    assert found is None or found.hypothesis.driver != "channel:up"


def test_the_strongest_signal_holds_what_is_left() -> None:
    of = flown(along(0, 300.0 * CHANGE))
    channels = {
        "hull": Telemetry("hull", "pressure", WARMTH[:, None]),
        "idle": Telemetry("idle", "pressure", OTHER[:, None]),
    }
    search, fit = searching(replace(of, channels=channels))
    found = strongest_signal(search, fit, FLOOR_NT)
    assert found is not None
    assert (found.hypothesis.driver, found.hypothesis.variant) == ("channel:hull", "field change")
    space = search.workspace(fit)
    assert found.squares == pytest.approx(space.squares - len(TIME_S) * 80.0**2, rel=0.05)
