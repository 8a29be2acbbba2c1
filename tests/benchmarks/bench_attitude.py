"""Why a quadrotor's recorded attitude makes its calibration no better: docs/recordings.md.

    python -m tests.benchmarks.bench_attitude [--data ../shared/data]

The nine errors of ardupilot/log171's internal compass, fitted to whole vectors and to magnitudes; how far the measured
direction is off the attitude, by tenths of the flight; and what part of the flight each form of residual can hold.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from magcal_service.diagnosis.prepare import Form, Prepared, prepare
from magcal_service.diagnosis.searching import in_form
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import recorded_attitude
from magcal_service.residuals import rms

DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
PARTS = 10


def main() -> None:
    """Print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    whole = inspect(read_recording(options.data / "ardupilot" / "log171-internal-attitude.toml")).to_diagnose
    for name, recording in (("whole flight", whole), ("without its last tenth", first_tenths(whole, PARTS - 1))):
        vectors, magnitudes = (prepare(recording, catalogue(), forms) for forms in (tuple(Form), (Form.SCALAR,)))
        print(f"{name}: nine errors alone, held out along the field [nT]: ", end="")
        print(f"vectors {along_nt(vectors):.0f}, magnitudes {along_nt(magnitudes):.0f}")
        print("  direction off the attitude, rms by tenths [deg]:", *in_tenths(off_deg(vectors), rms))
    tilt = np.degrees(np.arccos(np.clip(attitude_of(whole)[:, 2, 2], -1.0, 1.0)))
    print("largest tilt by tenths [deg]:", *in_tenths(tilt, lambda part: float(np.max(part))))
    prepared, _, _, not_borne_out = in_form(whole, catalogue())
    forms = ", ".join(not_borne_out) or "none"
    print(f"a search takes {prepared.form}; not borne out: {forms}")


def first_tenths(recording: Recording, count: int) -> Recording:
    """The first so many tenths of the rows."""
    rows = len(recording.time_ns)
    return recording.select(np.arange(rows) < rows * count // PARTS)


def along_nt(prepared: Prepared) -> float:
    """Held-out rms of the residual along the field [nT], which both forms have."""
    fit = prepared.baseline
    if not fit.problem.is_vector:
        return fit.held_out_rms_nt
    return rms(np.einsum("ni,ni->n", fit.unit, fit.held_out_residual.reshape(-1, 3)))


def off_deg(prepared: Prepared) -> Array:
    """(n,) angles between the calibrated vectors and the reference by the attitude and the fitted mounting [deg]."""
    fit = prepared.baseline
    target = fit.problem.target(fit.x)
    measured = target + fit.residual.reshape(-1, 3)
    lengths = np.linalg.norm(measured, axis=1) * np.linalg.norm(target, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(np.einsum("ni,ni->n", measured, target) / lengths, -1.0, 1.0))))


def attitude_of(recording: Recording) -> Array:
    """(n, 3, 3) body from reference axes."""
    found = recorded_attitude(recording)
    assert found is not None
    return found[1]


def in_tenths(values: Sequence[float] | Array, of: object) -> list[str]:
    """A number of each tenth."""
    assert callable(of)
    return [f"{of(part):.1f}" for part in np.array_split(np.asarray(values), PARTS)]


if __name__ == "__main__":
    main()
