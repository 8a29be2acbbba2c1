"""Torquers in a unit a thousand times off are asked about; such as may be are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.defects import Code
from tests.recordings.inspect.clean_logs import CleanLog, Kind, clean_log

PER_AM2 = np.array([[18000.0, 0.0, 0.0], [0.0, -9000.0, 4000.0], [0.0, 0.0, -9000.0]])
CHANNEL = '[channels]\ntorquer = {{ columns = ["tx", "ty", "tz"], unit = "{}" }}'


def log(largest_am2: float, unit: str, per_am2: float = 1.0, held_rows: int = 6) -> CleanLog:
    """Torquers of so many A m2 that are driven in turn, with a sign at random; their numbers are written in A m2
    whatever ``unit`` says.  Their field is ``per_am2`` times the simulator's."""
    clean = clean_log(Kind(channels=False, noise_nt=100.0), seed=41)
    draw, rows = np.random.default_rng(4107), len(clean.time_ns)
    sign = np.repeat(draw.choice([-1.0, 0.0, 0.0, 1.0], (rows // held_rows + 1, 3)), held_rows, axis=0)[:rows]
    moment = largest_am2 * sign
    field = per_am2 * moment @ PER_AM2
    driven = {name: clean.columns[name] + field[:, axis] for axis, name in enumerate(("mx", "my", "mz"))}
    coils = dict(zip(("tx", "ty", "tz"), moment.T, strict=True))
    return clean.changed(**driven, **coils).described(channels=CHANNEL.format(unit))


@pytest.mark.parametrize("written", [1e3, 1.0])
@pytest.mark.parametrize("am2", [0.1, 0.03, 0.5])
def test_torquers_in_another_unit_are_asked_about_with_the_likelier_one(
    am2: float, written: float, tmp_path: Path
) -> None:
    """mA m2 called A m2 (numbers a thousand times too large), and A m2 called mA m2."""
    unit, likelier = ("A m2", "mA m2") if written > 1.0 else ("mA m2", "A m2")
    finding = log(written * am2, unit, per_am2=1.0 / written).found(tmp_path)[Code.TORQUER_UNIT]
    assert not finding.certain
    assert finding.remedy == f'check channels.torquer: if it is so, write unit = "{likelier}"'
    assert finding.says.startswith(f"by its unit {unit} the channel torquer has up to ")
    assert finding.says.endswith(f": likely it is in {likelier}")
    told = float(finding.says.partition("changes by ")[2].split()[0])
    assert 0.2 < told / (18000.0 / written if written > 1.0 else 1.8e7) < 2.0


@pytest.mark.parametrize(
    ("am2", "per_am2"),
    [
        (0.1, 1.0),  # a CubeSat's
        (0.005, 60.0),  # a PocketQube's, 6 cm away
        (2.0, 0.3),
        (30.0, 0.02),  # of a craft of 100 kg, 80 cm away
        (60.0, 0.0),  # and such as the field does not follow
        (1e-5, 0.0),  # commands that are never given
    ],
)
def test_torquers_that_may_be_are_not_asked_about(am2: float, per_am2: float, tmp_path: Path) -> None:
    assert Code.TORQUER_UNIT not in log(am2, "A m2", per_am2).found(tmp_path)


def test_more_than_any_small_craft_has_is_asked_about_though_the_field_does_not_follow(tmp_path: Path) -> None:
    finding = log(200.0, "A m2", 0.0).found(tmp_path)[Code.TORQUER_UNIT]
    assert finding.says == (
        "by its unit A m2 the channel torquer has up to 200 A m2, and torquers of small craft have 15 A m2 at the "
        "most: likely it is in mA m2"
    )
    other = log(200e3, "mA m2", 0.0).found(tmp_path)[Code.TORQUER_UNIT]
    assert other.remedy == "check channels.torquer: its unit, and factor"
    assert other.says.endswith(": likely its unit or its factor is another one")


def test_what_only_goes_as_slowly_as_the_residual_has_no_size(tmp_path: Path) -> None:
    """A weak slow command beside a drift of the sensor is no torquer that is near."""
    clean = clean_log(Kind(channels=False, noise_nt=30.0), seed=43)
    slow = np.linspace(-1.0, 1.0, len(clean.time_ns))
    drifted = clean.changed(mx=clean.columns["mx"] + 2000.0 * slow, tx=1e-5 * slow, ty=0.0 * slow, tz=0.0 * slow)
    assert Code.TORQUER_UNIT not in drifted.described(channels=CHANNEL.format("A m2")).found(tmp_path)


@pytest.mark.parametrize(
    ("usual", "unit", "asked"), [(350.0, "A", True), (350.0, "mA", False), (40.0, "A", False), (350e3, "mA", True)]
)
def test_currents_in_another_unit_are_asked_about(usual: float, unit: str, asked: bool, tmp_path: Path) -> None:
    """mA of a CubeSat called A, by which its field per ampere is a thousand times too small."""
    clean = clean_log(Kind(channels=False), seed=42)
    flows = usual * np.random.default_rng(4108).uniform(0.5, 1.5, len(clean.time_ns))
    channels = f'[channels]\nbus = {{ column = "i", unit = "{unit}" }}'
    found = clean.changed(i=flows).described(channels=channels).found(tmp_path)
    assert (Code.CURRENT_UNIT in found) is asked
    if asked:
        finding = found[Code.CURRENT_UNIT]
        assert not finding.certain
        assert 'write unit = "mA"' in finding.remedy
