"""Fuzz every reader of bytes from outside.

    python -m tests.fuzz --inputs 1000000 --seed 1
    python -m tests.fuzz --target session --inputs 10000

Prints totals for each target and every crash; exit code 1 where there is one.  Inputs that crash are written to --keep.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import sys
from pathlib import Path

from tests.fuzz.engine import Totals, fuzz
from tests.fuzz.targets import CORPUS, TARGETS


def main() -> int:
    """Run, print, keep."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="in all, over the targets by their share")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--target", action="append", choices=[target.name for target in TARGETS], help="only this one")
    parser.add_argument(
        "--grow", type=int, default=0, help="add so many new inputs a target to the corpus, shortest first"
    )
    parser.add_argument("--keep", type=Path, default=Path("output/fuzz"), help="where inputs that crash are written")
    options = parser.parse_args()
    targets = [target for target in TARGETS if not options.target or target.name in options.target]
    shares = sum(target.share for target in targets)
    print("| target | inputs | accepted | refused | places | slowest ms | inputs/s | crashes |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    results = []
    for target in targets:
        totals = fuzz(target, -int(-options.inputs * target.share // shares), options.seed)
        results.append(totals)
        for data in sorted(totals.found, key=len)[: options.grow]:
            _write(data, CORPUS / target.name)
        print(_row(totals), flush=True)
    inputs, crashes = sum(one.inputs for one in results), [crash for one in results for crash in one.crashes]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    print(f"\n{inputs} inputs, seed {options.seed}, {len(crashes)} crashes, peak memory {peak:.0f} MB")
    for crash in crashes:
        print(f"\n{crash.target}: {_write(crash.data, options.keep / crash.target)}\n{crash.told}")
    return 1 if crashes else 0


def _row(totals: Totals) -> str:
    speed = totals.inputs / max(totals.seconds, 1e-9)
    return (
        f"| {totals.target} | {totals.inputs} | {totals.accepted} | {totals.refused} | {len(totals.places)} "
        f"| {totals.slowest_s * 1e3:.0f} | {speed:.0f} | {len(totals.crashes)} |"
    )


def _write(data: bytes, folder: Path) -> Path:
    path = folder / hashlib.sha256(data).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


if __name__ == "__main__":
    sys.exit(main())
