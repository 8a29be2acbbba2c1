"""How large the residual of a joint diagnosis is before and after the effects: of each recording, and of all rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from magcal_service.diagnosis.joint.diagnose import JointDiagnosis
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.model import BIAS, Array


@dataclass(frozen=True, slots=True)
class Levels:
    """rms of residuals [nT].

    Parameters
    ----------
    noise_nt: of the sensor.
    held_out_nt: with nine errors of each recording alone, and with the effects of the joint fit; on blocks that took no
        part in the fit.
    in_sample_nt: the same on the rows that were fitted.
    """

    noise_nt: float
    held_out_nt: tuple[float, float]
    in_sample_nt: tuple[float, float]

    def to_dict(self) -> dict[str, Any]:
        """As ``fit`` of a ``diagnosis.json`` has them."""
        return {
            "noise_floor_nt": self.noise_nt,
            "held_out_rms_nt": _named(self.held_out_nt),
            "in_sample_rms_nt": _named(self.in_sample_nt),
        }


def levels_of_each(diagnosis: JointDiagnosis) -> list[Levels]:
    """The levels of each recording, in their order."""
    problem = diagnosis.fit.problem
    assert isinstance(problem, JointProblem)
    found = []
    for one, rows in zip(diagnosis.recordings, problem.slices, strict=True):
        held_out = (one.baseline.held_out_residual, diagnosis.fit.held_out_residual[rows])
        in_sample = (one.baseline.residual, one.fit.residual)
        found.append(Levels(one.noise_nt, _pair(*held_out), _pair(*in_sample)))
    return found


def levels_of_all(diagnosis: JointDiagnosis) -> Levels:
    """The levels over the rows of all recordings."""
    each = levels_of_each(diagnosis)
    rows = np.array([len(one.fit.residual) for one in diagnosis.recordings], dtype=np.float64)

    def together(values: list[float]) -> float:
        return float(np.sqrt(np.average(np.square(values), weights=rows)))

    return Levels(
        together([one.noise_nt for one in each]),
        (together([one.held_out_nt[0] for one in each]), together([one.held_out_nt[1] for one in each])),
        (together([one.in_sample_nt[0] for one in each]), together([one.in_sample_nt[1] for one in each])),
    )


def bias_moved_nt(diagnosis: JointDiagnosis) -> list[float]:
    """How far the effects had pulled the bias of each recording's static calibration [nT]."""
    return [float(np.linalg.norm((one.fit.x - one.baseline.x)[BIAS])) for one in diagnosis.recordings]


def _pair(before: Array, after: Array) -> tuple[float, float]:
    return float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2)))


def _named(pair: tuple[float, float]) -> dict[str, float]:
    return dict(zip(("recalibrated", "with_effects"), pair, strict=True))
