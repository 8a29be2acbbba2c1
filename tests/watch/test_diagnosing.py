"""The command that diagnoses a finding: what is said can be read again, and pasted into a shell."""

from __future__ import annotations

import shlex

import pytest

from magcal_service.watch.diagnosing import doubt, found_in, of_recording

WHAT = "looks like thermal_bias (channel temperature), 34 nats over 46 min"


def test_a_recording_that_is_not_known_is_left_to_be_put_in() -> None:
    said = f"{doubt(WHAT)}; doubtful (model_doubtful), 9 ticks"
    assert found_in(said) == (WHAT, "magcal diagnose RECORDING")
    assert found_in("trusted, 9 ticks") is None


@pytest.mark.parametrize("recording", ["a.mcap", "my days/a.mcap", "it's; run: me.mcap", "RECORDING"])
@pytest.mark.parametrize("options", [(), ("--craft", "sat-1"), ("--craft", "sat-1", "--source", "boom; 2")])
def test_the_command_for_a_recording_is_read_back_as_it_was_meant(recording: str, options: tuple[str, ...]) -> None:
    said = of_recording(f"frozen, {doubt(WHAT)}; doubtful, 9 ticks; last event: reset", recording, options)
    assert said.endswith("; doubtful, 9 ticks; last event: reset")
    found = found_in(said)
    assert found is not None
    assert found[0] == WHAT
    assert shlex.split(found[1]) == ["magcal", "diagnose", recording, *options]


def test_a_text_without_a_finding_stays_as_it_is() -> None:
    assert of_recording("trusted; last event: RECORDING", "a.mcap") == "trusted; last event: RECORDING"
