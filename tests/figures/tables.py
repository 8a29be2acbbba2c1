"""The tables by name, each from the results that a command left in docs/results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from magcal_service.physics.saying import measured
from magcal_service.studies.report import shown
from tests.benchmarks.results import read
from tests.figures.forms import forms, words
from tests.figures.markdown import table

MOST_SHOWN: Final = 3  # numbers of one parameter in a cell
MOST_UNSURE: Final = 1000.0  # times itself, the sigma of a number from which on it is not known at all
MAIN_METHOD: Final = "ukf"


def _nt(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def _rows(name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read(name)["figures"]["rows"]
    return rows


def recordings_main() -> str:
    """Residual levels and verdicts of every recording by the daemon's own method."""
    head = ["recording", "samples", "before", "after", "held out", "white-noise level", "verdict: reasons", "replay"]
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


def together_shared() -> str:
    """What the days of SUCHAI-3 have in common, each number from all and from every day alone."""
    rows = []
    for row in _rows("together"):
        for one in row["shared"]:
            label = f"{one['effect']} `{one['parameter']}`" + ("" if one["unit"] == "1" else f" [{one['unit']}]")
            own = [_measured(each["own"]) for each in one["recordings"]]
            rows.append([row["photodiodes"], label, _measured(one["together"]), *own, f"{one['probability']:.2g}"])
    head = ["photodiodes", "number", "together", *_days(), "largest difference by chance"]
    return table(head, rows, [len(head) - 1])


def together_predicted() -> str:
    """Each day of SUCHAI-3 predicted from the others: held-out rms and share of its own gain."""
    rows = []
    for row in _rows("together"):
        for one, shadow in zip(row["predicted_from_the_others"], row["shadow_agrees"], strict=True):
            rms, share = one["held_out_rms_nt"], one["share_of_own_gain"]
            kept = "-" if share is None else f"{100.0 * share:.0f} %"
            levels = [_nt(rms[key]) for key in ("recalibrated", "predicted", "own")]
            rows.append([row["photodiodes"], one["name"], *levels, kept, f"{100.0 * shadow:.1f} %"])
    head = [
        "photodiodes",
        "day",
        "nine errors",
        "predicted",
        "its own fit",
        "kept",
        "shadow as the photodiodes have it",
    ]
    return table(head, rows, range(2, 7))


def together_live() -> str:
    """Each day of SUCHAI-3 replayed with the others' physics: what was published, and the best that constants do."""
    rows = []
    for one in _rows("together")[0]["live"]:
        published = [f"{_nt(one[f'{key}_nt'])} ({one[f'vectors_{key}']})" for key in ("without", "with")]
        constants = [_nt(one[f"best_{key}_nt"]) for key in ("without", "with")]
        ratios = [f"{one[key]:.2f}" for key in ("times_better", "best_times_better")]
        effects = ", ".join(one["effects"]) or "none"
        rows.append([one["name"], one["file"], effects, *published, ratios[0], *constants, ratios[1]])
    head = [
        "day",
        "file",
        "effects",
        "published without (vectors)",
        "with",
        "times better",
        "best constants without",
        "with",
        "times better",
    ]
    return table(head, rows, range(3, 9))


def many() -> str:
    """Many recordings diagnosed on a pool and on dask, with workers killed and a run cut."""
    rows = []
    for one in read("many")["figures"]["runs"]:
        counts = [str(one[key]) for key in ("exit_code", "kept", "anew", "killed")]
        rows.append([one["name"], *counts, f"{one['seconds']:.0f}", one["digest"][:8]])
    return table(["run", "exit", "kept", "done", "killed", "time [s]", "digest of all files"], rows, range(1, 6))


def _days() -> list[str]:
    return [one["name"] for one in _rows("together")[0]["predicted_from_the_others"]]


def _measured(one: dict[str, Any]) -> str:
    """Numbers with their sigmas; of many, the largest and their count."""
    values, sigmas = np.ravel(one["value"]), np.ravel(one["sigma"])
    if len(values) <= MOST_SHOWN:
        return ", ".join(_number(float(v), float(s)) for v, s in zip(values, sigmas, strict=True))
    at = int(np.argmax(np.abs(values)))
    return f"{len(values)} numbers, largest {measured(float(values[at]), float(sigmas[at]))}"


def _number(value: float, sigma: float) -> str:
    """A number with its sigma; one that this recording says nothing of, in words."""
    return measured(value, sigma) if sigma < MOST_UNSURE * abs(value) else "not known"


def _study(name: str, title: str) -> tuple[list[str], list[dict[str, Any]]]:
    """Columns and rows of the first table of a study whose title begins so."""
    tables = read(name)["tables"]
    found = next(one for one in tables if one["title"].startswith(title))
    return found["columns"], [dict(zip(found["columns"], row, strict=True)) for row in found["rows"]]


def study_table(name: str, title: str) -> str:
    """A table of a study as its JSON has it; levels [nT] in whole ones, columns of numbers to the right."""
    columns, rows = _study(name, title)
    shown_rows = [[_nt(row[c]) if c.endswith("[nT]") else shown(row[c]) for c in columns] for row in rows]
    numbers = [i for i, c in enumerate(columns) if any(isinstance(row[c], float) for row in rows)]
    return table(columns, shown_rows, numbers)


def _concealed_reliability() -> str:
    """What a claimed probability was worth, over all simulators; bins in which nothing was claimed are left out."""
    columns, rows = _study("concealed", "Reliability")
    claims = [[shown(row[c]) for c in columns[1:]] for row in rows if row["simulator"] == "all" and row["names"]]
    return table(columns[1:], claims, range(1, len(columns) - 1))


def _figures(name: str) -> tuple[dict[str, Any], str]:
    """Figures of a benchmark, and the command that gave them."""
    content = read(name)
    return content["figures"], f"`{content['command']}`"


def _spread(values: Sequence[float], digits: int) -> str:
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _cost_rows() -> list[list[str]]:
    """What the filter and the daemon cost: what, figure, command."""
    tick, tick_command = _figures("filter")
    daemon, daemon_command = _figures("daemon")
    way, way_command = _figures("latency")
    live, live_command = _figures("live-physics")

    def times(name: str) -> str:
        mid, mean = (tick[f"{kind}_us_{name}"] / tick[f"{kind}_us_magcal"] for kind in ("median", "mean"))
        return f"{mid:.1f} times by the median, {mean:.1f} by the mean"

    runs = len(daemon["replay_18000_s"])
    loads = (f"median_us_{count}" for count in (0, 1, 2))
    bare, one, two = (live[key] for key in loads)
    return [
        [
            "a tick of `ukf`, median; mean",
            f"{tick['median_us_magcal']:.0f} us; {tick['mean_us_magcal']:.0f} us",
            tick_command,
        ],
        ["filterpy's UKF on the same three measurements beside it", times("filterpy"), "same"],
        ["filterpy's UKF on equation (3) alone", times("filterpy_scalar"), "same"],
        ["a UKF written plainly in numpy, equation (3) alone", times("numpy_scalar"), "same"],
        [
            f"daemon's memory over a bare process with its imports, at 1 Hz ({runs} runs)",
            f"{_spread(daemon['memory_over_bare_mb_at_1hz'], 0)} MB",
            daemon_command,
        ],
        [
            "the same after 3000 samples at 500 Hz",
            f"{_spread(daemon['memory_over_bare_mb_after_3000_at_500hz'], 0)} MB",
            "same",
        ],
        ["processor at 1 Hz", f"{_spread([100 * share for share in daemon['cpu_share_1hz']], 2)} % of a core", "same"],
        ["replay of 18000 s, process start included", f"{_spread(daemon['replay_18000_s'], 1)} s", "same"],
        [
            "sample in to calibrated vector out over zenoh, p50; p99",
            f"{way['vector_ms_p50']:.1f} ms; {way['vector_ms_p99']:.1f} ms",
            way_command,
        ],
        ["a bare zenoh echo in the same run", f"{way['echo_ms_p50']:.2f} ms; {way['echo_ms_p99']:.1f} ms", "same"],
        [
            "the vector path with 0, 1, 2 effects of `physics.toml` that recorded channels drive",
            f"{bare:.0f}, {one:.0f}, {two:.0f} us: {one / bare:.2f} and {two / bare:.2f} times the bare path",
            live_command,
        ],
    ]


def costs() -> str:
    """The costs with their commands."""
    return table(["what it costs", "figure", "command"], _cost_rows())


def just_below() -> str:
    """The largest size of each hazard that is not seen, and the level beside the error there."""

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    rows = [
        [
            f"`{row['hazard']}`",
            f"{row['motion']}, {row['noise_nt']:.0f}",
            f"{number(row['unseen'])} {row['unit']}".strip() + (", all that is possible" if row["bounded"] else ""),
            *(_nt(row[key]) for key in ("error_nt", "level_nt", "own_nt")),
            *(number(row[key]) for key in ("ratio", "own_ratio", "near_ratio", "near_own_ratio")),
        ]
        for row in _rows("just-below")
    ]
    head = [
        "hazard",
        "motion, noise [nT]",
        "largest unseen",
        "error [nT]",
        "level",
        "for it",
        "level / error",
        "for it",
    ]
    return table([*head, "just below: level / error", "for it"], rows, range(3, 10))


def just_below_over_all() -> str:
    """The medians of the same over all that is limited by detection."""
    figures = read("just-below")["figures"]["over_all"]
    rows = [[name, f"{value:.3g}"] for name, value in figures.items()]
    return table(["median over the flights that detection limits", ""], rows, [1])


def new_step() -> str:
    """The published level beside the error that a step of ``disturbance_nt`` makes until it is seen."""
    rows = [
        [
            f"{row['motion']}, {row['noise_nt']:.0f}",
            str(row["flights"]),
            f"{row['unseen_s']:.0f}",
            f"{row['ratio']:.3g}",
            f"{row['largest_ratio']:.3g}",
            str(row["beyond_s"]),
        ]
        for row in _rows("new-step")
    ]
    head = ["motion, noise [nT]", "flights", "unseen [s]", "level / error", "largest of a flight", "beyond [s]"]
    return table(head, rows, range(1, 6))


TABLES: Final[dict[str, Callable[[], str]]] = {
    "recordings-ukf": recordings_main,
    "recordings-methods": lambda: _side_by_side("after_nt"),
    "recordings-held-out": lambda: _side_by_side("method_held_out_nt"),
    "together-predicted": together_predicted,
    "together-shared": together_shared,
    "together-live": together_live,
    "many": many,
    "reality": lambda: study_table("reality", "What is said of each recording"),
    "concealed": lambda: study_table("concealed", "By simulator and what was asked"),
    "concealed-reliability": _concealed_reliability,
    "just-below": just_below,
    "just-below-over-all": just_below_over_all,
    "new-step": new_step,
    "costs": costs,
    "forms-words": words,
    "forms": forms,
}
