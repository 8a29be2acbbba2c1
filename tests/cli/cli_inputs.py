"""The command line in this process, and the files it is given."""

from __future__ import annotations

import contextlib
import io
import math
from dataclasses import dataclass

from magcal_service.cli.__main__ import main
from tests.recordings.recording_logs import described

CONFIG = """version = 1
link = "loop:cli"
[[craft]]
name = "paper"
[craft.sensor]
noise_nt = 300.0
stuck_samples = 10
[craft.spin]
axis = "z"
rate_rpm = 7.5
window = "harmonic"
window_turns = 2
[craft.filter]
method = "ukf"
start_s = 60.0
process_noise_bias_nt = [0.0, 0.0, 0.0]
[craft.ticks]
hold_s = 3.0
late_s = 30.0
[craft.trust]
min_ticks = 300
[output]
csv = "rows.csv"
status_period_s = 5.0
"""

DESCRIPTOR = described(
    "log.csv",
    time='format = "elapsed_s"\nstart = "2025-06-01T00:00:00Z"',
    field=("mx", "my", "mz"),
    noise_nt=300.0,
    reference=("hx", "hy", "hz"),
    channels={"temperature": "temp"},
    spin_axis=(0.0, 0.0, 1.0),
)


@dataclass(frozen=True)
class Done:
    """What a command ended with and said."""

    code: int
    out: str
    err: str


def run(*arguments: object) -> Done:
    """Run ``magcal`` with these arguments; argparse's own exit is an exit code like any other."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else -1
    return Done(code, out.getvalue(), err.getvalue())


def log_rows(seconds: int) -> str:
    """A log that the descriptor describes: a turning field that any method can start on."""
    lines = ["t,mx,my,mz,hx,hy,hz,temp"]
    for second in range(seconds):
        phase, tilt = 0.785 * second, 0.005 * second
        field = (
            30_000.0 * math.cos(phase) * math.cos(tilt),
            -30_000.0 * math.sin(phase) * math.cos(tilt),
            30_000.0 * math.sin(tilt),
        )
        reference = (30_000.0 * math.cos(tilt), 1000.0 * math.sin(7.0 * tilt), 30_000.0 * math.sin(tilt))
        lines.append(",".join(repr(value) for value in (float(second), *field, *reference, 20.0)))
    return "\n".join(lines) + "\n"
