"""Every recording of a folder through ``replay`` and ``calibrate``: the tables of docs/recordings.md.

python -m tests.benchmarks.bench_recordings [--data ../shared/data] [--methods ukf] [--held-out]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from magcal_service.errors import MagcalError
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Phase
from magcal_service.model import scalar_residual
from magcal_service.offline.calibrate import calibrate_recording, refuse_without_channel
from magcal_service.offline.replay import craft_of, replay
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import rms

BLOCKS = 10


def main() -> None:
    """Print one Markdown row per recording and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / ".." / "shared" / "data")
    parser.add_argument("--methods", nargs="+", default=["ukf"])
    parser.add_argument("--held-out", action="store_true", help="methods side by side on blocks they have not seen")
    options = parser.parse_args()
    if options.held_out:
        side_by_side(options.data, options.methods)
        return
    print("| recording | method | samples | before | after | held out | noise floor | verdict: reasons | replay |")
    print("|---|---|---:|---:|---:|---:|---:|---|---|")
    for path in sorted(options.data.glob("*/*.toml")):
        for method in options.methods:
            print(row(path, f"{path.parent.name}/{path.stem}", method), flush=True)


def row(path: Path, name: str, method: str) -> str:
    """One recording by one method."""
    try:
        recording = read_recording(path)
        result = calibrate_recording(recording, method)
        verdict = replay(recording, craft_of(recording, method)).pipeline.trust.verdict
    except MagcalError as error:
        return f"| {name} | {method} | | | | | | refused: {str(error).splitlines()[0]} | |"
    levels = result.residuals
    held_out = "-" if levels.held_out is None else f"{levels.held_out:.0f}"
    reasons = ", ".join(result.reasons)
    return (
        f"| {name} | {method} | {result.samples} | {levels.before:.0f} | {levels.after:.0f} | {held_out} "
        f"| {levels.noise_floor:.0f} | {result.verdict}: {reasons} | {verdict} |"
    )


def side_by_side(data: Path, methods: list[str]) -> None:
    """Print the held-out residual of every method, one row per recording."""
    print("| recording | " + " | ".join(f"`{method}`" for method in methods) + " |")
    print("|---|" + "---:|" * len(methods))
    for path in sorted(data.glob("*/*.toml")):
        cells = [held_out(path, method) for method in methods]
        print(f"| {path.parent.name}/{path.stem} | " + " | ".join(cells) + " |", flush=True)


def held_out(path: Path, method: str) -> str:
    """rms [nT] on every second of ten blocks after the method has seen the others; a dash where it did not start."""
    try:
        recording = read_recording(path).sorted_unique()
        refuse_without_channel(recording, find_method(method))
        block = np.arange(len(recording)) * BLOCKS // len(recording)
        seen = replay(recording.select(block % 2 == 0), craft_of(recording, method)).pipeline.estimator.estimate()
    except MagcalError:
        return "*refused*"
    if seen.phase is Phase.STARTING and not seen.restarts:
        return "-"
    unseen: Recording = recording.select(block % 2 == 1)
    return f"{rms(scalar_residual(seen.x, unseen.field_body_nt, unseen.reference.magnitude_nt)):.0f}"


if __name__ == "__main__":
    main()
