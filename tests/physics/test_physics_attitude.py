"""The turn of a craft, its rate and its coning, found in vectors of a known motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Finding
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import SpinSolution, solve_spin, turn_alone
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, NOISE_NT, PERIOD_S, RATE_RAD_S, X, scene, triad, turning, view

RPM = math.pi / 30.0
PHASE = RATE_RAD_S * scene().time_s + 0.3


def angle_deg(one: Array, other: Array) -> float:
    """Angle between two directions."""
    return math.degrees(math.asin(min(1.0, float(np.linalg.norm(np.cross(one, other))))))


def angle_rad(one: Array, other: Array) -> float:
    return math.radians(angle_deg(one, other))


def moved(attitude: Array, noise_nt: float = NOISE_NT, seed: int = 5) -> Scene:
    """The scene with another attitude (n, 3, 3), noise in its vectors."""
    assert scene().reference_eci_nt is not None
    body = np.einsum("nij,nj->ni", attitude, scene().reference_eci_nt)
    body = body + np.random.default_rng(seed).normal(0.0, 1.0, body.shape) * noise_nt
    return replace(scene(), calibrated_nt=body, clean_field_nt=measure(X, body), field_nt=measure(X, body))


def spin(of: Scene, axis: Array | None = AXIS_BODY, rate: float | None = RATE_RAD_S) -> SpinSolution:
    """The solution, which has to be there."""
    found = solve_spin(of, axis, rate)
    assert found is not None
    return found


def turned(phase: Array) -> Scene:
    """The craft at other angles about its axis."""
    return moved(turning(AXIS_BODY, AXIS_ECI, phase))


def test_axis_and_rate_are_those_of_the_motion() -> None:
    """At 80 nT both axes come out to 0.05 deg and the rate to 1e-6 of itself."""
    found = spin(turned(PHASE))
    assert angle_deg(found.axis_body, AXIS_BODY) < 0.05
    assert angle_deg(found.axis_eci, AXIS_ECI) < 0.05
    assert found.axis_body @ AXIS_BODY > 0.0
    assert found.rate_rad_s == pytest.approx(RATE_RAD_S, rel=1e-6)
    assert found.rate_rpm == pytest.approx(RATE_RAD_S / RPM, rel=1e-6)


def in_field(
    time_s: Array,
    attitude: Array,
    field: Array,
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0),
    noise_nt: float = 50.0,
    seed: int = 82,
) -> Scene:
    """A craft of an attitude (n, 3, 3) in a field (n, 3), its gains off, no noise along the field."""
    body = np.einsum("nij,nj->ni", attitude, field) * np.array(gains)
    body = body + np.random.default_rng(seed).normal(0.0, noise_nt, body.shape)
    size = np.linalg.norm(field, axis=1)
    body *= (size / np.maximum(np.linalg.norm(body, axis=1), 1e-9))[:, None]
    return replace(
        scene(),
        time_s=time_s,
        field_nt=body,
        calibrated_nt=body,
        clean_field_nt=body,
        magnitude_nt=size,
        reference_eci_nt=field,
        position_ecef_km=None,
        channels={},
        body_from_eci=None,
    )


def near_a_plane(off_deg: float, tilt_nt: float, noise_nt: float) -> tuple[Scene, Array]:
    """A craft that turns at 1.06 rad/s while the field stays within so many nT of a plane, and the plane's normal (3,),
    so many degrees from the axis."""
    time_s = np.arange(0.0, 900.0, 0.5)
    plane = triad(AXIS_ECI)
    normal = math.cos(math.radians(off_deg)) * plane[2] + math.sin(math.radians(off_deg)) * plane[0]
    one, other = triad(normal)[:2]
    course = 1.6 * time_s / time_s[-1] - 0.4
    field = 4e4 * (np.outer(np.cos(course), one) + np.outer(np.sin(course), other))
    field += tilt_nt * np.outer(np.sin(3.0 * course), normal)
    flown = in_field(time_s, turning(AXIS_BODY, AXIS_ECI, 1.06 * time_s + 0.2), field, noise_nt=noise_nt, seed=81)
    return flown, normal


@pytest.mark.parametrize(("off_deg", "tilt_nt"), [(60.0, 50.0), (45.0, 300.0), (85.0, 50.0)])
def test_the_axis_is_found_while_the_field_stays_near_a_plane(off_deg: float, tilt_nt: float) -> None:
    """Over a short arc of an orbit the field leaves a plane by little: the plane's normal was mixed into the axis, and
    a craft that turns evenly changed its rate by five sigmas."""
    flown, _ = near_a_plane(off_deg, tilt_nt, 100.0)
    found = spin(flown, rate=1.06)
    assert angle_deg(found.axis_body, AXIS_BODY) < 0.3
    assert angle_deg(found.axis_eci, AXIS_ECI) < 0.3
    assert found.rate_rad_s == pytest.approx(1.06, abs=2e-5)
    finding = effect_named("spin_rate").find
    assert finding is not None
    assert finding(replace(view(flown), spin=found, nominal_rate_rad_s=1.06)) is None


@pytest.mark.parametrize(("off_deg", "noise_nt"), [(60.0, 0.0), (60.0, 100.0), (20.0, 0.0), (40.0, 100.0)])
def test_in_a_plane_the_axis_is_that_of_the_two_mirror_images_about_which_the_turn_is_steady(
    off_deg: float, noise_nt: float
) -> None:
    """Two pairs cost nothing there; of one the body's half is none, and what lies between them is of one length."""
    flown, normal = near_a_plane(off_deg, 0.0, noise_nt)
    found = spin(flown, rate=1.06)
    assert angle_deg(found.axis_body, AXIS_BODY) < 0.3
    assert angle_deg(found.axis_eci, AXIS_ECI) < 0.5
    assert angle_deg(found.axis_eci, AXIS_ECI - 2.0 * (AXIS_ECI @ normal) * normal) > 10.0
    assert found.rate_rad_s == pytest.approx(1.06, abs=2e-5)
    finding = effect_named("spin_rate").find
    assert finding is not None
    assert finding(replace(view(flown), spin=found, nominal_rate_rad_s=1.06)) is None


@pytest.mark.parametrize("field", [(45e3, 0.0, 0.0), (0.0, 0.0, 45e3), (20e3, -9e3, 30e3), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("rate", [0.0, 0.2])
def test_a_field_of_one_direction_tells_no_axis(field: tuple[float, float, float], rate: float) -> None:
    """Any direction of space across it will do; a coil along an axis ended in a traceback."""
    time_s = np.arange(600.0)
    steady = np.tile(np.array(field), (600, 1))
    assert solve_spin(in_field(time_s, turning(AXIS_BODY, AXIS_ECI, rate * time_s), steady), None, None) is None


@pytest.mark.parametrize("rate", [0.0, 1.1e-3])
def test_over_a_short_arc_a_craft_that_hardly_turns_has_no_spin(rate: float) -> None:
    """Pointing at the stars or looking down for ten minutes: many axes miss by less than its gains are off."""
    time_s = np.arange(0.0, 600.0, 1.0)
    course = 2.2e-3 * time_s + 0.4
    across, north, up = triad(AXIS_ECI)
    field = 4e4 * (np.outer(np.cos(course), up) + np.outer(np.sin(course), across) + np.outer(0.1 * course**2, north))
    flown = in_field(time_s, turning(AXIS_BODY, AXIS_ECI, rate * time_s), field, (1.01, 0.99, 1.0))
    found = solve_spin(flown, None, None)
    assert found is None or abs(found.rate_rad_s - rate) < 1e-4


def test_an_axis_near_the_field_bends_the_phase_by_what_it_is_off() -> None:
    """Ten minutes near the equator, spinning about north: a degree of the axis is a tenth of a turn of the phase."""
    time_s = np.arange(0.0, 600.0, 0.5)
    course = 1.1e-3 * time_s
    one, other, axis = triad(AXIS_ECI)
    field = 3e4 * (np.outer(np.cos(0.3 * course), axis) + np.outer(0.1 * np.cos(course), one))
    field += 3e4 * np.outer(0.07 * np.sin(course), other)
    flown = in_field(time_s, turning(AXIS_BODY, AXIS_ECI, 0.09 * time_s), field, (1.01, 0.99, 1.005))
    found = solve_spin(flown, AXIS_BODY, 0.09)
    if found is not None:
        assert found.bent_rad > 2.0 * angle_rad(found.axis_eci, AXIS_ECI)
        finding = effect_named("spin_rate").find
        assert finding is not None
        assert finding(replace(view(flown), spin=found, nominal_rate_rad_s=0.09)) is None


def test_attitude_is_that_of_the_motion() -> None:
    """Body from ECI is right to a tenth of a degree at every sample, and a rotation."""
    found = spin(turned(PHASE)).body_from_eci
    assert scene().body_from_eci is not None
    change = np.einsum("nij,nkj->nik", found, scene().body_from_eci)
    angles = np.degrees(np.arccos(np.clip((np.trace(change, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)))
    assert float(angles.max()) < 0.1
    assert np.einsum("nij,nkj->nik", found, found) == pytest.approx(np.broadcast_to(np.eye(3), found.shape), abs=1e-9)


def test_phase_is_unwrapped_and_smooth() -> None:
    """Phases grow by the motion's, to 2 mrad smoothed; single samples scatter by the noise across the axis."""
    found = spin(turned(PHASE))
    assert np.abs(np.diff(found.phase_rad - PHASE)).max() < 1e-4
    scatter = np.std(found.raw_phase_rad - found.phase_rad)
    assert scatter == pytest.approx(np.sqrt(np.mean((NOISE_NT / found.across_nt) ** 2)), rel=0.1)


def test_sign_follows_the_nominal_axis() -> None:
    """About the opposite of the axis the craft turns the other way."""
    found = spin(turned(PHASE), -AXIS_BODY, -RATE_RAD_S)
    assert angle_deg(found.axis_body, AXIS_BODY) < 0.05
    assert found.axis_body @ AXIS_BODY < 0.0
    assert found.rate_rad_s == pytest.approx(-RATE_RAD_S, rel=1e-6)


def test_without_a_nominal_axis_the_rate_is_positive() -> None:
    """The axis is then the one about which the craft turns right-handed."""
    found = spin(turned(-PHASE), None, None)
    assert found.rate_rad_s == pytest.approx(RATE_RAD_S, rel=1e-6)
    assert found.axis_body @ AXIS_BODY < 0.0


def test_nominal_rate_tells_an_alias() -> None:
    """A craft that turns once more between samples looks the same; the nominal rate says which it is."""
    fast = RATE_RAD_S + 2.0 * math.pi / PERIOD_S
    of = turned(fast * scene().time_s + 0.3)
    assert spin(of, AXIS_BODY, 0.98 * fast).rate_rad_s == pytest.approx(fast, rel=1e-6)
    assert spin(of, AXIS_BODY, None).rate_rad_s == pytest.approx(RATE_RAD_S, rel=1e-5)


def test_a_tumbling_craft_has_no_spin() -> None:
    """Where no axis is fixed in both body and space there is no solution."""
    wobble = turning(np.array([0.0, 0.6, 0.8]), np.array([0.8, 0.0, 0.6]), 0.013 * scene().time_s)
    tumbling = np.einsum("nij,njk->nik", turning(AXIS_BODY, AXIS_ECI, PHASE), wobble)
    assert solve_spin(moved(tumbling), None, None) is None


def test_without_a_vector_there_is_no_spin() -> None:
    """A magnitude alone says nothing of attitude."""
    assert solve_spin(replace(scene(), reference_eci_nt=None), AXIS_BODY, RATE_RAD_S) is None


@pytest.mark.parametrize("missed_deg", [-1.5, -0.7, 0.7, 1.5])
def test_a_reference_on_the_wrong_side_of_the_axis_loses_no_turn(missed_deg: float) -> None:
    """The field passes half a degree from the spin axis, the reference elsewhere: round the other side, or nearer."""
    time_s, (east, north, axis) = scene().time_s, triad(AXIS_ECI)
    along = 2.2e-3 * (time_s - 0.5 * time_s[-1])
    beside = math.radians(0.5)

    def passing(by: float) -> Array:
        way = np.outer(np.cos(along), axis) + np.outer(np.sin(along), east) + math.sin(by) * north
        return np.asarray(40_000.0 * way / np.linalg.norm(way, axis=1)[:, None])

    body = np.einsum("nij,nj->ni", turning(AXIS_BODY, AXIS_ECI, PHASE), passing(beside))
    body = body + np.random.default_rng(6).normal(0.0, NOISE_NT, body.shape)
    shown = passing(beside + math.radians(missed_deg))
    size = np.linalg.norm(shown, axis=1)
    of = replace(scene(), calibrated_nt=body, reference_eci_nt=shown, magnitude_nt=size, body_from_eci=None)
    assert spin(of).rate_rad_s == pytest.approx(RATE_RAD_S, abs=2e-5)


def test_gap_does_not_lose_the_turns() -> None:
    """After twenty minutes without samples the phase goes on within 5 mrad of the motion's."""
    of, keep = turned(PHASE), (scene().time_s < 3000.0) | (scene().time_s > 4200.0)
    assert of.reference_eci_nt is not None
    cut = Scene(
        of.time_s[keep],
        of.origin_ns,
        True,
        of.field_nt[keep],
        of.calibrated_nt[keep],
        of.clean_field_nt[keep],
        of.magnitude_nt[keep],
        of.reference_eci_nt[keep],
    )
    off = spin(cut).phase_rad - PHASE[keep]
    assert float(np.ptp(off)) < 5e-3


def find(name: str, of: Scene, rate: float | None = RATE_RAD_S) -> Finding | None:
    """What an effect of the attitude says, given the spin of its own scene."""
    effect = effect_named(name)
    assert effect.find is not None
    solved = solve_spin(of, AXIS_BODY, rate)
    return effect.find(replace(view(of), spin=solved, nominal_axis=AXIS_BODY, nominal_rate_rad_s=rate))


def number(finding: Finding | None, name: str) -> float:
    """A parameter's value."""
    assert finding is not None
    return float(finding.parameters[name].value)


def test_a_despin_is_measured() -> None:
    """Rate at the first sample and its change come back within three of their own sigmas."""
    change = -2.5e-7
    found = find("spin_rate", turned(PHASE + 0.5 * change * scene().time_s ** 2))
    assert found is not None
    for name, truth in (("rate_rpm", RATE_RAD_S / RPM), ("rate_rpm_per_s", change / RPM)):
        value = found.parameters[name]
        assert abs(float(value.value) - truth) < 3.0 * float(value.sigma), name
        assert float(value.sigma) < 0.05 * abs(truth)


def test_a_rate_that_is_not_the_stated_one_is_told() -> None:
    """Three per cent off the descriptor's rate is a finding, and the true rate is in it."""
    found = find("spin_rate", turned(1.03 * PHASE))
    assert number(found, "rate_rpm") == pytest.approx(1.03 * RATE_RAD_S / RPM, rel=1e-4)
    assert number(found, "nominal_rpm") == pytest.approx(RATE_RAD_S / RPM, rel=1e-9)


def coning(angle: float, rate_rad_s: float) -> Scene:
    """The body's axis moves about the momentum, which is fixed in space, at a rate of its own in the body."""
    along = rate_rad_s * scene().time_s
    first, second, axis = triad(AXIS_BODY)
    momentum = axis + math.tan(angle) * (np.cos(along)[:, None] * first + np.sin(along)[:, None] * second)
    momentum /= np.linalg.norm(momentum, axis=1)[:, None]
    # the smallest turn of the body that brings its axis onto the momentum
    tilt = np.cross(axis, momentum)
    dot = momentum @ axis
    cross = np.zeros((len(tilt), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[:, i, j], cross[:, j, i] = -tilt[:, k], tilt[:, k]
    rotation = np.eye(3) + cross + cross @ cross / (1.0 + dot)[:, None, None]
    return moved(rotation @ turning(AXIS_BODY, AXIS_ECI, PHASE))


def test_nutation_is_measured() -> None:
    """A cone of 1.5 deg at 0.019 rad/s in the body comes back to 0.02 deg and 2 thousandths of the rate."""
    found = find("nutation", coning(math.radians(1.5), 0.019))
    assert number(found, "angle_deg") == pytest.approx(1.5, abs=0.02)
    assert number(found, "rate_rad_s") == pytest.approx(0.019, rel=2e-3)


@pytest.mark.parametrize("name", ["nutation", "spin_rate"])
def test_a_steady_turn_is_no_finding(name: str) -> None:
    """Five craft that turn steadily at the stated rate neither nutate nor change."""
    for seed in range(5):
        assert find(name, moved(turning(AXIS_BODY, AXIS_ECI, PHASE), seed=50 + seed)) is None


def test_a_despin_is_no_nutation_and_a_nutation_no_despin() -> None:
    """Each of the two keeps quiet about the other."""
    assert find("nutation", turned(PHASE - 1.25e-7 * scene().time_s ** 2)) is None
    assert find("spin_rate", coning(math.radians(1.5), 0.019)) is None


def test_the_turn_is_known_without_a_reference_vector() -> None:
    """About the stated axis, against the field itself: the rate to twice the orbit's, one phase a sample."""
    flown = replace(turned(PHASE), reference_eci_nt=None)
    found = turn_alone(flown, AXIS_BODY, RATE_RAD_S)
    assert found is not None
    assert found.rate_rad_s == pytest.approx(RATE_RAD_S, abs=found.drift_rad_s)
    assert len(found.phase_rad) == len(flown)
    assert solve_spin(flown, AXIS_BODY, RATE_RAD_S) is None


def test_no_turn_is_made_up_along_the_field() -> None:
    """Where the field stays along the stated axis nothing tells an angle."""
    still = replace(scene(), calibrated_nt=np.outer(scene().magnitude_nt, AXIS_BODY))
    assert turn_alone(still, AXIS_BODY, RATE_RAD_S) is None


def test_a_despin_shows_without_a_reference_vector_if_it_is_more_than_the_field_turns() -> None:
    """A third of the rate lost over the recording is seen; the steady craft is not taken for one."""
    change = -RATE_RAD_S / 3.0 / float(scene().time_s[-1])
    for bend, seen in ((change, True), (0.0, False)):
        flown = replace(turned(PHASE + 0.5 * bend * scene().time_s ** 2), reference_eci_nt=None)
        alone = turn_alone(flown, AXIS_BODY, RATE_RAD_S)
        finding = effect_named("spin_rate").find
        assert finding is not None
        found = finding(replace(view(flown), alone=alone, nominal_rate_rad_s=RATE_RAD_S))
        assert (found is not None) == seen
        if found is not None:
            value = found.parameters["rate_rpm_per_s"]
            assert abs(float(value.value) - change / RPM) < 3.0 * float(value.sigma)


def test_a_wide_cone_has_its_own_angle() -> None:
    """Fifteen degrees come back to 0.3; the arc tangent of sine times cosine would give 14.0."""
    cone = math.radians(15.0)
    time_s = scene().time_s
    nutation = 0.043 * time_s
    momentum = np.stack(
        [math.sin(cone) * np.cos(nutation), math.sin(cone) * np.sin(nutation), np.full(len(time_s), math.cos(cone))], 1
    )
    body_axes = momentum @ triad(AXIS_BODY)
    attitude = np.stack([one_turn(axis, angle) for axis, angle in zip(body_axes, PHASE, strict=True)])
    found = find("nutation", moved(attitude))
    assert found is not None
    value = found.parameters["angle_deg"]
    assert float(value.value) == pytest.approx(15.0, abs=0.3)


def one_turn(axis: Array, angle: float) -> Array:
    """Body from ECI (3, 3) with the fixed axis of space along ``axis`` in the body, turned by an angle about it.

    The frame across the axis is carried along without a twist of its own, so that the phase stays even.
    """
    base = triad(AXIS_BODY)
    turned_from = np.cross(base[2], axis)
    sine, cosine = float(np.linalg.norm(turned_from)), float(base[2] @ axis)
    hinge = turned_from / max(sine, 1e-12)
    cross = np.array([[0.0, -hinge[2], hinge[1]], [hinge[2], 0.0, -hinge[0]], [-hinge[1], hinge[0], 0.0]])
    carry = np.eye(3) + sine * cross + (1.0 - cosine) * cross @ cross
    return np.asarray(carry @ turning(AXIS_BODY, AXIS_ECI, np.array([angle]))[0])
