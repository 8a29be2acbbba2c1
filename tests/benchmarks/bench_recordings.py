"""Every recording of a folder by every method: as recorded, calibrated, and on blocks that took no part.

    python -m tests.benchmarks.bench_recordings [--data ../shared/data] [--methods ukf spin ...] [--json FILE]

``make docs-figures`` writes the tables of docs/recordings.md from what ``--json docs/results/recordings.json`` left.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.estimators import find_method, methods
from magcal_service.estimators.interface import Phase
from magcal_service.model import scalar_residual
from magcal_service.offline.calibrate import calibrate, refuse_without_channel
from magcal_service.offline.replay import craft_of, replay
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import rms
from tests.benchmarks.results import write

DATA: Final = Path(__file__).parents[2] / ".." / "shared" / "data"
BLOCKS: Final = 10  # contiguous; a method sees every second one

Row = dict[str, Any]


def main() -> None:
    """Print one line for each recording and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--methods", nargs="+", default=[method.name for method in methods()])
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    for path in sorted(options.data.glob("*/*.toml")):
        for method in options.methods:
            rows.append(measured(path, method))
            print(rows[-1], flush=True)
    write(options.json, {"rows": rows})


def measured(path: Path, method: str) -> Row:
    """One recording by one method; numbers that are no number are None."""
    row: Row = {"recording": f"{path.parent.name}/{path.stem}", "method": method}
    try:
        recording = read_recording(path)
        result = calibrate(recording, method)
        verdict = replay(recording, craft_of(recording, method)).pipeline.trust.verdict
    except MagcalError as error:
        return {**row, "refused": str(error).splitlines()[0]}
    levels = result.residuals
    return row | {
        "samples": result.samples,
        "before_nt": _finite(levels.before),
        "after_nt": _finite(levels.after),
        "batch_held_out_nt": _finite(levels.held_out),
        "noise_floor_nt": _finite(levels.noise_floor),
        "calibrate": str(result.verdict),
        "reasons": [str(reason) for reason in result.reasons],
        "replay": str(verdict),
        "method_held_out_nt": _finite(held_out(recording, method)),
    }


def held_out(recording: Recording, method: str) -> float | None:
    """rms [nT] on every second of ten blocks after the method has seen the others; None where it did not start."""
    recording = recording.sorted_unique()
    refuse_without_channel(recording, find_method(method))
    block = np.arange(len(recording)) * BLOCKS // len(recording)
    seen = replay(recording.select(block % 2 == 0), craft_of(recording, method)).pipeline.estimator.estimate()
    if seen.phase is Phase.STARTING and not seen.restarts:
        return None
    unseen = recording.select(block % 2 == 1)
    return rms(scalar_residual(seen.x, unseen.field_body_nt, unseen.reference.magnitude_nt))


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


if __name__ == "__main__":
    main()
