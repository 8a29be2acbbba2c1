"""A recording as a problem: rows in order, telemetry without gaps, no spikes, nine errors fitted, attitude solved."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import FilterConfig
from magcal_service.diagnosis.aimed import InBody, guessed, in_body, weighted
from magcal_service.diagnosis.axis_noise import covariance_of
from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.field_error import FieldError, Scale
from magcal_service.diagnosis.offset import Offset
from magcal_service.diagnosis.problem import PRIOR_BIAS_NT, PRIOR_D, Fit, Problem
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.spikes import spikes
from magcal_service.diagnosis.sun_seen import SunSeen, sun_seen
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.parts.start_problem import BatchProblem, WindowMeans, linear_states
from magcal_service.model import STATE_SIZE, Array, calibrate, d_matrix, measure
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Effect, Finding
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import SpinSolution, Turn, solve_spin, turn_alone
from magcal_service.physics.scene.vectors import Vectors
from magcal_service.physics.scene.view import View
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import cleaned, recorded_attitude, scene_of
from magcal_service.recordings.specs import MagnetometerSpec
from magcal_service.residuals import white_noise_level

MOST_ROWS: Final = 60_000
"""Longer recordings are thinned evenly: a diagnosis is about structure, and this keeps it in memory."""

_SHRUNK: Final = 0.35
"""Determinant of I + D, 0.7 cubed: half-collapsed minima of short arcs have 0.2, sensors told in the wrong scale too,
but those have no second solution."""

FEWEST_ROWS: Final = 10 * STATE_SIZE
"""Rows from which on nine errors are known well enough to leave others out; choice: ten for each."""

_LEAST_FIELD: Final = 10.0
"""Times the noise, the field from which on a row is used: below it the noise turns the calibrated vector by more than
6 deg, and |w| is no more its length along the field with noise / |H| on top (``model.scalar_residual``).  In orbit: a
coil that sweeps through zero shows the bias by that."""

_CONSTANT_SPREAD: Final = 0.005
"""Spread of |H| over its mean below which a recorded attitude is needed, and the vector form is used.

As ``magnitude_spread`` of the trust monitor: the scalar form is degenerate on a sphere.
"""


class Form(StrEnum):
    """What a residual is made of."""

    AIMED = "vectors"
    ROOM = "vectors in a room"
    SCALAR = "magnitudes"


@dataclass(frozen=True, eq=False)
class Prepared:
    """What the steps of a diagnosis work on.

    Parameters
    ----------
    recording: the rows that are used, in time order.
    problem: as the residual is formed.
    baseline: the nine errors alone.
    spin: the turn of the craft, or None.
    view: the input of effects that are no field.
    left_out: rows that were left out for being too many, spikes, edges or spoiled, as in ``Account``.
    findings: effects seen in the samples themselves, by name.
    form: of the residual.
    sun: where telemetry shows the Sun, if not where the stated time has it.
    alone: how large the field model's errors are that suit the nine errors alone best; None: not asked.
    has_reference_far_off: whether whole vectors agree with a reference off by more than is believed of one, and with
        none that is off by less.
    """

    recording: Recording
    problem: Problem
    baseline: Fit
    spin: SpinSolution | None
    view: View
    left_out: Mapping[str, int]
    findings: Mapping[str, Finding] = field(default_factory=dict)
    form: Form = Form.SCALAR
    sun: SunSeen | None = None
    alone: Scale | None = None
    has_reference_far_off: bool = False


def prepare(
    recording: Recording, effects: tuple[Effect, ...], forms: Collection[Form] = tuple(Form), stride: int | None = None
) -> Prepared:
    """Everything up to the residual of the nine errors, in the form that says most.

    Parameters
    ----------
    forms: that the residual may have.
    stride: every so many-th row is taken; None: as many as a diagnosis takes.
    """
    used = _used(recording, effects, stride)
    attitude = recorded_attitude(used.recording)
    scene = cleaned(used.scene, used.x)
    aimed = None if scene.in_orbit or Form.AIMED not in forms else in_body(used.recording, scene, attitude)
    room = None if aimed is not None or Form.ROOM not in forms else _room(scene, attitude)
    scene, spin, alone = _turning(used.recording, scene, attitude)
    sun = sun_seen(scene, np.linalg.norm(calibrate(used.x, scene.field_nt), axis=1) - scene.magnitude_nt)
    if sun is not None:
        scene = replace(scene, sun_ahead_deg=sun.ahead_deg)
    largest_nt = {effect.name: effect.prior[1] for effect in effects}
    baseline = _baseline(scene, used, largest_nt, aimed, room)
    form = Form.AIMED if aimed is not None else Form.SCALAR if room is None else Form.ROOM
    nominal = used.recording.descriptor.spin
    view = View(
        baseline.problem.scene,
        baseline.residual,
        used.level_nt,
        spin,
        None if nominal is None else np.array(nominal.axis),
        None if nominal is None else nominal.rate_rad_s,
        used.recording.descriptor.magnetometer.noise_nt,
        alone,
        used.recording.descriptor.magnetometer.range_nt,
    )
    return Prepared(used.recording, baseline.problem, baseline, spin, view, used.left_out, used.findings, form, sun)


@dataclass(frozen=True, eq=False)
class _Used:
    """The rows that are used.

    Parameters
    ----------
    recording, scene: of them.
    x: nine errors (9,) to begin with.
    level_nt: the noise as stated, or what is white in the residual.
    findings, left_out: as in ``Prepared``.
    """

    recording: Recording
    scene: Scene
    x: Array
    level_nt: float
    findings: Mapping[str, Finding]
    left_out: Mapping[str, int]


def _used(recording: Recording, effects: tuple[Effect, ...], stride: int | None) -> _Used:
    """The rows without those too many, spikes, edges, spoiled or in a weak field; all where few would be left."""
    usable, thinned = _usable(recording, stride)
    stated = recording.descriptor.magnetometer
    noise_nt = stated.noise_nt
    scene = scene_of(usable)
    x = baseline_start(scene, noise_nt)
    level_nt = noise_nt or _white(scene, x)
    findings, spoiled = _sample_findings(scene, x, level_nt, stated, effects)
    if spoiled.any() and np.count_nonzero(~spoiled) >= FEWEST_ROWS:
        sound = scene_of(usable.select(~spoiled))  # once more, by errors that they have no part in
        x = baseline_start(sound, noise_nt)
        level_nt = noise_nt or _white(sound, x)
        findings, spoiled = _sample_findings(scene, x, level_nt, stated, effects)
    single, edges = (rows & ~spoiled for rows in spikes(scene, x))
    out = single | edges | spoiled
    weak = (scene.magnitude_nt < _LEAST_FIELD * level_nt) & ~out & scene.in_orbit
    keep = ~(out | weak)
    if np.count_nonzero(keep) < FEWEST_ROWS:
        keep = ~out
    if np.count_nonzero(keep) < FEWEST_ROWS:
        keep[:] = True
    why = {"spikes": single, "edges": edges, "spoiled": spoiled, "weak_field": weak}
    left_out = {"thinned": thinned, **{name: int((rows & ~keep).sum()) for name, rows in why.items()}}
    if not keep.all():
        usable = usable.select(keep)
        scene = scene_of(usable)
        x = baseline_start(scene, noise_nt)
        level_nt = noise_nt or _white(scene, x)
    return _Used(usable, scene, x, level_nt, findings, left_out)


def _turning(
    recording: Recording, scene: Scene, attitude: tuple[Axes, Array] | None
) -> tuple[Scene, SpinSolution | None, Turn | None]:
    """The scene with the craft's turn, recorded or solved; the spin, or the turn about its axis alone, as solved."""
    if attitude is not None:
        return (replace(scene, body_from_eci=attitude[1]) if attitude[0] is Axes.ECI else scene), None, None
    spin = _spin(recording, scene)
    if spin is not None:
        turned = replace(scene, body_from_eci=spin.body_from_eci, is_solved=True) if spin.is_attitude else scene
        return turned, spin, None
    alone = _turn_alone(recording, scene)
    if alone is not None:
        rate = np.gradient(alone.phase_rad, scene.time_s)
        scene = replace(scene, turning_rad_s=rate[:, None] * alone.axis_body)
    return scene, None, alone


def _baseline(
    scene: Scene, used: _Used, largest_nt: Mapping[str, float], aimed: InBody | None, room: Array | None
) -> Fit:
    """The nine errors alone, in the form of residual that there is; of vectors on a scene free of noise."""
    level_nt, x = used.level_nt, used.x
    if aimed is not None:
        fit = _aimed_baseline(scene, used, largest_nt, aimed)
    elif room is not None:
        fit = solve(Problem(scene, level_nt, room, largest_nt), np.concatenate([x, _room_field(scene, room)]))
    else:
        error = FieldError.of(scene, max(level_nt, _white(scene, x)))
        fit = solve(Problem(scene, level_nt, None, largest_nt, error), x)
        stated_nt = used.recording.descriptor.magnetometer.noise_nt
        covariance = covariance_of(scene, fit.x, fit.unit, fit.residual, stated_nt)
        if covariance is not None:
            fit = solve(replace(fit.problem, noise_covariance=covariance), fit.x)
    return _quiet(fit) if fit.problem.is_vector else fit


def _aimed_baseline(scene: Scene, used: _Used, largest_nt: Mapping[str, float], reference: InBody) -> Fit:
    """Nine errors, the turn of the sensor and what the reference is off by, the rows across the field weighted by the
    attitude's own noise."""
    level = used.level_nt
    aimed, start = guessed(scene, reference.reference_nt, used.x)
    if is_collapsed(start):
        start = used.x
    fit = solve(Problem(scene, level, None, largest_nt, aimed=aimed), np.concatenate([start, np.zeros(3)]))
    aimed = weighted(aimed, scene, fit.residual, level)
    fit = solve(replace(fit.problem, aimed=aimed), fit.x)
    by_axes = aimed.guess @ reference.body_from_axes
    products = fit.problem.white_products(np.concatenate([fit.columns, by_axes.reshape(-1, 3)], axis=1))
    offset = Offset.of(by_axes, reference.axes, used.recording.descriptor.platform, products)
    fit = solve(replace(fit.problem, aimed=replace(aimed, offset=offset)), np.append(fit.x, np.zeros(offset.size)))
    aimed = replace(weighted(aimed, scene, fit.residual, level), offset=offset)
    onto = aimed.weighed(by_axes.reshape(-1, 3)).reshape(-1, 3, 3)
    return solve(replace(fit.problem, aimed=aimed, field_error=FieldError.of(scene, level, onto)), fit.x)


def _quiet(fit: Fit) -> Fit:
    """The same fit on a scene whose vectors are the reference's or the room's, as the fit turns them, free of noise."""
    clean = fit.problem.target(fit.x)
    scene = fit.problem.scene.recalibrated(Vectors(clean, measure(fit.x[:STATE_SIZE], clean)))
    return solve(replace(fit.problem, scene=scene), fit.x)


def stride_for(rows: int) -> int:
    """Of so many rows every so many-th is taken, for ``MOST_ROWS`` in all."""
    return max(-(-rows // MOST_ROWS), 1)


def _usable(recording: Recording, stride: int | None) -> tuple[Recording, int]:
    """The rows in time order, thinned evenly, and how many were left out for that."""
    usable = recording.sorted_unique()
    stride = stride_for(len(usable)) if stride is None else stride
    if stride == 1:
        return usable, 0
    kept = usable.select(np.arange(0, len(usable), stride))
    return kept, len(usable) - len(kept)


def baseline_start(scene: Scene, noise_nt: float | None) -> Array:
    """The nine errors (9,) from several starts: linear least squares, the best sphere, and zero; the best that arrived.

    From one start alone a short arc ends in a half-collapsed false minimum.
    """
    prior = prior_sigma(FilterConfig(prior_bias_nt=PRIOR_BIAS_NT, prior_D=PRIOR_D))
    magnitude = scene.magnitude_nt
    sigma = max(noise_nt or 0.0, 0.01 * float(magnitude.mean()))
    linear = BatchProblem(scene.field_nt, magnitude, WindowMeans.of(()), prior, sigma, noise_nt or 0.0)
    first, positive = linear_states(linear)
    starts = [_sphere(scene), np.zeros(STATE_SIZE)]
    if bool(positive) and not is_collapsed(first):
        starts.insert(0, first)
    problem = Problem(scene, noise_nt or 0.0)
    fits = [solve(problem, start) for start in starts]
    return min(fits, key=lambda fit: (is_collapsed(fit.x), _is_shrunk(fit.x), not fit.converged, fit.rms_nt)).x


def _is_shrunk(x: Array) -> bool:
    """Whether I + D makes vectors shorter on the whole: of several solutions, one that makes them fit by that."""
    return bool(np.linalg.det(np.eye(3) + d_matrix(x)) < _SHRUNK)


def _sphere(scene: Scene) -> Array:
    """The bias alone by linear least squares in (b, |b|^2), the matrix as it is: (9,)."""
    columns = np.concatenate([2.0 * scene.field_nt, -np.ones((len(scene), 1))], axis=1)
    magnitude = np.maximum(scene.magnitude_nt, 1.0)
    right = (scene.field_nt**2).sum(axis=1) - scene.magnitude_nt**2
    solution = np.linalg.lstsq(columns / magnitude[:, None], right / magnitude, rcond=1e-12)[0]
    return np.concatenate([solution[:3], np.zeros(STATE_SIZE - 3)])


def _white(scene: Scene, x: Array) -> float:
    residual = np.linalg.norm(calibrate(x, scene.field_nt), axis=1) - scene.magnitude_nt
    return max(white_noise_level(scene.time_ns, residual), 1e-3)


def _sample_findings(
    scene: Scene, x: Array, noise_nt: float, stated: MagnetometerSpec, effects: tuple[Effect, ...]
) -> tuple[dict[str, Finding], NDArray[np.bool_]]:
    """Effects that show in the samples themselves, and the rows that they spoil."""
    residual = np.linalg.norm(calibrate(x, scene.field_nt), axis=1) - scene.magnitude_nt
    view = View(cleaned(scene, x), residual, noise_nt, stated_noise_nt=stated.noise_nt, range_nt=stated.range_nt)
    spoiled = np.zeros(len(scene), dtype=bool)
    findings = {}
    for effect in effects:
        if effect.find is None or effect.acts_on is not ActsOn.SAMPLES:
            continue
        finding = effect.find(view)
        if finding is None:
            continue
        findings[effect.name] = finding
        if finding.spoiled is not None:
            spoiled |= finding.spoiled
    return findings, spoiled


def _spin(recording: Recording, scene: Scene) -> SpinSolution | None:
    nominal = recording.descriptor.spin
    axis = None if nominal is None else np.array(nominal.axis)
    return solve_spin(scene, axis, None if nominal is None else nominal.rate_rad_s)


def _turn_alone(recording: Recording, scene: Scene) -> Turn | None:
    """The turn about the stated axis, where the reference is no vector."""
    nominal = recording.descriptor.spin
    if nominal is None or scene.reference_eci_nt is not None:
        return None
    return turn_alone(scene, np.array(nominal.axis), nominal.rate_rad_s)


def _room(scene: Scene, attitude: tuple[Axes, Array] | None) -> Array | None:
    """Attitude to a room of uniform field, where the reference has one magnitude only."""
    if attitude is None or float(np.std(scene.magnitude_nt)) > _CONSTANT_SPREAD * float(scene.magnitude_nt.mean()):
        return None
    return np.transpose(attitude[1], (0, 2, 1))


def _room_field(scene: Scene, room_from_body: Array) -> Array:
    """A first guess at the room's field (3,) [nT]: the mean of the calibrated vectors, brought to the known length."""
    mean = np.einsum("nij,nj->i", room_from_body, scene.calibrated_nt) / len(scene)
    size = float(np.linalg.norm(mean))
    return np.asarray(mean * (float(scene.magnitude_nt.mean()) / max(size, 1e-9)))
