"""The sensor responds late: a low-pass, an averaging driver, eddy currents in the structure around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear, Value, Values, value_of
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.smooth import smooth_course

_AVERAGING: Final = "average of samples"
"""The form of a driver that averages: it needs samples that follow one another, and no gyro."""

_BY_STEPS: Final = "by the steps"
"""Form of a low-pass whose turn is taken from samples that follow one another: of a craft of which no rate is known."""

_MOST_MEMORY: Final = 90.0
"""(1 - a) / a^2 at most: a = 0.1, a tenth of every new sample; slower averages are no way to read a magnetometer."""

_LONGEST_S: Final = 10.0
"""Largest time constant [s]; choice: no driver averages for longer a vector that is to be used."""

_SELDOM: Final = 3.0
"""Prior odds [nats] against a lag that a late clock may be instead, which is met 20 times as often; a choice."""

_NEXT: Final = 1.5
"""Sample periods up to which a sample follows the one before; a longer time has others between that are not there."""

_TRIED_S: Final = np.array([0.0, 1.0, 4.0])
"""Lateness at which a lag is expanded while nothing is known of it [s]: a spun craft's shows by the turn alone."""

_MOST_LOST: Final = 0.3
"""Share of the field that may be lost at most: turned by a radian in a time constant, 1 - 1 / sqrt(2)."""

_OF_ONE_COURSE: Final = 0.9
"""Share of a course's variance that another one holds where both are of one turn: of a steady spin 0.999, of a tumbling
craft whose turn was taken for a steady one 0.6."""

_SMALL_TURN: Final = 0.2
"""Turn [rad] over which a step is taken: its chord is shorter by 0.2 %."""

_MOST_STEPS: Final = 30  # of them together: a craft that hardly turns loses nothing by its turn

_LEAST_LATE_S: Final = 1e-3  # less moves the field by less than 0.1 nT in any orbit

_FEWEST: Final = 64
"""Samples from which on a stretch has a course whose steps are told from noise."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    period_s = scene.constant("period_s", scene.period_s)
    if scene.rate_body is not None:
        slope = scene.field_slope
        along = np.einsum("ni,ni->n", slope, scene.unit)
        turned2 = np.maximum(np.einsum("ni,ni->n", slope, slope) - along**2, 0.0)
        yield _low_pass(scene, turned2)
        if not scene.is_given and scene.once("turns as its rate", lambda: _is_turning_so(scene, turned2, period_s)):
            return
    step2 = _steps2(scene, period_s)
    if step2 is None:
        return
    yield _low_pass(scene, step2 / period_s**2, _BY_STEPS, {"period_s": period_s})
    memory = Block("memory", "1", (), most=_MOST_MEMORY, least=0.0)
    yield _form(
        scene,
        _lost(scene, step2),
        memory,
        lambda late_s: late_s / period_s * (1.0 + late_s / period_s),
        lambda a: period_s * (1.0 / _share(a) - 1.0),
        _AVERAGING,
        {"period_s": period_s},
    )


def _is_turning_so(scene: Scene, turned2: Array, period_s: float) -> bool:
    """Whether a rate is the craft's own: a gyro's, or one whose turn (n,) goes along with the samples' steps.

    A turn that was fitted as a steady one, or found in the field alone, need not be.
    """
    if any(channel.values.shape[1] == 3 for channel in scene.of_quantity("angular rate")):
        return True
    step2 = _steps2(scene, period_s)
    if step2 is None or min(float(np.ptp(turned2)), float(np.ptp(step2))) <= 0.0:
        return True
    return float(np.corrcoef(turned2, step2)[0, 1]) ** 2 > _OF_ONE_COURSE


def _low_pass(
    scene: Scene, turned2: Array, variant: str = "", constants: Mapping[str, float] | None = None
) -> Hypothesis:
    """A low-pass while the field turns by what squares to (n,) [nT^2/s^2]."""
    block, turned = Block("tau2_s2", "s2", (), most=_LONGEST_S**2, least=0.0), _lost(scene, turned2)
    return _form(
        scene, turned, block, lambda late_s: late_s**2, lambda a: float(np.sqrt(max(a, 0.0))), variant, constants
    )


def _form(
    scene: Scene,
    turned: Array,
    block: Block,
    size: Callable[[float], float],
    late_s: Callable[[float], float],
    variant: str = "",
    constants: Mapping[str, float] | None = None,
) -> Hypothesis:
    """A lag that loses by the square of the turn and follows the field's own course late, expanded at one lateness.

    Parameters
    ----------
    turned: (n,) what is lost along the field by a small amplitude, per one [nT].
    size: from how late it is [s] to the amplitude; ``late_s``: the way back.
    """
    found = 0.0 if scene.moved_s is None else -float(np.mean(scene.moved_s))
    slope, bend, length = scene.magnitude_slope, scene.magnitude_bend, np.linalg.norm(scene.calibrated_nt, axis=1)

    def course(at_s: float) -> Array:
        """(n,) per amplitude of one [nT]."""
        return np.zeros_like(slope) if at_s <= _LEAST_LATE_S else (at_s * bend - slope) * at_s / size(at_s)

    def loss(at_s: float) -> Array:
        """(n,) per amplitude of one [nT]: of |H|^2 - |y|^2, by the turn of y, which is shorter than H, and as late."""
        late = np.interp(scene.time_s - at_s, scene.time_s, turned)
        lost = np.minimum(-late * size(max(at_s, 0.0)) / length, _MOST_LOST)
        return np.asarray(late * (1.0 - lost) ** 2 / (1.0 - 0.5 * lost))

    def columns(theta: Array) -> Columns:
        at_s = float(theta[0])
        return Columns(body=((loss(at_s) + course(at_s))[:, None] * scene.unit)[None])

    by_turn, by_course = float(np.sum(loss(found) ** 2)), float(np.sum(course(found) ** 2))
    return Hypothesis(
        "response_lag",
        "none",
        columns,
        (block,),
        variant,
        (Nonlinear("expanded_at_s", "s", np.array([found]) if found > _LEAST_LATE_S else _TRIED_S, "held"),),
        constants={**(constants or {}), "order": 1.0 + by_turn / max(by_turn + by_course, 1e-300)},
        odds=_SELDOM if found > _LEAST_LATE_S else 0.0,
        moves_s=lambda a: -late_s(float(a[0])),
    )


def _lost(scene: Scene, turned2: Array) -> Array:
    """What is lost along the field (n,) by a lag of one while the field turns by what squares to (n,)."""
    return np.asarray(-0.5 * turned2 / np.linalg.norm(scene.calibrated_nt, axis=1))


def _steps2(scene: Scene, period_s: float) -> Array | None:
    """Square (n,) [nT^2] of the step from a sample to the next, over as many of them as hold a small turn.

    How fast the field turns changes slowly against its noise, which is smoothed away; what the noise adds in the mean
    is a constant, which the nine errors take up.  None where the samples do not follow one another.
    """
    follows = np.concatenate([[False], np.diff(scene.time_s) < _NEXT * period_s])
    begins = np.flatnonzero(~follows)
    if scene.is_given:
        return _over(scene.calibrated_nt, begins, 1)
    if len(scene) < _FEWEST or len(begins) * _FEWEST > len(scene):
        return None
    single = _over(scene.calibrated_nt, begins, 1)
    turn = float(np.sqrt(np.median(single))) / float(np.mean(np.linalg.norm(scene.calibrated_nt, axis=1)))
    span = int(np.clip(_SMALL_TURN / max(turn, 1e-9), 1, _MOST_STEPS))
    found = single if span == 1 else _over(scene.calibrated_nt, begins, span)
    smooth: Array = np.concatenate([_smooth(part, span) for part in np.split(found, begins[1:])])
    return np.maximum(smooth, 0.0)


def _smooth(steps2: Array, span: int) -> Array:
    """A smooth course under squares (n,), of those that share no sample: their noise is white."""
    rows = np.arange(len(steps2))
    return np.asarray(np.interp(rows, rows[::span], smooth_course(steps2[::span])))


def _over(vectors: Array, begins: NDArray[np.intp], span: int) -> Array:
    """Square (n,) of the mean step of vectors (n, 3) over ``span`` of them about each, within stretches."""
    rows = np.arange(len(vectors))
    ends = np.append(begins[1:], len(vectors))
    stretch = np.searchsorted(begins, rows, side="right") - 1
    low = np.maximum(rows - (span + 1) // 2, begins[stretch])
    high = np.minimum(np.maximum(rows + span // 2, low + 1), ends[stretch] - 1)
    steps = np.maximum(high - low, 1)
    return np.asarray(((vectors[high] - vectors[low]) ** 2).sum(axis=1) / steps**2)


def _derived(parameters: Values) -> Values:
    """The time constant, from what is lost across the field, which grows as tau^2; or the share of a new sample."""
    if "memory" in parameters:
        return _of_average(parameters["memory"], parameters)
    loss = parameters["tau2_s2"]
    if "period_s" in parameters and float(loss.value) > 0.0:
        period2_s2 = float(parameters["period_s"].value) ** 2
        return _of_average(value_of(loss.value / period2_s2, loss.sigma / period2_s2, "1"), parameters)
    tau = float(np.sqrt(max(float(loss.value), 0.0)))
    if tau <= 0.0:
        return {}
    return {"tau_s": value_of(tau, float(loss.sigma) / (_order(parameters) * tau), "s")}


def _order(parameters: Values) -> float:
    """The power of the time constant that what is seen grows with: 2 by the turn, 1 by the field's own course."""
    return float(parameters["order"].value) if "order" in parameters else 2.0


def _share(memory: float) -> float:
    """Share a of a new sample, from (1 - a) / a^2."""
    return 2.0 / (1.0 + float(np.sqrt(1.0 + 4.0 * max(memory, 0.0))))


def _of_average(memory: Value, parameters: Values) -> Values:
    """Share a of a new sample, from (1 - a) / a^2, and the time constant of a low-pass that would show the same.

    By the turn it loses as much, by the course it is as late.  Which of the two it is shows in nothing but how the loss
    grows with a turn of a radian a sample and more.
    """
    period_s = float(parameters["period_s"].value)
    size, sigma = max(float(memory.value), 0.0), float(memory.sigma)
    share, order = _share(size), _order(parameters)
    tau_s = period_s * ((order - 1.0) * size**0.5 + (2.0 - order) * (1.0 / share - 1.0))
    return {
        "new_share": value_of(share, sigma * share**3 / (2.0 - share) * 2.0 / order, "1"),
        "tau_s": value_of(tau_s, period_s * sigma / order / max(size, 1e-12) ** 0.5, "s"),
    }


EFFECT = Effect(
    name="response_lag",
    acts_on=ActsOn.FIELD,
    title="the sensor answers late",
    equation="tau dy/dt = A H - y: what turns is short by 1 / sqrt(1 + w^2 tau^2), |B| by tau^2 |dB/dt|^2 / (2 |B|) "
    "and by tau d|H|/dt; of samples y_k = a x_k + (1 - a) y_(k-1): by (1 - a) / a^2 |y_k - y_(k-1)|^2 / (2 |B|), and "
    "with a delay of (1 - a) / a samples",
    units={
        "tau2_s2": "s2",
        "tau_s": "s",
        "memory": "1",
        "new_share": "1",
        "period_s": "s",
        "expanded_at_s": "s",
        "order": "1",
    },
    prior=(5.0, 5000.0),
    valid="tau below about a tenth of a turn; an average of samples: no sample of the driver is left out",
    confused_with=("axis_skew", "scale_drift", "spin_rate", "time_offset"),
    separated_by="another spin rate: at a steady rate it is a late clock, with a gain that nine errors take up",
    source="first-order response; Wertz 1978, section 17 (eddy currents)",
    says=(
        "The sensor answers late: a driver averages, a new sample counting {new_share.percent}, or a low-pass has "
        "{tau_s.size}.",
        "The sensor answers late, with a time constant of {tau_s.size}.",
    ),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    absorbed="at a constant spin rate the nine errors take up gain and angle of the lag; its delay is a late clock's",
)
