"""Concealed cases as a whole: repeatable, readable, as strong as they say, and silent about their answer."""

from __future__ import annotations

import ast
import json
import math
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import Clock
from tests.blind import DRIVEN, EFFECTS, KINDS, PAIRS, Case, draw_case, seal_answer, write_case
from tests.blind.catalogue import BUILDERS, UNLIKE
from tests.blind.sensor import Spoiling, measure, scalar_residual
from tests.blind.streams import Streams
from tests.blind.strength import Scales
from tests.blind.vectors import Floats, unit
from tests.blind.world import World, draw_world

READING = ("magcal_service.recordings.reader", "magcal_service.wire.messages")


@cache
def _drawn(kind: str) -> Case:
    return draw_case(11, kind)


@cache
def _short_world() -> World:
    world = draw_world(Streams(3, "zero"))
    return replace(world, time_s=world.time_s[:3000])


@pytest.mark.parametrize("name", BUILDERS)
def test_zero_strength_changes_nothing(name: str) -> None:
    """At scale 0 the samples and the reference are those of the undisturbed craft."""
    cause = BUILDERS[name](_short_world(), True)
    clean, spoiled = measure(cause.world), measure(cause.world, [cause.spoil(0.0)])
    assert np.abs(spoiled.field_nt - clean.field_nt).max() < 1e-6
    assert np.abs(spoiled.reference_nt - clean.reference_nt).max() < 1e-6


@pytest.mark.parametrize("kind", [*sorted(DRIVEN), "coloured_noise", "nutation", "pair", "none", "outside"])
def test_reader_takes_every_kind(kind: str, tmp_path: Path) -> None:
    """The recording's reader takes the folder and finds the arrays of the case in it, to the written digits."""
    case = _drawn(kind)
    recording = read_recording(write_case(case, tmp_path))
    assert recording.report.used == len(case.time_s)
    assert np.array_equal(recording.field_body_nt, case.field_nt)
    vector = recording.reference.vector_nt
    assert np.array_equal(recording.reference.magnitude_nt if vector is None else vector, case.reference_nt)
    assert (recording.clock is Clock.UTC) is (case.start_unix_s is not None)
    assert (recording.position is None) is (case.position is None)
    assert set(recording.channels) == {channel.name for channel in case.channels}


@pytest.mark.parametrize("kind", KINDS)
def test_strength_and_detectability_are_in_range(kind: str) -> None:
    """Every effect of a case is detectable at 12 or more; one whose strength was free has 0.1 to 2 sigma."""
    for effect in _drawn(kind).answer.effects if kind != "absorbed" else ():
        assert effect.detectability >= 12.0
        assert effect.alone >= effect.detectability - 1e-9
        if effect.scalar:
            assert 0.095 < effect.strength < 2.05


def test_what_is_absorbed_leaves_no_trace() -> None:
    """At a constant rate a lag and a skew change the samples by many sigma and the calibrated residual by none."""
    for seed in range(4):
        case = draw_case(seed, "absorbed")
        assert case.answer.verdict == "none"
        assert case.answer.also == (case.answer.effects[0].effect,)
        assert not case.answer.effects[0].scalar
        assert case.answer.effects[0].detectability < 2.0


def test_package_shares_nothing_with_the_diagnosis() -> None:
    """Beside numpy, ppigrf and the standard library the generator imports the field model of the product alone."""
    for path in Path(__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text())
        modules = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        modules |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
        names = {name.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for name in node.names}
        used = {module for module in modules if module.split(".")[0] not in {*sys.stdlib_module_names, "tests"}}
        if path.name.startswith("test_"):
            assert used <= {"numpy", "pytest", "magcal_service.earth", *READING}
        else:
            assert used <= {"numpy", "numpy.typing", "ppigrf", "magcal_service.earth"}
        assert "magcal_service.earth" not in used or "geomagnetic" in names


def test_detectability_is_what_is_left_beside_the_calibration() -> None:
    """Least squares in the nine errors leaves the norm, over sigma, that the answer calls detectability."""
    world = draw_world(Streams(4, "detectability"))
    cause = EFFECTS["bias_step"](world, True)
    clean, spoiled = measure(world), measure(world, [cause.spoil(150.0)])
    change = scalar_residual(world, spoiled) - scalar_residual(world, clean)
    field = clean.field_nt
    u = unit(field @ (np.eye(3) + world.scale) - world.bias_nt)
    full = np.concatenate([u, (u[:, :, None] * field[:, None, :]).reshape(-1, 9)], axis=1)  # rank 9 of 12 columns
    symmetric = np.concatenate([full[:, :3], full[:, [3, 7, 11]], full[:, [4, 5, 8]] + full[:, [6, 9, 10]]], axis=1)
    left = change - symmetric @ np.linalg.lstsq(symmetric / 4e4, change / 4e4, rcond=None)[0]
    assert Scales(cause).at(150.0).detectability == pytest.approx(np.linalg.norm(left) / world.noise_nt, rel=1e-6)


def test_nothing_is_left_of_what_the_calibration_absorbs() -> None:
    """A bias that is constant has a strength, and no detectability at all."""
    world = draw_world(Streams(4, "absorbed"))
    step = EFFECTS["bias_step"](world, True)
    always = np.ones_like(world.time_s)[:, None] * 100.0
    constant = replace(step, spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * always))
    tuned = Scales(constant).at(1e-3)
    assert tuned.strength == pytest.approx(0.1 * math.sqrt(3.0) / world.noise_nt, rel=1e-6)
    assert tuned.detectability < 1e-3 * tuned.strength * math.sqrt(len(world.time_s))


def test_clean_case_holds_its_noise_and_nothing_else() -> None:
    """With the answer's D and b the residual of a clean case is white and as large as the answer's noise."""
    for seed in range(4):
        case = draw_case(seed, "none")
        residual = _residual(case.field_nt, case.reference_nt, case.answer.bias_nt, case.answer.scale)
        count = len(residual)
        assert residual.std() == pytest.approx(case.answer.noise_nt, rel=4.0 / math.sqrt(2 * count))
        neighbours = float(np.corrcoef(residual[1:], residual[:-1])[0, 1])
        assert abs(neighbours) < 4.0 / math.sqrt(count)


def _residual(field: Floats, reference: Floats, bias: object, scale: object) -> Floats:
    length = np.linalg.norm(reference, axis=1) if reference.ndim == 2 else reference
    return np.asarray(np.linalg.norm(field @ (np.eye(3) + np.array(scale)) - np.array(bias), axis=1) - length)


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    """Drawn and written twice, a case has the same bytes and the same answer; another seed has others."""
    texts = []
    for name, seed in (("a", 21), ("b", 21), ("c", 22)):
        case = draw_case(seed, "tone+thermal_bias")
        descriptor = write_case(case, tmp_path / name)
        texts.append((descriptor.read_text(), (tmp_path / name / "samples.csv").read_text(), case.answer.to_json()))
    assert texts[0] == texts[1]
    assert texts[0][1] != texts[2][1]


@pytest.mark.parametrize("kind", sorted(DRIVEN))
def test_driver_is_left_out_when_said(kind: str) -> None:
    """Without its driver a case has no channel that the answer names, and none of the driver's kind."""
    units = {"thermal_bias": "degC", "thermal_scale": "degC", "current_loop": "A", "torquer": "A m2"}
    with_it = _drawn(kind)
    without_it = draw_case(11, kind, driver_recorded=False)
    assert set(with_it.answer.effects[0].driver) <= {channel.name for channel in with_it.channels}
    assert with_it.answer.effects[0].driver
    assert not without_it.answer.effects[0].driver
    assert units.get(kind, "none of them") not in {channel.unit for channel in without_it.channels}
    assert "sun" not in {channel.name for channel in without_it.channels} or kind != "sun_disturbance"


def test_recording_says_nothing_of_the_answer(tmp_path: Path) -> None:
    """Neither the descriptor nor the header of the log names the effect, the seed or the noise that was not stated."""
    for kind in ("bias_step", "outside:walk", "quantisation"):
        case = draw_case(41, kind)
        descriptor = write_case(case, tmp_path / kind.replace(":", "_"))
        text = descriptor.read_text() + (descriptor.parent / "samples.csv").read_text()[:200]
        assert sorted(path.name for path in descriptor.parent.iterdir()) == ["RECORDING.toml", "samples.csv"]
        for word in (kind.rpartition(":")[2], "seed", "answer", "outside", "decoy"):
            assert word not in text


def test_answer_stays_out_of_the_recordings_folder(tmp_path: Path) -> None:
    """An answer is refused inside the recording's folder, and elsewhere it reads back with the same numbers."""
    case = draw_case(41, "tone")
    descriptor = write_case(case, tmp_path / "case")
    with pytest.raises(ValueError, match="outside of"):
        seal_answer(case.answer, tmp_path / "case" / "answers" / "a.json", descriptor)
    seal_answer(case.answer, tmp_path / "answers" / "a.json", descriptor)
    read = json.loads((tmp_path / "answers" / "a.json").read_text())
    assert read["effects"][0]["parameters"]["amplitude_nt"] == case.answer.effects[0].parameters["amplitude_nt"]


def test_unknown_kind_is_refused() -> None:
    """A kind that does not exist is refused with what is accepted."""
    with pytest.raises(ValueError, match="outside:NAME"):
        draw_case(1, "thermal")


def test_pairs_are_of_two_unlike_effects() -> None:
    """Every pair has two different effects with a scalar signature that can be told apart."""
    assert len(PAIRS) > 60
    assert all(first != second and frozenset({first, second}) not in UNLIKE for first, second in PAIRS)
    names = {effect.effect for effect in draw_case(3, "tone+bias_step").answer.effects}
    assert names == {"tone", "bias_step"}


def test_more_draws_from_one_stream_change_no_other() -> None:
    """Streams are known by name: one that is drawn from at length leaves the others as they are."""
    streams = Streams(9, "streams")
    expected = streams.rng("noise").normal(size=5)
    streams.rng("strength").normal(size=1000)
    assert np.array_equal(streams.rng("noise").normal(size=5), expected)
    assert not np.array_equal(streams.rng("other").normal(size=5), expected)
