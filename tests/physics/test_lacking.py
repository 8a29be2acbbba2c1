"""Why an effect of physics.toml is not compensated: each cause has its own words."""

from __future__ import annotations

import pytest

from magcal_service.physics.apply.forward import DriverMissingError, MisfitError
from magcal_service.physics.apply.lacking import (
    Cause,
    cause_of,
    channels_of,
    in_words,
    lacking_channels,
    undriven_lines,
)
from magcal_service.physics.apply.live_drivers import Held
from magcal_service.physics.apply.model_file import parse_model
from tests.physics.live_models import THERMAL, physics

MISSING = DriverMissingError("it is not there")
HELD = {"temperature": Held(0, 10.0, "temperature", (20.0,)), "bus": Held(0, 1.0, "current", (1.0,))}


@pytest.mark.parametrize(
    ("driver", "now_s", "error", "cause"),
    [
        ("channel:other", 1.0, MISSING, Cause.NO_VALUE),
        ("channel:bus+other", 1.0, MISSING, Cause.NO_VALUE),
        ("channel:temperature", 29.0, MISSING, Cause.OTHER_KIND),
        ("channel:temperature", 31.0, MISSING, Cause.STALE),
        ("channel:temperature+bus", 29.0, MISSING, Cause.STALE),
        ("inferred:temperature", 1.0, MISSING, Cause.NOT_KNOWN),
        ("none", 1.0, MISSING, Cause.NOT_KNOWN),
        ("channel:temperature", 1.0, MisfitError("too large"), Cause.MISFIT),
    ],
)
def test_a_cause_is_told_by_the_newest_values(driver: str, now_s: float, error: Exception, cause: Cause) -> None:
    assert cause_of(error, driver, HELD, round(now_s * 1e9)) is cause


def test_each_cause_has_words_of_its_own() -> None:
    said = {cause: in_words(cause, "channel:temperature", ["temperature"]) for cause in Cause}
    assert len(set(said.values())) == len(Cause)
    assert said[Cause.NO_VALUE] == "channel temperature had no value yet"
    assert said[Cause.STALE] == "the newest value of channel temperature was older than it may be"
    live = in_words(Cause.NO_VALUE, "channel:temprature", ["temperature", "bus"])
    assert live == "nothing has come of channel temprature (did you mean 'temperature'? known: bus, temperature)"
    assert in_words(Cause.NO_VALUE, "channel:gone", []) == "nothing has come of channel gone"


def test_a_plus_stands_between_names_unless_a_name_has_it() -> None:
    assert channels_of("channel:a+b") == ("a", "b")
    assert channels_of("channel:a+b", ["a+b"]) == ("a+b",)
    assert channels_of("inferred:a+b") == ()


def test_what_a_recording_lacks_is_said_by_name() -> None:
    assert lacking_channels(["channel:temperature", "none"], {"temperature": True}) == []
    assert lacking_channels(["channel:temperature"], {"temperature": False}) == [
        "channel temperature of the recording has no value in any row"
    ]
    assert lacking_channels(["channel:bus+gone"], {"bus": True, "heat": True}) == [
        "the recording has no channel gone (known: bus, heat)"
    ]


def test_a_name_that_is_misspelt_is_told_with_the_one_that_was_meant() -> None:
    text = physics(*THERMAL, origin_ns=0).text.replace("channel:temperature", "channel:temprature", 1)
    (line,) = undriven_lines("mine.toml", parse_model(text.encode()), {"temperature": True})
    assert line == (
        "mine.toml: effect[0].driver: 'channel:temprature': the recording has no channel temprature (did you mean "
        "'temperature'? known: temperature); thermal_bias is not compensated: describe that channel, correct its "
        "name here, or take the effect out"
    )
