"""What one flight comes to: seconds trusted and wrong, misled, and how long it took to trust and to warn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.model import Array
from magcal_service.studies.unseen.flight import Heard, begin, hear
from magcal_service.studies.unseen.motion import Motion
from magcal_service.studies.unseen.scenarios import SCENARIOS

WRONG_NT, WRONG_SIGMA = 50.0, 5.0
"""Error of a vector from which on it is wrong [nT], and in its own sigma: both have to be exceeded."""

COVERED_SIGMA: Final = 4.0
"""Sigmas of the estimate that come on top of the protection: one in 16 000 is beyond by noise alone."""

LONGEST_STEP_S: Final = 5.0
"""What a vector counts for at the most [s], until the next one."""

EDGES_NT: Final = np.concatenate([[0.0], np.geomspace(1.0, 1e5, 26)])
"""Edges of the diagram's classes [nT], of errors and of protection: five a decade."""

BEFORE_ALARM_S: Final = 600.0
"""How long before an alarm a hazard counts as just below detection [s]."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Which flight: the scenario, how the craft turns, its noise [nT], its length [s], and the numbers of its seed."""

    scenario: str
    motion: str
    noise_nt: float
    duration_s: int
    seed: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Fared:
    """How the daemon fared on one flight.

    Parameters
    ----------
    heard_s, trusted_s: time with vectors, and trusted [s].
    wrong_s: trusted, and the error beyond ``WRONG_NT`` and ``WRONG_SIGMA``.
    unprotected_s: trusted without a protection level.
    misled_s: trusted, and the error beyond protection and ``COVERED_SIGMA``; of what has a protection level.
    worst_nt: largest error while trusted, worst_beyond_nt: by how much it was beyond protection and sigma, at the most.
    trusted_at_s: first trusted; NaN where never.  ``bound_nt``: 3 sigma of the worst bias axis after 1.5 orbits.
    alarm_s: from the hazard's beginning to the first doubt; NaN where none came.
    near_ratio: protection over the error just before the alarm, by the median; NaN where nothing is known.
    diagram: trusted seconds by class of error (rows) and of protection (columns), both of ``EDGES_NT``.
    reasons: of doubts, most frequent first.
    """

    heard_s: float
    trusted_s: float
    wrong_s: float
    unprotected_s: float
    misled_s: float
    worst_nt: float
    worst_beyond_nt: float
    trusted_at_s: float
    bound_nt: float
    alarm_s: float
    near_ratio: float
    diagram: list[list[float]]
    reasons: list[str]


ORBIT_AND_HALF_S: Final = 8610.0
"""One and a half orbits [s]."""


def fly(asked: Asked) -> Fared:
    """One flight, from its seed to its score."""
    scenario = SCENARIOS[asked.scenario]
    sent = begin(Motion(asked.motion), asked.noise_nt, asked.duration_s, np.random.SeedSequence(asked.seed))
    scenario.spoil(sent)
    return scored(hear(sent), scenario.since * asked.duration_s if scenario.since < 1.0 else math.inf)


def scored(heard: Heard, since_s: float) -> Fared:
    """The score of what was heard; the hazard begins at ``since_s``, inf where there is none."""
    time_s = heard.time_s
    lasts = np.minimum(np.diff(time_s, append=time_s[-1:] + 1.0), LONGEST_STEP_S)
    error, protection = np.nan_to_num(heard.error_nt), heard.protection_nt
    trusted, has = heard.trusted, np.isfinite(heard.protection_nt)
    wrong = trusted & (error > WRONG_NT) & (error > WRONG_SIGMA * heard.sigma_nt)
    beyond = error - protection - COVERED_SIGMA * heard.sigma_nt
    misled = trusted & has & (beyond > 0.0)
    late = np.flatnonzero(time_s >= ORBIT_AND_HALF_S)
    alarm = _alarm(heard, since_s)
    return Fared(
        heard_s=float(lasts.sum()),
        trusted_s=float(lasts[trusted].sum()),
        wrong_s=float(lasts[wrong].sum()),
        unprotected_s=float(lasts[trusted & ~has].sum()),
        misled_s=float(lasts[misled].sum()),
        worst_nt=float(error[trusted].max(initial=0.0)),
        worst_beyond_nt=float(beyond[trusted & has].max(initial=-math.inf)),
        trusted_at_s=float(time_s[trusted][0]) if trusted.any() else math.nan,
        bound_nt=3.0 * float(heard.bias_sigma_nt[late[0]]) if len(late) else math.nan,
        alarm_s=alarm - since_s if math.isfinite(alarm) else math.nan,
        near_ratio=_near(heard, alarm),
        diagram=_diagram(error, protection, lasts, trusted & has),
        reasons=sorted(heard.reasons, key=lambda name: -heard.reasons[name]),
    )


def _alarm(heard: Heard, since_s: float) -> float:
    """Time of the first doubt from ``since_s`` on [s]; NaN where none came."""
    if math.isinf(since_s):
        return math.nan
    later = heard.doubt_s[heard.doubt_s >= since_s]
    return float(later.min()) if len(later) else math.nan


def _near(heard: Heard, alarm_s: float) -> float:
    """Median of protection over error in the last minutes before an alarm, while trusted."""
    if not math.isfinite(alarm_s):
        return math.nan
    rows = heard.trusted & np.isfinite(heard.protection_nt) & (heard.error_nt > 0.0)
    rows &= (heard.time_s < alarm_s) & (heard.time_s >= alarm_s - BEFORE_ALARM_S)
    return float(np.median(heard.protection_nt[rows] / heard.error_nt[rows])) if rows.any() else math.nan


def _diagram(error: Array, protection: Array, lasts: Array, rows: Any) -> list[list[float]]:
    counted, _, _ = np.histogram2d(error[rows], protection[rows], [EDGES_NT, EDGES_NT], weights=lasts[rows])
    return [[float(value) for value in row] for row in counted.tolist()]
