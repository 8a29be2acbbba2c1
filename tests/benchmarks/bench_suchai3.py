"""What sunlight does to SUCHAI-3 by one orbit's diagnosis, held against its photodiodes and against other days.

    python -m tests.benchmarks.bench_suchai3 [--data ../shared/data]

Photodiodes are hidden from the diagnosis throughout.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.scene.scene import Scene
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import scene_of

DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
WITNESS = "photodiodes"
LIGHT = ("thermal_scale", "thermal_bias", "current_loop")
SHIFTS_S = (-300, -120, -60, -30, -15, 0, 15, 30, 60, 120, 300)


def main() -> None:
    """Print the checks of one orbit against its photodiodes and other days, one line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    folder = parser.parse_args().data / "suchai3"
    cross(folder / "2023-08-24.toml", [folder / f"{name}.toml" for name in ("2023-11-13", "2024-passes")])


def blind(path: Path) -> Recording:
    """A recording without its photodiodes."""
    recording = read_recording(path)
    kept = {name: channel for name, channel in recording.channels.items() if name != WITNESS}
    return replace(recording, channels=kept)


def light_fit(diagnosis: Diagnosis) -> Fit:
    """Nine errors and those of the effects found that sunlight drives."""
    terms = [term for term in diagnosis.fit.terms if term.hypothesis.effect in LIGHT]
    return solve(diagnosis.prepared.problem, diagnosis.fit.x, terms)


def shadow_moved(diagnosis: Diagnosis, fit: Fit, seconds: float) -> float:
    """Held-out rms [nT] of the same effects where the Earth's shadow is ``seconds`` later than the model has it."""
    scene = diagnosis.prepared.problem.scene
    assert scene.lit is not None
    moved = replace(scene)
    moved.__dict__["lit"] = np.interp(scene.time_s - seconds, scene.time_s, scene.lit)
    problem = replace(diagnosis.prepared.problem, scene=moved)
    forms = {hypothesis.label: hypothesis for hypothesis in hypotheses_of(catalogue(), problem)}
    terms = [Term(forms[t.hypothesis.label], t.theta, t.amplitudes) for t in fit.terms]
    return solve(problem, fit.x, terms).held_out_rms_nt


def dark_edges(path: Path) -> tuple[Array, Array]:
    """When the shadow begins and ends [s from the first sample]: by the model, and by the photodiodes."""
    recording = read_recording(path).sorted_unique()
    time_s = (recording.time_ns - recording.time_ns[0]) * 1e-9
    scene = scene_of(recording)
    assert scene.lit is not None
    light = np.asarray(recording.channels[WITNESS].values).sum(axis=1)
    dark = _longest(light <= 0.05 * np.percentile(light, 95))
    shadow = _longest(scene.lit < 0.5)
    return time_s[list(shadow)], time_s[list(dark)]


def _longest(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """First row of the longest run of true flags, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    best = int(np.argmax(ends - starts))
    return int(starts[best]), min(int(ends[best]), len(flags) - 1)


def panels(scene: Scene, axis: Array | None = None, turned_rad: float = 0.0) -> Array:
    """(n, 6) light on faces +x +y +z -x -y -z; ``turned_rad``: as if the Sun stood elsewhere about an axis."""
    assert scene.sun_body is not None
    assert scene.lit is not None
    sun = scene.sun_body
    if axis is not None:
        across = np.cross(axis, sun)
        along = np.outer(sun @ axis, axis)
        sun = along + np.cos(turned_rad) * (sun - along) + np.sin(turned_rad) * across
    faces: Array = np.concatenate([np.maximum(sun, 0.0), np.maximum(-sun, 0.0)], axis=1) * scene.lit[:, None]
    return faces


def panel_field(diagnosis: Diagnosis, fit: Fit) -> Array:
    """(6, 3) field of each face in full sun [nT] as found; zero for a face that the recording says nothing of."""
    term = next(t for t in fit.terms if t.hypothesis.variant == "every panel its own circuit")
    used = np.std(panels(diagnosis.prepared.problem.scene), axis=0) > 0.02
    field = np.zeros((6, 3))
    field[used] = term.amplitudes.reshape(-1, 3)
    return field


def frozen(other: Diagnosis, field: Array, share: float = 1.0, turned_deg: float = 0.0) -> float:
    """Held-out rms [nT] of nine errors on another recording with a frozen field of the panels (6, 3) subtracted."""
    problem, spin = other.prepared.problem, other.prepared.spin
    assert spin is not None
    light = panels(problem.scene, spin.axis_body, np.radians(turned_deg))
    scene = replace(problem.scene, field_nt=problem.scene.field_nt - share * light @ field)
    return solve(replace(problem, scene=scene), other.prepared.baseline.x).held_out_rms_nt


def cross(path: Path, others: list[Path]) -> None:
    """The checks that decide, one line each."""
    began = time.process_time()
    first = diagnose(blind(path))
    fit = light_fit(first)
    print(f"effects by light alone: {[term.hypothesis.label for term in fit.terms]}")
    print(f"held out {first.prepared.baseline.held_out_rms_nt:.0f} -> {fit.held_out_rms_nt:.0f} nT")
    model, seen = dark_edges(path)
    print(f"shadow by the model {model} s, photodiodes dark {seen} s")
    for seconds in SHIFTS_S:
        print(f"shadow moved by {seconds} s: held out {shadow_moved(first, fit, seconds):.0f} nT")
    field = panel_field(first, fit)
    print(f"faces in full sun: at most {np.abs(field).max():.0f} nT")
    for other in others:
        compare(diagnose(blind(other)), field, f"{other.stem}, panels of {path.stem} frozen")
    print(f"{time.process_time() - began:.0f} s")


def compare(other: Diagnosis, field: Array, name: str) -> None:
    """The panels' field of one recording on another, and what that one finds by itself."""
    print(f"{name}: nine errors, held out {other.prepared.baseline.held_out_rms_nt:.0f} nT")
    for share in (-1.0, 0.5, 1.0, 1.5):
        print(f"{name} times {share}: held out {frozen(other, field, share):.0f} nT")
    for turned in range(45, 360, 45):
        print(f"{name}, the Sun turned by {turned} deg: held out {frozen(other, field, 1.0, turned):.0f} nT")
    own = [term for term in other.fit.terms if term.hypothesis.effect == "current_loop"]
    for term in own:
        print(f"{name}: its own faces in full sun: at most {np.abs(term.amplitudes).max():.0f} nT")


if __name__ == "__main__":
    main()
