"""The simulator of the regimes: independent, repeatable, and right about its own answers."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.cli.__main__ import main as magcal
from magcal_service.physics.catalogue import catalogue
from tests.regimes import attitude
from tests.regimes.case import LEAST_DETECTABILITY, Case, draw_case, rows
from tests.regimes.causes import EFFECTS, OUTSIDE, bouc_wen, hysteresis
from tests.regimes.field import DIPOLE_ECEF, igrf_ecef
from tests.regimes.orbit import Floats
from tests.regimes.sensor import Measured, lagging
from tests.regimes.world import REGIMES, draw_world
from tests.regimes.write import write_case

HERE = Path(__file__).parent
SIMULATOR = [path for path in sorted(HERE.glob("*.py")) if not path.name.startswith("test_")]
ALLOWED = {"numpy", "ppigrf"}


def _imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    relative = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level]
    assert not relative, f"{path.name}: relative imports hide where they lead"
    return found | {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}


@pytest.mark.parametrize("path", SIMULATOR, ids=lambda path: path.name)
def test_simulator_shares_no_code_with_the_product(path: Path) -> None:
    """Every module of it imports the standard library, numpy, ppigrf and its own package, nothing else."""
    for name in _imports(path):
        top = name.partition(".")[0]
        own = name == "tests.regimes" or name.startswith("tests.regimes.")
        assert own or top in ALLOWED or top in sys.stdlib_module_names, name


def test_writing_cases_loads_nothing_of_the_product() -> None:
    """Whatever is imported by name or otherwise: with the simulator loaded, the product is not."""
    code = "import sys, tests.regimes.__main__; print([m for m in sys.modules if m.startswith(('magcal_', 'sim_'))])"
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parents[1], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "[]"


def test_effects_have_the_names_of_the_catalogue() -> None:
    """Those in answers are names of the catalogue (panel currents are its current_loop); those outside are none."""
    names = {effect.name for effect in catalogue()}
    assert {name for name in EFFECTS if name != "panel_current"} <= names
    assert not set(OUTSIDE) & names


@pytest.fixture(scope="module")
def cases() -> tuple[Case, ...]:
    """One case of each regime."""
    return tuple(draw_case(5, index) for index in range(len(REGIMES)))


@pytest.fixture(scope="module")
def clean() -> tuple[Case, ...]:
    """One clean case of each regime."""
    return tuple(draw_case(6, index, clean=True) for index in range(len(REGIMES)))


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    """A case drawn again is the same to the byte, answer included; another seed gives another."""
    index = list(REGIMES).index("short")
    written = []
    for folder, seed in (("a", 7), ("b", 7), ("c", 8)):
        case = draw_case(seed, index)
        path = write_case(case, tmp_path / folder)
        written.append((path.read_bytes(), path.with_suffix(".csv").read_bytes(), json.dumps(case.answer)))
    assert written[0] == written[1]
    assert written[0][1] != written[2][1]


def _again(case: Case, changed: Measured, twin: Measured) -> float:
    """Detectability by another way: derivatives by differences of the nine errors, and least squares."""
    bias, matrix = np.array(case.answer["bias_nt"]), np.eye(3) + np.array(case.answer["D"])
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

    def residual(measured: Measured, x: Floats) -> Floats:
        moved = matrix.copy()
        for (a, b), value in zip(pairs, x[3:], strict=True):
            moved[a, b] += value
            moved[b, a] = moved[a, b]
        length = np.sqrt((((moved @ measured.samples.T).T - bias - x[:3]) ** 2).sum(axis=1))
        return rows(case, length - np.sqrt((measured.reference**2).sum(axis=1)))

    columns = []
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1.0 if k < 3 else 1e-5
        columns.append((residual(twin, step) - residual(twin, -step)) / 2.0)
    change = residual(changed, np.zeros(9)) - residual(twin, np.zeros(9))
    left = change - np.stack(columns, axis=1) @ np.linalg.lstsq(np.stack(columns, axis=1), change, rcond=None)[0]
    return float(np.sqrt((left**2).sum()) / case.answer["noise_nt"])


def test_detectability_is_what_a_second_computation_gives(cases: tuple[Case, ...]) -> None:
    """Of every case with one cause, to a thousandth; and no case is harder to find than is promised."""
    single = [case for case in cases if len(case.answer["effects"]) == 1]
    assert len(single) >= 5
    for case in single:
        assert case.answer["detectability"] == pytest.approx(_again(case, case.changed, case.twin), rel=1e-3)
    for case in cases:
        assert all(effect["detectability"] >= LEAST_DETECTABILITY for effect in case.answer["effects"])


def test_with_the_true_errors_a_clean_case_leaves_its_noise(clean: tuple[Case, ...]) -> None:
    """|(I + D) B - b| - |H| of the recorded rows has the stated sigma in every regime, where samples have no flaw."""
    sound = [
        case for case in clean if case.answer["flaw"] in ("none", "fine lattice") and not case.world.model_parts_nt
    ]
    assert len(sound) >= 5
    for case in sound:
        matrix, sigma = np.eye(3) + np.array(case.answer["D"]), case.answer["noise_nt"]
        calibrated = case.samples @ matrix - np.array(case.answer["bias_nt"])
        left = rows(case, np.linalg.norm(calibrated, axis=1) - np.linalg.norm(case.reference, axis=1))
        widened = 1.01 if case.answer["flaw"] == "fine lattice" else 1.0
        assert np.sqrt(np.mean(left**2)) == pytest.approx(sigma * widened, rel=0.01 + 4.0 / np.sqrt(2.0 * len(left)))


def test_a_concealed_driver_leaves_no_channel_of_its_kind() -> None:
    """Neither the driver nor a decoy in its unit is recorded."""
    units = {"temperature": "degC", "bus_current": "A", "panel_current": "A", "torquer": "A m2"}
    concealed = [
        case for case in (draw_case(9, index) for index in (0, 4, 5, 6, 8, 9)) if case.answer["driver_concealed"]
    ]
    assert concealed
    for case in concealed:
        hidden = {units[driver] for effect in case.answer["effects"] for driver in effect["driver"]}
        assert hidden
        assert not hidden & {channel.unit for channel in case.channels}


def test_a_free_body_keeps_momentum_and_energy() -> None:
    """Tumbling by Euler's equations: the momentum stays put in space, the energy stays the same."""
    inertia, seconds = np.array([0.7, 1.0, 1.3]), 3000.0
    motion = attitude.rigid_body(inertia, np.array([0.03, 0.02, -0.01]), np.array([1.0, 0.2, -0.4, 0.1]), seconds)
    t, h = np.linspace(1.0, seconds - 1.0, 400), 0.05
    turned = np.einsum("nij,nkj->nik", motion(t + h), motion(t - h))  # exp(-2 h [rate]x)
    cross = (turned - np.transpose(turned, (0, 2, 1))) / (4.0 * h)
    rate = -np.stack([cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0]], axis=1)
    momentum = np.einsum("nji,nj->ni", motion(t), inertia * rate)
    energy = (inertia * rate**2).sum(axis=1)
    off = np.linalg.norm(momentum - momentum[0], axis=1) / np.linalg.norm(momentum[0])
    assert off.max() < 5e-3  # the rate is a difference across knots
    assert np.abs(energy / energy[0] - 1.0).max() < 5e-3


def test_quaternions_are_those_of_the_matrices() -> None:
    """Each is the inverse of the other."""
    turns = attitude.matrices(np.random.default_rng(0).standard_normal((500, 4)))
    assert attitude.matrices(attitude.quaternions(turns)) == pytest.approx(turns, abs=1e-12)


def test_a_lag_shrinks_what_turns() -> None:
    """A low-pass leaves 1 / sqrt(1 + (w tau)^2) of the field across a steady spin, and the field along it."""
    world = draw_world("spin_slow", np.random.default_rng(3))
    assert world.spin is not None
    axis, rate_rpm = world.spin
    tau = 3.0
    late, across = lagging(world, tau)[200:], ~axis.astype(bool)
    kept = np.linalg.norm(late[:, across], axis=1) / np.linalg.norm(world.field_body[200:, across], axis=1)
    assert np.median(kept) == pytest.approx(1.0 / np.hypot(1.0, rate_rpm * 2.0 * np.pi / 60.0 * tau), rel=2e-3)


def test_a_rods_loop_closes_where_bouc_and_wen_have_it() -> None:
    """To and fro between -h and h it ends at tanh(b h / w) / b, the fixed point of half a loop by hand."""
    height, width, bend = 30000.0, 7000.0, 0.8
    way = height * np.cos(np.linspace(0.0, 20.0 * np.pi, 10 * 64 + 1))
    ends = bouc_wen(way, width, bend)[-1 : -3 * 32 : -32]
    assert ends == pytest.approx(np.tanh(bend * height / width) / bend * np.array([1.0, -1.0, 1.0]), rel=1e-9)


def test_a_rod_remembers_what_it_passes_between_samples() -> None:
    """At 24 rpm and 1 Hz the field turns by 144 deg from sample to sample; ten times as many give the same course."""
    world = draw_world("spin_fast", np.random.default_rng(4))
    motion = attitude.spinning(np.random.default_rng(5), 24.0, np.array([0.0, 0.0, 1.0]))
    found = []
    for often in (1, 10):
        t = np.arange(1200 * often) / often
        space = np.tile(world.true_field[0], (len(t), 1))
        turning = replace(world, t=t, true_field=space, motion=motion, kept=np.ones(len(t), dtype=bool))
        added = hysteresis(turning, np.random.default_rng(6)).change(1.0).added
        assert added is not None
        found.append(added[::often])
    one, many = (course / np.linalg.norm(course) for course in found)
    assert np.linalg.norm(one - many) < 0.02


def test_the_dipole_is_what_is_left_of_the_field_far_away() -> None:
    """Ten million km away B . r is 2 m . r: along the three axes the moment's components, by ppigrf."""
    far = 1e7 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1e-6, 0.0, 1.0]])
    moment = np.diagonal(igrf_ecef(far, 1_735_689_600.0))
    assert moment / np.linalg.norm(moment) == pytest.approx(DIPOLE_ECEF, abs=1e-3)


def test_bodies_that_tumble_can_be_built() -> None:
    """The largest moment of inertia is below the sum of the others, and no two are alike."""
    rng = np.random.default_rng(8)
    for _ in range(2000):
        first, second, third = attitude.unequal_inertia(rng).tolist()
        assert third < first + second
        assert first + 0.1 < second + 1e-9
        assert second + 0.1 < third + 1e-9


def test_a_clean_case_calibrates_to_the_truth(tmp_path: Path) -> None:
    """``magcal calibrate`` of a clean case as written, outliers in it: each of the nine errors within 4 sigma."""
    case = draw_case(6, list(REGIMES).index("tumbling"), clean=True)
    assert case.answer["flaw"] == "outliers"
    path = write_case(case, tmp_path / "case")
    assert magcal(["calibrate", str(path), "--json", str(tmp_path / "result.json")]) == 0
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    upper = np.triu_indices(3)
    found = np.r_[result["bias_nt"], np.array(result["D"])[upper]]
    sigma = np.r_[result["sigma"]["bias_nt"], np.array(result["sigma"]["D"])[upper]]
    truth = np.r_[case.answer["bias_nt"], np.array(case.answer["D"])[upper]]
    assert np.abs((found - truth) / sigma).max() < 4.0
