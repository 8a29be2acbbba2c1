"""The sensor responds late: a low-pass, an averaging driver, eddy currents in the structure around it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis, Values, value_of
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.smooth import smooth_course

_AVERAGING: Final = "average of samples"
"""The form of a driver that averages: it needs samples that follow one another, and no gyro."""

_MOST_MEMORY: Final = 90.0
"""(1 - a) / a^2 at most: a = 0.1, a tenth of every new sample; slower averages are no way to read a magnetometer."""

_NEXT: Final = 1.5
"""Sample periods up to which a sample follows the one before; a longer time has others between that are not there."""

_FEWEST: Final = 64
"""Samples from which on a stretch has a course whose steps are told from noise."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if scene.rate_body is not None:
        slope = scene.field_slope
        along = np.einsum("ni,ni->n", slope, scene.unit)
        columns = _lost(scene, np.maximum(np.einsum("ni,ni->n", slope, slope) - along**2, 0.0))
        yield Hypothesis("response_lag", "none", lambda _: columns, (Block("tau2_s2", "s2", ()),))
        return
    period_s = scene.constant("period_s", scene.period_s)
    step2 = _steps2(scene, period_s)
    if step2 is None:
        return
    averaged = _lost(scene, step2)
    memory = Block("memory", "1", (), most=_MOST_MEMORY, least=0.0)
    yield Hypothesis(
        "response_lag", "none", lambda _: averaged, (memory,), _AVERAGING, constants={"period_s": period_s}
    )


def _lost(scene: Scene, turned2: Array) -> Columns:
    """What is lost along the field by a lag of one while the field turns by what squares to (n,)."""
    loss = -(0.5 * turned2 / np.linalg.norm(scene.calibrated_nt, axis=1))[:, None] * scene.unit
    return Columns(body=loss[None])


def _steps2(scene: Scene, period_s: float) -> Array | None:
    """Square (n,) [nT^2] of the step from each sample's predecessor; after a gap, of the next step.

    How fast the field turns changes slowly against its noise, which is smoothed away; what the noise adds in the mean
    is a constant, which the nine errors take up.  None where the samples do not follow one another.
    """
    follows = np.concatenate([[False], np.diff(scene.time_s) < _NEXT * period_s])
    begins = np.flatnonzero(~follows)
    if not scene.is_given and (len(scene) < _FEWEST or len(begins) * _FEWEST > len(scene)):
        return None
    found: Array = (np.diff(scene.calibrated_nt, axis=0, prepend=scene.calibrated_nt[:1]) ** 2).sum(axis=1)
    found[begins] = 0.0
    after = begins[begins + 1 < len(scene)]
    after = after[follows[after + 1]]
    found[after] = found[after + 1]
    if scene.is_given:
        return found
    smooth: Array = np.concatenate([smooth_course(part) for part in np.split(found, begins[1:])])
    return np.maximum(smooth, 0.0)


def _derived(parameters: Values) -> Values:
    """The time constant, from what is lost across the field, which grows as tau^2; or the share of a new sample."""
    if "memory" in parameters:
        return _of_average(parameters)
    loss = parameters["tau2_s2"]
    tau = float(np.sqrt(max(float(loss.value), 0.0)))
    if tau <= 0.0:
        return {}
    return {"tau_s": value_of(tau, float(loss.sigma) / (2.0 * tau), "s")}


def _of_average(parameters: Values) -> Values:
    """Share a of a new sample, from (1 - a) / a^2, and the time constant of a low-pass that would lose as much.

    Which of the two it is shows in nothing but how the loss grows with a turn of a radian a sample and more.
    """
    memory, period_s = parameters["memory"], float(parameters["period_s"].value)
    size, sigma = max(float(memory.value), 0.0), float(memory.sigma)
    share = 2.0 / (1.0 + float(np.sqrt(1.0 + 4.0 * size)))
    share_sigma = sigma * share**3 / (2.0 - share)
    return {
        "new_share": value_of(share, share_sigma, "1"),
        "tau_s": value_of(period_s * size**0.5, 0.5 * period_s * sigma / max(size, 1e-12) ** 0.5, "s"),
    }


EFFECT = Effect(
    name="response_lag",
    acts_on=ActsOn.FIELD,
    title="the sensor answers late",
    equation="tau dy/dt = A H - y: what turns is short by 1 / sqrt(1 + w^2 tau^2), |B| by tau^2 |dB/dt|^2 / (2 |B|)"
    "; of samples y_k = a x_k + (1 - a) y_(k-1): by (1 - a) / a^2 |y_k - y_(k-1)|^2 / (2 |B|)",
    units={"tau2_s2": "s2", "tau_s": "s", "memory": "1", "new_share": "1", "period_s": "s"},
    prior=(5.0, 5000.0),
    valid="tau below about a tenth of a turn; an average of samples: no sample of the driver is left out",
    confused_with=("axis_skew", "scale_drift", "spin_rate"),
    separated_by="another spin rate: at a steady rate it is a gain and an angle, and the nine errors absorb it",
    source="first-order response; Wertz 1978, section 17 (eddy currents)",
    says=(
        "The sensor answers late: a driver averages, a new sample counting {new_share.percent}, or a low-pass has "
        "{tau_s.size}.",
        "The sensor answers late, with a time constant of {tau_s.size}.",
    ),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    absorbed="at a constant spin rate the nine errors take up gain and angle of the lag whole",
)
