"""The sensor responds late: a low-pass, an averaging driver, eddy currents in the structure around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.late import by_average, by_low_pass, longer_by_low_pass
from magcal_service.physics.drivers.steps import LEAST_STEPS, either_side, steps2
from magcal_service.physics.drivers.whole_vectors import LARGEST_NT, answers_late
from magcal_service.physics.interface import START, Block, Effect, Hypothesis, Nonlinear, Value, Values, value_of
from magcal_service.physics.scene.memory import AT_START_S
from magcal_service.physics.scene.motion import FEWEST_FOR_MEANS
from magcal_service.physics.scene.recent import Recent
from magcal_service.physics.scene.scene import Scene

_AVERAGING: Final = "average of samples"
"""The form of a readout that averages: it needs samples that follow one another, and no gyro."""

_BY_STEPS: Final = "by the steps"
"""Form of a low-pass whose turn is taken from samples that follow one another: of a craft of which no rate is known."""

_OF_VECTORS: Final = "of whole vectors"
"""The form that vectors show beside a recorded attitude."""

_LARGEST_NT: Final = 5000.0
"""Largest part in a magnitude: of 10 s at the field's steepest 0.5 uT, and a tenth of a field that turns."""

_BEGUN: Final = "from its start"
"""Added to the form of a low-pass that held something else when the recording began than the turn before would tell."""

_AT_START_NT: Final = 100.0  # change at the start that its part later is a quotient of: 0.3 % of the field

_MOST_MEMORY: Final = 90.0
"""(1 - a) / a^2 at most: a = 0.1, a tenth of every new sample; slower averages are no way to read a magnetometer."""

_LONGEST_S: Final = 10.0
"""Largest time constant [s]; choice: no readout averages for longer a vector that is to be used."""

_SELDOM: Final = 3.0
"""Prior odds [nats] against a lag that a late clock may be instead, which is met 20 times as often; a choice."""

_TRIED_S: Final = (0.0, 1.0, 4.0)
"""Lateness at which a lag is expanded while nothing is known of it [s], by the field's own course."""

_TRIED_TURNS: Final = (0.1, 0.3, 1.0)
"""The same by the craft's turn in a time constant [rad]: loses 0.5, 4 and 29 %.  To first order alone the loss of a
tenth of a radian is 1 % off, 4 nT, which a gain that relaxed as a spin slowed down explained better by 36 nats."""

_MOST_LOST: Final = 0.3
"""Share of the field that may be lost at most: turned by a radian in a time constant, 1 - 1 / sqrt(2)."""

_OF_ONE_COURSE: Final = 0.9
"""Share of a course's variance that another one holds where both are of one turn: of a steady spin 0.999, of a tumbling
craft whose turn was taken for a steady one 0.6."""

_LEAST_LATE_S: Final = 1e-3  # less moves the field by less than 0.1 nT in any orbit

_MOST_KNOWN: Final = 16  # answers kept for what is tried again: all of a grid, and one about its best


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield from answers_late(scene, "response_lag", _OF_VECTORS, "tau_s", _LONGEST_S)
    yield from (replace(form, largest_nt=_LARGEST_NT) for form in _of_magnitudes(scene))


def _of_magnitudes(scene: Scene) -> Iterator[Hypothesis]:
    """Forms that a magnitude shows, too: by what is lost of a vector's length, and by its delay."""
    period_s = scene.constant("period_s", scene.period_s)
    if scene.rate_body is not None:
        slope = scene.field_slope
        along = np.einsum("ni,ni->n", slope, scene.unit)
        turned2 = np.maximum(np.einsum("ni,ni->n", slope, slope) - along**2, 0.0)
        yield _low_pass(scene, turned2)
        if not scene.is_given and scene.once("turns as its rate", lambda: _is_turning_so(scene, turned2, period_s)):
            return
    step2 = steps2(scene, period_s)
    if step2 is None:
        return
    chord = np.sqrt(step2 / (scene.calibrated_nt**2).sum(axis=1))
    rate = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) / period_s
    yield from _by_steps(scene, step2 / period_s**2, rate, {"period_s": period_s})
    memory = Block("memory", "1", (), most=_MOST_MEMORY, least=0.0)
    yield _form(
        scene,
        _lost(scene, step2),
        memory,
        lambda late_s: late_s / period_s * (1.0 + late_s / period_s),
        lambda a: period_s * (1.0 / _share(a) - 1.0),
        lambda late_s, drive, steps: by_average(drive, rate, steps, period_s, period_s / (period_s + late_s)),
        _AVERAGING,
        {"period_s": period_s},
    )


def _is_turning_so(scene: Scene, turned2: Array, period_s: float) -> bool:
    """Whether a rate is the craft's own: a gyro's, or one whose turn (n,) goes along with the samples' steps.

    A turn that was fitted as a steady one, or found in the field alone, need not be; where the samples' own is known
    better than that, both are tried.
    """
    if any(channel.values.shape[1] == 3 for channel in scene.of_quantity("angular rate")):
        return True
    step2 = steps2(scene, period_s)
    if step2 is None or min(float(np.ptp(turned2)), float(np.ptp(step2))) <= 0.0:
        return True
    if either_side(scene, np.sqrt(step2)) >= LEAST_STEPS:
        return False
    return float(np.corrcoef(turned2, step2)[0, 1]) ** 2 > _OF_ONE_COURSE


def _low_pass(
    scene: Scene,
    turned2: Array,
    follow: Callable[[float, Array, Array], Array] | None = None,
    variant: str = "",
    constants: Mapping[str, float] | None = None,
) -> Hypothesis:
    """A low-pass while the field turns by what squares to (n,) [nT^2/s^2]."""
    return _form(
        scene,
        _lost(scene, turned2),
        Block("tau2_s2", "s2", (), most=_LONGEST_S**2, least=0.0),
        lambda late_s: late_s**2,
        lambda a: float(np.sqrt(max(a, 0.0))),
        follow,
        variant,
        constants,
    )


def _by_steps(scene: Scene, turned2: Array, rate: Array, constants: Mapping[str, float]) -> Iterator[Hypothesis]:
    """A low-pass, the turn being (n,) [rad/s] in the step to each row.

    A second form frees what the low-pass held when the recording began.
    """
    form = _low_pass(
        scene,
        turned2,
        lambda late_s, drive, steps: by_low_pass(drive, rate, steps, late_s),
        _BY_STEPS,
        constants,
    )
    plain = replace(form, by_samples=True)
    yield plain
    begins = len(scene) >= FEWEST_FOR_MEANS and scene.memory is None and abs(float(scene.time_s[0])) < AT_START_S

    def begun(theta: Array) -> Columns:
        """What the plain form has, and what is added along the field by one nT more at the start."""
        held = plain.columns(theta)
        assert held.body is not None
        more: Array = np.zeros(len(scene))
        if begins and float(theta[0]) > _LEAST_LATE_S:
            steps = _steps_s(scene)
            more = longer_by_low_pass(scene.magnitude_nt, rate, steps, float(theta[0]), _AT_START_NT) / _AT_START_NT
        return Columns(body=np.concatenate([held.body, (more[:, None] * scene.unit)[None]]))

    own = plain.nonlinear[0]
    yield replace(
        plain,
        columns=begun,
        blocks=(*plain.blocks, Block(f"{START}nt", "nT", ())),
        variant=f"{_BY_STEPS}, {_BEGUN}",
        nonlinear=(replace(own, grid=own.grid[own.grid > _LEAST_LATE_S]),),
        refines=plain.label,
    )


def _steps_s(scene: Scene) -> Array:
    """Time (n,) from the sample before [s]; infinite where a stretch begins."""
    steps = np.concatenate([[np.inf], np.diff(scene.time_s)])
    steps[scene.pauses] = np.inf
    return steps


def _form(
    scene: Scene,
    turned: Array,
    block: Block,
    size: Callable[[float], float],
    late_s: Callable[[float], float],
    follow: Callable[[float, Array, Array], Array] | None,
    variant: str = "",
    constants: Mapping[str, float] | None = None,
) -> Hypothesis:
    """A lag that loses by the square of the turn and follows the field's own course late, as it is at one lateness.

    Parameters
    ----------
    turned: (n,) what is lost along the field by a small amplitude, per one [nT].
    size: from how late it is [s] to the amplitude; ``late_s``: the way back.
    follow: from how late it is [s], the field's length (n,) and the steps (n,) [s] to the length that is read (n,).
        None: expanded, for a rate whose own noise would be followed.
    """
    found = 0.0 if scene.moved_s is None else -float(np.mean(scene.moved_s))
    has_course = len(scene) >= FEWEST_FOR_MEANS and scene.memory is None  # a moment has none
    steps, length = _steps_s(scene), np.linalg.norm(scene.calibrated_nt, axis=1)
    known: Recent[float, Array] = Recent(_MOST_KNOWN)

    def short(at_s: float) -> Array:
        """(n,) what is added along the field by an amplitude of one [nT]: by the whole of what a lag so late does."""
        if follow is None:
            return _expanded(scene, turned, size, at_s)
        if not has_course:
            return turned / _rooted(-2.0 * turned * size(max(at_s, 0.0)) / length)
        if at_s <= _LEAST_LATE_S:
            return turned
        return known.once(at_s, lambda: followed(follow, at_s))

    def followed(follow: Callable[[float, Array, Array], Array], at_s: float) -> Array:
        drive = np.array(scene.magnitude_nt)
        drive[scene.pauses] -= at_s * scene.magnitude_slope[scene.pauses]
        return np.asarray((follow(at_s, drive, steps) - scene.magnitude_nt) / size(at_s))

    def columns(theta: Array) -> Columns:
        return Columns(body=(short(float(theta[0]))[:, None] * scene.unit)[None])

    tried = _tried_s(-2.0 * float(np.mean(turned / length)), late_s)
    by_course = float(np.sum((found * scene.magnitude_slope) ** 2))
    by_turn = float(np.sum((size(found) * turned) ** 2))
    return Hypothesis(
        "response_lag",
        "none",
        columns,
        (block,),
        variant,
        (Nonlinear("expanded_at_s", "s", np.array([found]) if found > _LEAST_LATE_S else tried, "held"),),
        constants={
            **(constants or {}),
            "order": 2.0 if by_course <= 0.0 else 1.0 + by_turn / (by_turn + by_course),
        },
        odds=_SELDOM if found > _LEAST_LATE_S else 0.0,
        moves_s=lambda a: -late_s(float(a[0])),
    )


def _tried_s(rate2: float, late_s: Callable[[float], float]) -> Array:
    """(m,) how late it may be [s], also by the turn in it, whose mean square is ``rate2`` for an amplitude of one."""
    turning = [late_s(turn**2 / rate2) for turn in _TRIED_TURNS] if rate2 > 0.0 else []
    return np.unique([*_TRIED_S, *(tau for tau in turning if _LEAST_LATE_S < tau < max(_TRIED_S))])


def _expanded(scene: Scene, turned: Array, size: Callable[[float], float], at_s: float) -> Array:
    """What ``_form`` adds along the field (n,) to second order, by the turn of what is shorter and late."""
    late = np.interp(scene.time_s - at_s, scene.time_s, turned)
    turn2 = -2.0 * late * size(max(at_s, 0.0)) / np.linalg.norm(scene.calibrated_nt, axis=1)
    lost = np.minimum(1.0 - 1.0 / np.sqrt(1.0 + turn2), _MOST_LOST)
    loss = np.asarray(late * (1.0 - lost) ** 2 / (1.0 - 0.5 * lost))
    if at_s <= _LEAST_LATE_S:
        return loss
    return np.asarray(loss + (at_s * scene.magnitude_bend - scene.magnitude_slope) * at_s / size(at_s))


def _rooted(turn2: Array) -> Array:
    """Half of 1 + sqrt(1 + x^2) (n,): by it less than x^2 / 2 is what a vector lacks that turns by x in its lateness.

    A length |y| that lags has lost |y| (sqrt(1 + x^2) - 1) against what it follows.
    """
    return np.asarray(0.5 * (1.0 + np.sqrt(1.0 + turn2)))


def _lost(scene: Scene, turned2: Array) -> Array:
    """What is lost along the field (n,) by a lag of one while the field turns by what squares to (n,)."""
    return np.asarray(-0.5 * turned2 / np.linalg.norm(scene.calibrated_nt, axis=1))


def _derived(parameters: Values) -> Values:
    """The time constant, from what is lost across the field, which grows as tau^2; or the share of a new sample."""
    if "memory" in parameters:
        return _of_average(parameters["memory"], parameters)
    if "tau_s" in parameters:
        return {}
    loss = parameters["tau2_s2"]
    tau = float(np.sqrt(max(float(loss.value), 0.0)))
    if tau <= 0.0:
        return {}
    found = {"tau_s": value_of(tau, float(loss.sigma) / (_order(parameters) * tau), "s")}
    if "period_s" not in parameters:
        return found
    period2_s2 = float(parameters["period_s"].value) ** 2
    alike = _of_average(value_of(loss.value / period2_s2, loss.sigma / period2_s2, "1"), parameters)
    return {"new_share": alike["new_share"], **found}


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
        "start_nt": "nT",
    },
    prior=(5.0, LARGEST_NT),
    valid="any turn in a time constant, as far as it is known; an average of samples: where none is left out",
    confused_with=("axis_skew", "scale_drift", "spin_rate", "time_offset"),
    separated_by="another spin rate: at a steady rate it is a late clock, with a gain that nine errors take up",
    source="first-order response; Wertz 1978, section 17 (eddy currents)",
    says=(
        "The sensor answers late: its readout averages, a new sample counting {new_share.percent}, or a low-pass has "
        "{tau_s.size}.",
        "The sensor answers late, with a time constant of {tau_s.size}.",
    ),
    derived=_derived,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    not_live=(_OF_VECTORS, f"{_OF_VECTORS}, {_BEGUN}"),
    live_as=lambda form: "what its turn alone shortens, without its delay" if form else "",
    absorbed="at a constant spin rate the nine errors take up gain and angle of the lag; its delay is a late clock's",
)
