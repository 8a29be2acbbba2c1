"""Are the sigmas of short logs, turned by hand, honest?  ``python -m tests.offline.short_log_figures --runs 200``."""

import argparse
from collections import Counter

import numpy as np

import magcal_service as magcal
from magcal_service.offline.calibrate import calibrate
from tests.offline.hand_turned import hand_turned, random_errors

CASES = {
    "60 s, 10 Hz, 100 nT, stated": ({}, True),
    "the same, noise not stated": ({}, False),
    "30 s, 10 Hz, 100 nT, not stated": ({"seconds": 30.0}, False),
    "60 s, 50 Hz, 100 nT, not stated": ({"rate_hz": 50.0}, False),
    "60 s, 25 Hz, 300 nT, stated": ({"rate_hz": 25.0, "noise_nt": 300.0}, True),
    "60 s, 10 Hz, 100 nT, 60 nT of iron": ({"iron_nt": 60.0}, False),
    "60 s, 10 Hz, 100 nT, 400 nT of iron": ({"iron_nt": 400.0}, False),
    "60 s, 10 Hz, turned about one axis": ({"around_z_only": 1.0}, False),
}
"""What is flown, and whether its noise is stated."""


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--only", default="", help="cases whose names hold this")
    options = parser.parse_args()
    for name, (log, stated) in CASES.items():
        if options.only not in name:
            continue
        print(row(name, log, options.runs, stated=stated), flush=True)


def row(name: str, log: dict[str, float], runs: int, *, stated: bool) -> str:
    """A row of the table: of the runs that were neither doubted nor without a start, how the errors lie in sigmas."""
    verdicts, errors, sigmas, nees = Counter[str](), [], [], []
    for seed in range(runs):
        truth = random_errors(seed)
        time_s, field_nt, magnitude_nt = hand_turned(seed, truth=truth, **log)
        noise_nt = log.get("noise_nt", 100.0) if stated else None
        result = calibrate(magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=noise_nt))
        verdicts[f"{result.verdict}: {result.reasons[0]}"] += 1
        if result.verdict == "converging":
            error = result.x - truth
            nees.append(error @ np.linalg.solve(result.covariance, error))
            errors.append(np.abs(error) / np.sqrt(np.diagonal(result.covariance)))
            sigmas.append(result.sigma_bias_nt.max())
    told = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())
    if not errors:
        return f"| {name} | {told} | - | - | - |"
    beyond = 100.0 * np.mean(np.array(errors) > 3.0)
    return f"| {name} | {told} | {np.mean(nees):.2f} | {beyond:.2f} % | {np.median(sigmas):.0f} |"


if __name__ == "__main__":
    main()
