"""Every effect of the catalogue against concealed cases: it is found in its own, and keeps quiet in all others.

The cases come from ``tests.blind``, which shares no code with what is tested; each is written, read back and diagnosed
once.  Seeds are of recordings with one sample every 5 s, which keeps a diagnosis at about a second.  A seed for a new
effect is any whose case is such a recording; more than one may be printed, and the tests say whether it is answered:

    print([seed for seed in range(1, 100) if np.median(np.diff(draw_case(seed, NAME).time_s)) == 5.0])

A case that is not answered is a fault of the effect or of the search, and no reason for another seed.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.result import entries
from magcal_service.physics.catalogue import catalogue
from magcal_service.recordings.reader import read_recording
from tests.blind import DRIVEN, EFFECTS, Answer, draw_case, write_case

SEEDS = {
    "axis_skew": 241,
    "bias_drift": 82,
    "bias_step": 46,
    "coloured_noise": 1,
    "cubic_response": 90,
    "current_loop": 64,
    "external_field": 8,
    "hysteresis": 90,
    "nutation": 96,
    "position_offset": 61,
    "quantisation": 100,
    "reference_epoch": 288,
    "response_lag": 76,
    "saturation": 8,
    "scale_drift": 38,
    "scale_step": 112,
    "spin_rate": 144,
    "stuck_axis": 8,
    "sun_disturbance": 21,
    "thermal_bias": 95,
    "thermal_scale": 38,
    "time_offset": 208,
    "tone": 1,
    "torquer": 8,
}
"""One case for each effect, with its driver recorded where it has one."""

CLEAN = (1, 13, 27, 58)
"""Cases with nothing wrong."""


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said of a case, and the case's answer."""

    answer: Answer
    verdict: str
    entries: tuple[Entry, ...]

    @property
    def first(self) -> Entry | None:
        """The first effect that counts: what is true beside the cause counts neither way."""
        causes = {truth.effect for truth in self.answer.effects}
        counted = (e for e in self.entries if e.effect in causes or e.effect not in self.answer.also)
        return next(counted, None)


@cache
def outcome(kind: str, seed: int) -> Outcome:
    """The diagnosis of one case, through the files that a user would have."""
    case = draw_case(seed, kind)
    with tempfile.TemporaryDirectory(prefix="magcal-case-") as folder:
        diagnosis = diagnose(read_recording(write_case(case, Path(folder) / "case")))
    return Outcome(case.answer, str(diagnosis.verdict), entries(diagnosis))


def test_every_effect_has_a_case() -> None:
    """No effect of the catalogue is left out of the table."""
    names = {effect.name for effect in catalogue()}
    assert names - set(EFFECTS) == set(), "add a builder to EFFECTS of tests/blind/catalogue.py"
    assert names - set(SEEDS) == set(), "add a seed to SEEDS here, found as the file's docstring says"
    assert (set(EFFECTS) | set(SEEDS)) - names == set(), "remove what is in no catalogue"


@pytest.mark.parametrize("effect", sorted(SEEDS))
def test_effect_is_found(effect: str) -> None:
    """In its own case it is named first, or stands in the class of what is; by its channel where it has one."""
    found = outcome(effect, SEEDS[effect])
    assert found.verdict == ("none" if effect == "coloured_noise" else "named")  # noise explains no mismatch
    assert found.first is not None
    assert effect in (found.first.effect, *found.first.members)
    assert (effect in DRIVEN) == found.first.driver.startswith("channel:")


@pytest.mark.parametrize("effect", sorted(SEEDS))
def test_effect_keeps_quiet(effect: str) -> None:
    """It is not named at all in clean cases, nor first where another effect is at work that it is told apart from."""
    for seed in CLEAN:
        assert effect not in {entry.effect for entry in outcome("none", seed).entries}
    loud = []
    for other, seed in SEEDS.items():
        first = outcome(other, seed).first
        if other != effect and first is not None and first.effect == effect and other not in first.members:
            loud.append(other)
    assert loud == []


@pytest.mark.parametrize("seed", CLEAN)
def test_nothing_wrong_is_nothing_found(seed: int) -> None:
    """A clean recording gets the verdict none and no entry."""
    found = outcome("none", seed)
    assert (found.verdict, found.entries) == ("none", ())
