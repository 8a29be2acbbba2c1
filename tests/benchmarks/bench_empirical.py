"""How far the held-out residual falls by curves without a name, where the cause is in no catalogue.

python -m tests.benchmarks.bench_empirical [--seeds 3] [--first 900] [--only outside:walk] [--data ../shared/data]

Concealed cases of ``tests.blind``: eight disturbances that no recorded driver holds, and two that follow a recorded
channel; then recordings that others made, a driver hidden, where they are there.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from tests.benchmarks.results import write
from tests.blind import draw_case, write_case
from tests.blind.catalogue import DRIVEN_OUTSIDE, OUTSIDE

DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
REAL = (
    ("aero-vista/recording", ("temperature",)),
    ("suchai3/2023-08-24", ("photodiodes",)),
    ("suchai3/2023-11-13", ("photodiodes",)),
    ("suchai3/2023-12-11", ("photodiodes",)),
    ("suchai3/2023-12-11", ()),
    ("ardupilot/log171-internal", ("current",)),
    ("iss-2017/recording", ()),
)
"""Recordings, and the channels that are hidden."""
FOLLOWED = {"hopkinson": "channel:temperature", "two_paths": "channel:current_battery"}
"""What really drives those that follow a channel."""


def main() -> None:
    """Print a row for each, and a summary of the concealed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="cases of each kind")
    parser.add_argument("--first", type=int, default=900, help="seed of the first")
    parser.add_argument("--only", help="one kind, as outside:walk, or real")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path, metavar="FILE", help="the same as JSON")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("case | verdict | names | noise | recalibrated | before | after [nT] | errors | driver, kind | elsewhere | s")
    for name, recording in (*concealed(options), *real(options)):
        rows.append(row(name, recording))
        print(" | ".join(str(value) for value in rows[-1].values()), flush=True)
        write(options.json, {"rows": rows})
    print("\n".join(summary([one for one in rows if one["case"].startswith("outside:")])))


def concealed(options: argparse.Namespace) -> Iterator[tuple[str, Recording]]:
    """Cases of each kind, their drivers recorded."""
    for kind in (f"outside:{name}" for name in (*DRIVEN_OUTSIDE, *OUTSIDE)):
        if options.only not in (None, kind):
            continue
        for seed in range(options.first, options.first + options.seeds):
            with tempfile.TemporaryDirectory() as folder:
                yield f"{kind} {seed}", read_recording(write_case(draw_case(seed, kind), Path(folder) / "case"))


def real(options: argparse.Namespace) -> Iterator[tuple[str, Recording]]:
    """Recordings that are there, with what is hidden taken away."""
    for name, hidden in REAL if options.only in (None, "real") else ():
        path = options.data / f"{name}.toml"
        if path.exists():
            recording = read_recording(path)
            kept = {key: channel for key, channel in recording.channels.items() if key not in hidden}
            yield f"{name}{f' without {hidden[0]}' if hidden else ''}", replace(recording, channels=kept)


def row(name: str, recording: Recording) -> dict[str, Any]:
    """What came of one."""
    began = time.process_time()
    found = diagnose(recording)
    curves = found.modelled
    before_nt, after_nt = (found.fit.held_out_rms_nt,) * 2 if curves is None else curves.held_out_rms_nt
    return {
        "case": name,
        "verdict": str(found.verdict),
        "names": ", ".join(term.hypothesis.effect for term in found.fit.terms) or "-",
        "noise_nt": round(found.prepared.problem.noise_nt, 1),
        "recalibrated_nt": round(found.prepared.baseline.held_out_rms_nt, 1),
        "before_nt": round(before_nt, 1),
        "after_nt": round(after_nt, 1),
        "standard_errors": None if curves is None else round(curves.standard_errors, 1),
        "curves": "-" if curves is None else ", ".join(f"{one.driver} {one.kind}" for one in curves.curves),
        "elsewhere": curves is not None and curves.is_usable,
        "seconds": round(time.process_time() - began, 1),
    }


def summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    """By kind: how many were modelled, and the share of the excess over noise that is gone, all cases together."""
    for kind in dict.fromkeys(one["case"].partition(" ")[0] for one in rows):
        own = [one for one in rows if one["case"].startswith(f"{kind} ")]
        unknown = [one for one in own if one["verdict"] == "unknown"]
        usable = [one for one in own if one["elsewhere"]]
        wanted = FOLLOWED.get(kind.partition(":")[2])
        right = sum(wanted is not None and wanted in one["curves"] for one in usable)
        excess, gone = (
            sum(one["before_nt"] ** 2 - one[key] ** 2 for one in own if one["curves"] != "-")
            for key in ("noise_nt", "after_nt")
        )
        share = f"{100.0 * gone / excess:.0f} % of their excess gone" if excess > 0.0 else "none modelled"
        yield (
            f"{kind}: {len(unknown)} of {len(own)} unknown, {len(usable)} with a curve for elsewhere"
            f"{f' ({right} over what drives it)' if wanted else ''}, "
            f"{sum(one['curves'] != '-' for one in own) - len(usable)} over elapsed time; {share}"
        )


if __name__ == "__main__":
    main()
