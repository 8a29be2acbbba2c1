"""The same targets under atheris (libFuzzer): inputs that reach new code are kept and changed further.

    python -m tests.fuzz.guided --inputs 100000 --seed 1

Needs the package ``atheris`` (extra ``fuzz``).  Each target runs in a process of its own, with the operations of
``mutate`` beside libFuzzer's; ``runs`` are inputs, ``cov`` the branches reached.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from random import Random

from tests.fuzz.limits import HANG_S, LONGEST, MOST_MB
from tests.fuzz.mutate import mutate

_STATE = re.compile(r"#(\d+)\s+(?:DONE|pulse|NEW|INITED|REDUCE)\s+cov: (\d+)")


def fuzz_one(name: str, inputs: int, seed: int, corpus: Path) -> None:
    """Run one target until so many inputs or a crash; libFuzzer ends the process itself."""
    import atheris

    with atheris.instrument_imports(include=["magcal_service", "sim_sensor", "mcap"]):
        from tests.fuzz.targets import TARGETS
    target = next(target for target in TARGETS if target.name == name)
    for number, data in enumerate([*target.seeds(), *target.corpus()]):
        (corpus / f"seed-{number}").write_bytes(data)

    def one(data: bytes) -> None:
        try:
            target.run(data)
        except target.refuses:
            return

    def change(data: bytes, longest: int, seed: int) -> bytes:
        if seed % 2:
            return bytes(atheris.Mutate(data, longest))
        return mutate(Random(seed), [data], target.tokens, target.own)[:longest]

    options = [f"-runs={inputs}", f"-seed={seed}", f"-max_len={LONGEST}", f"-timeout={HANG_S:.0f}"]
    options += [f"-rss_limit_mb={MOST_MB + 512}", f"-artifact_prefix={corpus}/crash-", str(corpus)]
    atheris.Setup([sys.argv[0], *options], one, custom_mutator=change)
    atheris.Fuzz()


def main() -> int:
    """All targets, one after the other; exit code 1 where one crashed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.guided", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="in all, over the targets by their share")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    parser.add_argument("--corpus", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        fuzz_one(options.only, options.inputs, options.seed, options.corpus)
    from tests.fuzz.targets import TARGETS  # not before: what is imported already is not instrumented

    shares, crashes, total = sum(target.share for target in TARGETS), 0, 0
    print("| target | runs | cov | crashes |\n|---|---:|---:|---:|")
    for target in TARGETS:
        inputs = -int(-options.inputs * target.share // shares)
        with tempfile.TemporaryDirectory() as corpus:
            command = [sys.executable, "-m", "tests.fuzz.guided", "--only", target.name, "--inputs", str(inputs)]
            done = subprocess.run(
                [*command, "--seed", str(options.seed), "--corpus", corpus], capture_output=True, text=True
            )
        runs, coverage = max((tuple(map(int, found)) for found in _STATE.findall(done.stderr)), default=(0, 0))
        crashed = done.returncode != 0
        crashes, total = crashes + crashed, total + runs
        print(f"| {target.name} | {runs} | {coverage} | {int(crashed)} |", flush=True)
        if crashed:
            print(done.stdout[-3000:] + done.stderr[-3000:])
    print(f"\n{total} inputs, seed {options.seed}, {crashes} crashes")
    return 1 if crashes else 0


if __name__ == "__main__":
    sys.exit(main())
