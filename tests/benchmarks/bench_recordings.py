"""Every recording of a folder through ``replay`` and ``calibrate``: the table of docs/recordings.md.

python -m tests.benchmarks.bench_recordings [--data ../shared/data] [--methods ukf]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.calibrate import calibrate_recording, craft_of, replay
from magcal_service.errors import MagcalError
from magcal_service.recordings.reader import read_recording


def main() -> None:
    """Print one Markdown row per recording and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / ".." / "shared" / "data")
    parser.add_argument("--methods", nargs="+", default=["ukf"])
    options = parser.parse_args()
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


if __name__ == "__main__":
    main()
