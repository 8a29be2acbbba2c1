"""A few of the faults, quickly, on real processes; ``python -m tests.faults`` tries them all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.faults import Fault, Outcome, table
from tests.faults.runs import RUNS

ROOT = Path(__file__).resolve().parents[2]
QUICK = (Fault.KILL_DAEMON, Fault.CORRUPT_FRAMES, Fault.WRAP)


@pytest.mark.parametrize("fault", QUICK, ids=lambda fault: fault.label)
def test_a_fault_costs_what_is_promised_and_no_more(fault: Fault, tmp_path: Path) -> None:
    """The books balance: what is lost is what was in flight by design, and every promise of the run is kept."""
    outcome = RUNS[fault](tmp_path, True)
    assert outcome.broken == []
    assert outcome.fed > 100
    assert outcome.lost == outcome.in_flight


def test_two_hours_of_ticks_leave_memory_files_and_threads_as_they_were() -> None:
    """The soak, shortly: less than 1 MB more after the first hour's worth, and not one file or thread."""
    command = [sys.executable, "-m", "tests.faults.soak", "--days", "0.083"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 files, 0 threads" in done.stdout


def test_every_fault_has_its_run() -> None:
    """No fault is only a name."""
    assert set(RUNS) == set(Fault)
    assert len({fault.value for fault in Fault}) == len(Fault)


def test_a_lost_sample_is_a_broken_promise() -> None:
    """Books that do not balance are told by number, and in the table."""
    outcome = Outcome(Fault.WRAP, "zenoh", fed=100, accepted=95, refused=2, in_flight=2)
    outcome.balance()
    assert outcome.broken == ["3 samples are lost, 2 by design"]
    assert "| wrap | zenoh | 100 | 95 | 2 | 3 | 2 | - | NO |" in table([outcome])
