"""SUCHAI-3's days together, with its photodiodes hidden and given, and each replayed with the others' physics.

What comes out is in docs/recordings.md.

python -m tests.benchmarks.bench_together [--data ../shared/data] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.diagnosis.joint.diagnose import Alone, JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.result import as_json, model_of
from magcal_service.diagnosis.joint.words import summary
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from tests.benchmarks.days_live import live, numbers_of_others
from tests.benchmarks.results import write

DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
DAYS = ("2023-08-24", "2023-11-13", "2023-12-11")
WITNESS = "photodiodes"
DARK, TURN = 30.0, 8  # counts in shadow at most; half a turn in samples, for three photodiodes do not see every side


def main() -> None:
    """Print both diagnoses' summaries, and write their numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path, metavar="FILE", help="what docs/recordings.md is written from")
    options = parser.parse_args()
    recordings = [read_recording(options.data / "suchai3" / f"{name}.toml") for name in DAYS]
    rows = []
    for hidden in (True, False):
        began = time.process_time()
        found = together(recordings, hidden=hidden)
        print("\n".join(summary(found, ())), flush=True)
        rows.append({"photodiodes": "hidden" if hidden else "given", **told(found)})
        rows[-1]["cpu_s"] = round(time.process_time() - began)
        rows[-1]["shadow_agrees"] = [
            shadow_agrees(one, day) for one, day in zip(found.recordings, recordings, strict=True)
        ]
        print(rows[-1]["cpu_s"], "s,", rows[-1]["shadow_agrees"], flush=True)
        if hidden:
            rows[-1]["live"] = replayed(recordings, found)
            print(*rows[-1]["live"], sep="\n", flush=True)
        write(options.json, {"rows": rows})


def replayed(recordings: Sequence[Recording], found: JointDiagnosis) -> list[dict[str, Any]]:
    """Each day with the file that the other two give, and with their numbers of what all three have in common."""
    rows = []
    for number, name in enumerate(DAYS):
        others = together([one for k, one in enumerate(recordings) if k != number], hidden=True)
        for file, model in (("of the others", model_of(others)), ("named by all", numbers_of_others(found, number))):
            rows.append({"name": name, "file": file, **live(without(recordings[number]), model)})
    return rows


def together(recordings: Sequence[Recording], *, hidden: bool) -> JointDiagnosis:
    """The days' diagnosis, with or without what the photodiodes saw."""
    gathered = gather([without(one) for one in recordings] if hidden else recordings)
    return diagnose_together(gathered.inspections, gathered.names)


def without(recording: Recording) -> Recording:
    """A recording without its photodiodes."""
    kept = {name: channel for name, channel in recording.channels.items() if name != WITNESS}
    return replace(recording, channels=kept)


def told(found: JointDiagnosis) -> dict[str, Any]:
    """What the page shows of ``diagnosis.json``."""
    content = json.loads(as_json(found))
    keys = ("verdict", "trusted", "reasons", "effects", "shared", "predicted_from_the_others", "unexplained_share")
    return {key: content[key] for key in keys}


def shadow_agrees(one: Alone, recording: Recording) -> float:
    """Share of rows in which the photodiodes are dark where the computed shadow is, and lit where it is not."""
    scene = one.prepared.problem.scene
    assert scene.lit is not None
    rows = np.searchsorted(recording.time_ns, scene.time_ns)
    brightest = recording.channels[WITNESS].values[rows].max(axis=1)
    turn = np.lib.stride_tricks.sliding_window_view(np.pad(brightest, TURN, mode="edge"), 2 * TURN + 1).max(axis=1)
    sure = (scene.lit < 0.01) | (scene.lit > 0.99)
    return round(float(np.mean((turn > DARK)[sure] == (scene.lit > 0.5)[sure])), 4)


if __name__ == "__main__":
    main()
