"""The faults, what is expected of each, and what came of it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from enum import Enum


class Fault(Enum):
    """What is done to the daemon; the text says what it promises then."""

    KILL_DAEMON = (
        "no sample is lost: the node keeps what is unanswered, the next daemon asks for it and goes on from its state"
    )
    KILL_OFTEN = (
        "no sample is lost where each daemon is killed before its period is over: checkpoints come soon after a start"
    )
    STOP_DAEMON = "no sample is lost: the node keeps what was sent meanwhile"
    STOP_NODE = "no sample is lost: the node goes on where it stood"
    CUT_NETWORK = "no sample is lost: both ends find each other again, and what was sent meanwhile is asked for"
    CUT_SERIAL = "what was sent while the cable was out is lost and counted, nothing else"
    RESTART_ROUTER = "no sample is lost: both ends find the new router, and what was sent meanwhile is asked for"
    CORRUPT_FRAMES = "each damaged frame costs itself, is counted, and gives no wrong message"
    CORRUPT_PAYLOADS = "each payload that is no message is counted and costs nothing else"
    FLOOD = "10 kHz from one source harm itself alone: another craft at 1 Hz has all its estimates, each within 100 ms"
    SLOW_CONSUMER = "a viewer that hangs is given up; the node loses nothing"
    DISK_FULL = "rows and recording stop and say so, calibration goes on; with room again the recording goes on"
    CLOCK_STEP_AHEAD = (
        "a step of the node's clock is believed when the samples after it agree; one of the daemon's own is nothing"
    )
    CLOCK_STEP_BACK = "the same, backwards"
    WRAP = "sequence numbers wrap from 2^32-1 to 0 and cost nothing; a time that wraps is a step back"
    HALF_CHECKPOINT = (
        "a state that was half written, or altered, is not believed; the one before it is, or a new start is made"
    )
    HALF_RECORDING = "a recording that was half written is made sound at the next start, with all that was flushed"
    GARBAGE = "noise between frames costs nothing, noise within one costs that one"
    EXPIRED_CERTIFICATE = "who shows it stays out and is counted; those inside notice nothing"
    ROGUE = "who has no certificate, or not the permission, stays out and is counted; those inside notice nothing"

    @property
    def label(self) -> str:
        """Its name on the command line and in the table."""
        return self.name.lower()


@dataclass
class Outcome:
    """The books of one run.

    Parameters
    ----------
    fault: what was done.
    link: over what.
    fed: samples that the node sent.
    accepted: samples that the daemon accepted, each once.
    in_flight: samples that are lost by design, such as those sent on a cable that is out.
    refused: samples that the daemon refused, with a reason that it counts.
    recovered_s: time from the end of the fault to the next calibrated vector [s]; the longest where there were several.
    notes: what else was measured.
    broken: promises that were not kept.
    """

    fault: Fault
    link: str
    fed: int = 0
    accepted: int = 0
    in_flight: int = 0
    refused: int = 0
    recovered_s: float | None = None
    notes: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)

    @property
    def lost(self) -> int:
        """Samples that nobody accounts for as accepted or refused."""
        return self.fed - self.accepted - self.refused

    def expect(self, kept: bool, promise: str) -> None:
        """Note a promise that was not kept."""
        if not kept:
            self.broken.append(promise)

    def balance(self) -> None:
        """The promise of all: what is lost is what was in flight by design."""
        self.expect(self.lost == self.in_flight, f"{self.lost} samples are lost, {self.in_flight} by design")

    def used(self, counters: dict[str, int]) -> None:
        """The promise that nothing accepted is lost: every sample that was accepted had its reference and its tick."""
        without = counters.get("no_reference", 0)
        self.expect(without == 0, f"{without} accepted samples came to nothing for want of a reference")

    def row(self) -> list[str]:
        """Its line of the table."""
        recovered = "-" if self.recovered_s is None else f"{self.recovered_s:.2f} s"
        numbers = [self.fed, self.accepted, self.refused, self.lost, self.in_flight]
        return [self.fault.label, self.link, *map(str, numbers), recovered, "yes" if not self.broken else "NO"]

    def as_json(self) -> dict[str, object]:
        """Everything, for a file."""
        return {
            "fault": self.fault.label,
            "link": self.link,
            "expected": self.fault.value,
            "fed": self.fed,
            "accepted": self.accepted,
            "refused": self.refused,
            "lost": self.lost,
            "in_flight_by_design": self.in_flight,
            "recovered_s": self.recovered_s,
            "notes": self.notes,
            "broken": self.broken,
        }


HEAD = ("fault", "link", "fed", "accepted", "refused", "lost", "of these by design", "recovered in", "as promised")


def table(outcomes: list[Outcome]) -> str:
    """All runs as a Markdown table, with what was measured besides below it."""
    rows = [list(HEAD), ["---"] * len(HEAD), *(outcome.row() for outcome in outcomes)]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    for outcome in outcomes:
        for note in outcome.notes:
            lines += ["", f"- {outcome.fault.label} ({outcome.link}): {note}"]
        for promise in outcome.broken:
            lines += ["", f"- {outcome.fault.label} ({outcome.link}) **broken**: {promise}"]
    return "\n".join(lines) + "\n"


def as_json(outcomes: list[Outcome]) -> str:
    """All runs for a file."""
    return json.dumps([outcome.as_json() for outcome in outcomes], indent=1) + "\n"
