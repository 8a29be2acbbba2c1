"""Where a recording was made: as stated, else by its altitude, else by its reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.diagnosis.prepare import prepare
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.rows import made_where
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.physics.catalogue import catalogue
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import is_orbit_guessed, scene_of
from magcal_service.recordings.specs import PlatformKind, PlatformSpec
from tests.physics.scenes import scene

TIMES = np.datetime64("2025-03-01T00:00:00", "ns") + np.arange(400) * np.timedelta64(1, "s")
FIELD = 30_000.0 * np.random.default_rng(2).normal(size=(400, 3))


def passing(over_s: float, jumps: bool = False, frame: str = "ecef", times: float = 1.0) -> Recording:
    """A reference whose size changes by a fifth over a time, evenly or in jumps; no frame: its size alone."""
    size = times * (40_000.0 + 8000.0 * np.arange(400) / 400.0)
    size = np.repeat(size[::40], 40) if jumps else size
    since = np.round(np.arange(400) * over_s / 400.0 * 1e9).astype("timedelta64[ns]")
    at = np.datetime64("2025-03-01T00:00:00", "ns") + since
    if not frame:
        return Recording.from_arrays(at, FIELD, size)
    vectors = FIELD * (size / np.linalg.norm(FIELD, axis=1))[:, None]
    return Recording.from_arrays(at, FIELD, vectors, frame=frame)


def made(radius_km: float | None, frame: str = "eci", magnitude: bool = False) -> Recording:
    """A recording at one distance from the Earth's centre."""
    place = None if radius_km is None else np.tile([radius_km, 0.0, 0.0], (400, 1))
    reference = np.linalg.norm(FIELD, axis=1) if magnitude else FIELD
    return Recording.from_arrays(TIMES, FIELD, reference, frame=frame, position_ecef_km=place)


def is_guessed(recording: Recording) -> bool:
    return is_orbit_guessed(recording, scene_of(recording).position_ecef_km)


@pytest.mark.parametrize(
    ("recording", "in_orbit"),
    [
        (made(6371.0 + 450.0), True),
        (made(6371.0 + 130.0), True),
        (made(6371.0 + 110.0), False),
        (made(6371.2, "ecef"), False),
        (made(None), True),
        (made(None, magnitude=True), False),
        (passing(1500.0), True),
        (passing(1500.0, frame="ned"), True),
        (passing(1500.0, frame=""), True),
        (passing(1500.0, frame="", times=1.5), False),
        (passing(1500.0, frame="", times=0.3), False),
        (passing(3.0 * 3600.0), False),
        (passing(1500.0, jumps=True), False),
    ],
)
def test_the_place_is_guessed(recording: Recording, in_orbit: bool) -> None:
    """120 km is where orbits begin; without a place an inertial reference speaks of one, or one that changes as there:
    by a fifth in less than half an hour, smoothly, and within what a low orbit passes through."""
    assert scene_of(recording).in_orbit is in_orbit


def test_only_what_changes_alone_has_told_is_a_guess() -> None:
    guessed = passing(1500.0, frame="")
    assert is_guessed(guessed)
    assert is_guessed(passing(1500.0))
    stated = replace(guessed, descriptor=replace(guessed.descriptor, platform=PlatformSpec(PlatformKind.ORBIT)))
    for known in (stated, made(6821.0), made(None), passing(3.0 * 3600.0)):
        assert not is_guessed(known)


def test_places_that_could_not_be_filled_say_nothing_of_where_it_was() -> None:
    """A row of the middle without a place is filled, as its neighbours are near; seven minutes are too long."""
    over_s = 400 * 4.0
    size = np.linalg.norm(np.nan_to_num(passing(over_s).reference.vector_nt), axis=1)
    at = np.datetime64("2025-03-01T00:00:00", "ns") + np.arange(400) * np.timedelta64(4, "s")
    for missing, guessed in ((slice(200, 201), False), (slice(150, 260), True)):
        place = np.tile([6821.0, 0.0, 0.0], (400, 1))
        place[missing] = np.nan
        recording = Recording.from_arrays(at, FIELD, size, position_ecef_km=place)
        assert is_guessed(recording) is guessed
        lines = made_where(prepare(recording, ()))
        expected = ["places: 110 rows have none", "made in orbit: guessed by how"] if guessed else []
        assert [line[: len(begin)] for line, begin in zip(lines, expected, strict=True)] == expected


@pytest.mark.parametrize("kind", list(PlatformKind))
def test_what_is_stated_holds(kind: PlatformKind) -> None:
    """Whatever the altitude says."""
    recording = made(6371.0 + 450.0)
    stated = replace(recording, descriptor=replace(recording.descriptor, platform=PlatformSpec(kind)))
    assert scene_of(stated).in_orbit is (kind is PlatformKind.ORBIT)


def test_elsewhere_nothing_of_an_orbit_is_looked_for() -> None:
    """No light, no currents in space, no torquers that nobody recorded, no orbit's own place."""
    here = hypotheses_of(catalogue(), Problem(replace(scene(), in_orbit=False), 10.0))
    there = hypotheses_of(catalogue(), Problem(scene(), 10.0))
    only = {effect.name for effect in catalogue() if effect.in_orbit_only}
    assert only == {"external_field", "position_offset", "reference_epoch", "sun_disturbance"}
    assert not [h for h in here if h.effect in only or h.driver.startswith("inferred")]
    left_out = {h.label for h in there} - {h.label for h in here}
    assert all(h.effect in only or h.driver.startswith("inferred") for h in there if h.label in left_out)
    assert any(h.driver.startswith("inferred") for h in there)


def test_the_descriptor_says_it(tmp_path: Path) -> None:
    """``[platform] kind``, and what is none is refused by name."""
    text = 'version = 1\n[samples]\nfile = "a.mcap"\n[platform]\nkind = "{}"\n'
    path = tmp_path / "RECORDING.toml"
    path.write_text(text.format("bench"))
    assert load_descriptor(path).platform == PlatformSpec(PlatformKind.BENCH)
    path.write_text(text.format("moon"))
    with pytest.raises(RecordingError, match=r"platform\.kind.*moon.*orbit"):
        load_descriptor(path)
