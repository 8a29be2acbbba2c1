"""The tables by name, each from the results that a command left in docs/results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from tests.benchmarks.results import read

MAIN_METHOD: Final = "ukf"
_PARTS_SHOWN: Final = 0.005  # effects that explain less of the mismatch are named without a share


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A Markdown table; the columns in ``numbers`` are set to the right."""
    rule = ["---:" if i in numbers else "---" for i in range(len(head))]
    lines = [f"| {' | '.join(head)} |", f"|{'|'.join(rule)}|", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines)


def _nt(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def _rows(name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read(name)["figures"]["rows"]
    return rows


def recordings_main() -> str:
    """Residual levels and verdicts of every recording by the daemon's own method."""
    head = ["recording", "samples", "before", "after", "held out", "noise floor", "verdict: reasons", "replay"]
    rows = []
    for row in (row for row in _rows("recordings") if row["method"] == MAIN_METHOD):
        if "refused" in row:
            rows.append([row["recording"], *[""] * 5, f"refused: {row['refused']}", ""])
            continue
        levels = [_nt(row[key]) for key in ("before_nt", "after_nt", "batch_held_out_nt", "noise_floor_nt")]
        verdict = f"{row['calibrate']}: {', '.join(row['reasons'])}".removesuffix(": ")
        rows.append([row["recording"], str(row["samples"]), *levels, verdict, row["replay"]])
    return table(head, rows, range(1, 6))


def _side_by_side(key: str) -> str:
    every = _rows("recordings")
    names = list(dict.fromkeys(row["method"] for row in every))
    cells = {(row["recording"], row["method"]): _cell(row, key) for row in every}
    recordings = dict.fromkeys(row["recording"] for row in every)
    rows = [[recording, *(cells[recording, name] for name in names)] for recording in recordings]
    return table(["recording", *(f"`{name}`" for name in names)], rows, range(1, len(names) + 1))


def _cell(row: dict[str, Any], key: str) -> str:
    if "refused" in row:
        return "*refused*"
    if key == "after_nt" and row["calibrate"] == "not_started":
        return "-"
    return _nt(row[key])


def diagnoses() -> str:
    """What the diagnosis says of every recording, photodiodes hidden."""
    head = ["recording", "verdict", "effects (driver), share of the mismatch", "simulation", "nine errors", "effects"]
    rows = []
    for row in _rows("diagnoses"):
        if "refused" in row:
            rows.append([row["recording"], f"refused: {row['refused']}", *[""] * 4])
            continue
        verdict = ", ".join([row["verdict"] + (", trusted" if row["trusted"] else ""), *row["reasons"]])
        named = "; ".join(_effect(effect) for effect in row["effects"]) or "-"
        rows.append([row["recording"], verdict, named, *(_nt(value) for value in row["held_out_rms_nt"].values())])
    return table(head, rows, range(3, 6))


def _effect(effect: dict[str, Any]) -> str:
    driver = "" if effect["driver"] == "none" else f" ({effect['driver']})"
    share = f" {100 * effect['share']:.0f} %" if effect["share"] >= _PARTS_SHOWN else ""
    return f"{effect['effect']}{driver}{share}"


TABLES: Final[dict[str, Callable[[], str]]] = {
    "recordings-ukf": recordings_main,
    "recordings-methods": lambda: _side_by_side("after_nt"),
    "recordings-held-out": lambda: _side_by_side("method_held_out_nt"),
    "diagnoses": diagnoses,
}
