"""What a wrong clock, place or field model adds to the reference, worked out here from its equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import Places
from magcal_service.model import Array
from magcal_service.physics.effects.external_field import ring_current
from magcal_service.physics.effects.position_offset import gradients
from magcal_service.physics.effects.reference_epoch import truncated_change, yearly_change
from magcal_service.physics.interface import Hypothesis
from tests.physics.effect_forms import SPAN_S, TIME_S, added, forms
from tests.physics.scenes import COUNT, scene


def grown(form: Hypothesis, amplitudes: object, *theta: float) -> Array:
    """The growth of the magnitude (n,)."""
    return np.asarray(form.columns(np.array(theta)).growth(np.asarray(amplitudes, dtype=float).reshape(-1)))


# A wrong reference


def test_a_late_clock_sees_the_field_of_another_time() -> None:
    slope = scene().magnitude_slope
    found = forms("time_offset")
    assert grown(found["none", ""], 2.0) == pytest.approx(2.0 * slope)
    assert grown(found["none", "with drift"], [2.0, 50.0]) == pytest.approx(slope * (2.0 + 50e-6 * TIME_S))
    still = replace(scene(), magnitude_nt=np.full(COUNT, 45e3), position_ecef_km=None)
    assert all(form.needs_vectors for form in forms("time_offset", still).values())
    ahead, behind = (found["none", f"{way} the attitude"] for way in ("ahead of", "behind"))
    assert added(ahead, [0.02]) == pytest.approx(0.02 * scene().field_slope)
    assert added(behind, [0.02]) == pytest.approx(-0.02 * scene().field_slope)
    turn = np.linalg.norm(scene().field_slope) / np.linalg.norm(scene().calibrated_nt)
    assert ahead.blocks[0].most == pytest.approx(min(120.0, 0.5 / turn))
    moved, bend = replace(scene(), moved_s=np.full(COUNT, 0.1)), scene().slope(scene().field_slope)
    found_nt = added(forms("time_offset", moved)["none", "ahead of the attitude"], [0.1])
    second_nt = found_nt - 0.1 * scene().field_slope
    assert (
        np.linalg.norm(second_nt - 0.005 * bend, axis=1)[5:-5].max() < 0.2 * np.linalg.norm(0.005 * bend, axis=1).max()
    )


def magnitude(places_ecef_km: Array, times_ns: Array, degree: int = 13) -> Array:
    return np.asarray(np.linalg.norm(geomagnetic.igrf_ecef_nt(times_ns, places_ecef_km, degree), axis=1))


def test_a_wrong_place_sees_the_gradient_of_the_field() -> None:
    """Steps of 1 km outwards, along the motion in space, and to the left of it, to a hundredth of the largest."""
    assert scene().position_ecef_km is not None
    rows = scene().knots[5:-5:40]
    times_ns, here = scene().time_ns[rows], scene().position_ecef_km[rows]
    inertial = scene().position_eci_km
    assert inertial is not None
    motion = (inertial[rows + 1] - inertial[rows - 1]) / np.linalg.norm(
        inertial[rows + 1] - inertial[rows - 1], axis=1
    )[:, None]
    up = inertial[rows] / np.linalg.norm(inertial[rows], axis=1)[:, None]
    steps = {"radial": up, "along": motion, "cross": np.cross(up, motion)}
    found = gradients(scene())
    for name, step in steps.items():
        there = geomagnetic.ecef_from_eci(times_ns, inertial[rows] + step)
        growth = magnitude(there, times_ns) - magnitude(here, times_ns)
        assert np.abs(found[name][rows] - growth).max() < 0.02 * np.abs(growth).max(), name


def test_geodetic_latitude_and_height_read_as_geocentric() -> None:
    """At 45 deg and 500 km the place read is 4 km further out and 0.19 deg further north; the whole of it, or none."""
    form = forms("position_offset")["none", "geodetic as geocentric"]
    assert form.is_whole
    knots = scene().knots
    assert scene().position_ecef_km is not None
    place = scene().position_ecef_km[knots]
    radius = np.linalg.norm(place, axis=1)
    flat = 1.0 / 298.257223563
    sine = place[:, 2] / radius
    north_rad = flat * 2.0 * sine * np.sqrt(1.0 - sine**2) * 6378.137 / radius  # to first order in the flattening
    further_km = 6371.2 - 6378.137 * (1.0 - flat * sine**2)
    meridian = np.stack([-place[:, 0] * sine, -place[:, 1] * sine, radius * (1.0 - sine**2)], axis=1)
    meridian /= np.linalg.norm(meridian, axis=1)[:, None]
    read = place + north_rad[:, None] * radius[:, None] * meridian + (further_km / radius)[:, None] * place
    expected = scene().model_magnitude(Places(place)) - scene().model_magnitude(Places(read))
    assert grown(form, [1.0])[knots] == pytest.approx(expected, abs=0.03 * np.abs(expected).max())


def test_the_forms_of_a_wrong_place_are_sums_of_gradients() -> None:
    g, hours = gradients(scene()), TIME_S / 3600.0
    found = forms("position_offset")
    cases: dict[str, tuple[list[float], Array]] = {
        "radial": ([2.0], 2.0 * g["radial"]),
        "along": ([3.0], 3.0 * g["along"]),
        "cross": ([4.0], 4.0 * g["cross"]),
        "radial and along": ([2.0, 3.0], 2.0 * g["radial"] + 3.0 * g["along"]),
        "three axes": ([2.0, 3.0, 4.0], 2.0 * g["radial"] + 3.0 * g["along"] + 4.0 * g["cross"]),
        "along, growing": ([3.0, 5.0], g["along"] * (3.0 + 5.0 * hours)),
        "along, growing faster": ([3.0, 5.0, 6.0], g["along"] * (3.0 + 5.0 * hours + 6.0 * hours**2)),
        "three axes, growing along": (
            [2.0, 3.0, 4.0, 5.0],
            2.0 * g["radial"] + 4.0 * g["cross"] + g["along"] * (3.0 + 5.0 * hours),
        ),
    }
    for variant, (amplitudes, expected) in cases.items():
        assert grown(found["none", variant], amplitudes) == pytest.approx(expected), variant
        assert found["none", variant].largest_nt == 3000.0
    units = {block.name: block.unit for form in found.values() for block in form.blocks}
    assert units["along_km_per_h2"] == "km/h2"
    assert units["radial_km"] == "km"


def test_without_a_model_a_place_further_out_sees_a_dipole() -> None:
    """|H| falls with the cube of the distance."""
    assert scene().position_ecef_km is not None
    clock = replace(scene(), utc=False)
    radius = np.linalg.norm(scene().position_ecef_km, axis=1)
    expected = scene().magnitude_nt * ((1.0 + 1e-4 / radius) ** -3 - 1.0) / 1e-4
    assert grown(forms("position_offset", clock)["none", "radial, dipole"], 1.0) == pytest.approx(expected, rel=1e-3)
    assert forms("position_offset", replace(clock, position_ecef_km=None)) == {}


def test_old_coefficients_lag_by_a_years_change() -> None:
    """A fifth of what five years have changed; a series cut short lacks what its terms above hold."""
    assert scene().position_ecef_km is not None
    rows = scene().knots[::40]
    times_ns, places = scene().time_ns[rows], scene().position_ecef_km[rows]
    five_years = round(5 * 365.25 * 86400 * 1e9)
    change = (magnitude(places, times_ns) - magnitude(places, times_ns - five_years)) / 5.0
    assert yearly_change(scene())[rows] == pytest.approx(change, abs=1e-6)
    assert grown(forms("reference_epoch")["none", ""], 3.0)[rows] == pytest.approx(3.0 * change, abs=1e-5)
    for age in (10.0, 21.0):  # between the ages at which it is computed, straight
        step = 2.5 * (age // 2.5)
        before, after = (
            magnitude(places, times_ns) - magnitude(places, times_ns - round(one * 365.25 * 86400 * 1e9))
            for one in (step, step + 2.5)
        )
        share = (age - step) / 2.5
        found = grown(forms("reference_epoch")["none", "by decades"], 20.0, age)[rows]
        assert grown(forms("reference_epoch")["none", "by decades"], 40.0, 400.0)[rows] == pytest.approx(
            magnitude(places, times_ns) - magnitude(places, times_ns - round(40.0 * 365.25 * 86400 * 1e9)), abs=1e-3
        )
        assert found == pytest.approx(20.0 / age * ((1.0 - share) * before + share * after), abs=1e-5)
    cut = magnitude(places, times_ns) - magnitude(places, times_ns, 6)
    assert truncated_change(scene(), 6)[rows] == pytest.approx(cut, abs=1e-6)
    form = forms("reference_epoch")["none", "degree 6"]
    assert form.constants == {"degree": 6.0}
    assert grown(form, 0.5)[rows] == pytest.approx(0.5 * cut, abs=1e-6)


def test_a_model_with_a_degree_gets_that_form_alone_and_one_without_the_years() -> None:
    def variants(given: Mapping[str, float] | None) -> list[str]:
        return [variant for _, variant in forms("reference_epoch", replace(scene(), given=given))]

    assert variants({"degree": 7.0}) == ["degree 7"]
    assert variants({}) == ["", "by decades"]
    assert variants(None) == ["", "by decades", *(f"degree {degree}" for degree in range(1, 13))]


def test_the_ring_current_adds_along_the_dipoles_axis_with_what_it_induces() -> None:
    """A uniform field, and 0.27 of it as a dipole's at the ground's equator, falling with r^3 (Olsen 2006).

    Its induced part adds at the equator and takes away over the pole: what conducts lets less through its surface.
    """
    assert scene().dipole_eci is not None
    assert scene().position_eci_km is not None
    assert scene().reference_eci_nt is not None
    found = ring_current(scene())
    assert found is not None
    axis, place = scene().dipole_eci, scene().position_eci_km
    radius = np.linalg.norm(place, axis=1)[:, None]
    # potential: -(m . r) of the ring and -0.27 a^3 (m . r) / r^3 of what it induces; the field is minus the gradient
    up = place / radius
    along = np.einsum("ni,ni->n", axis, up)[:, None]
    outward = (1.0 - 2.0 * 0.27 * (6371.2 / radius) ** 3) * along
    tangential = (1.0 + 0.27 * (6371.2 / radius) ** 3) * (axis - along * up)
    direction = scene().reference_eci_nt / scene().magnitude_nt[:, None]
    assert found == pytest.approx(np.einsum("ni,ni->n", outward * up + tangential, direction))
    nowhere = ring_current(replace(scene(), position_ecef_km=None))
    assert nowhere == pytest.approx(np.einsum("ni,ni->n", axis, direction))
    assert ring_current(replace(scene(), reference_eci_nt=None)) is None
    placeless = forms("external_field", replace(scene(), position_ecef_km=None))
    assert {variant.split(",")[0] for _, variant in placeless} == {"uniform"}


def test_a_storm_is_a_polynomial_in_time_that_ends_with_its_recording() -> None:
    """Legendre's polynomials over the recording; applied beyond it, the ends hold."""
    found = forms("external_field")
    ring = ring_current(scene())
    assert ring is not None
    middle, span = float(TIME_S.mean()), SPAN_S
    t = (TIME_S - middle) / span * 2.0
    legendre = [np.ones(COUNT), t, (3 * t**2 - 1) / 2, (5 * t**3 - 3 * t) / 2, (35 * t**4 - 30 * t**2 + 3) / 8]
    for variant, order in (("", 0), ("changing", 1), ("curved", 2), ("storm", 4)):
        amplitudes = np.arange(1.0, order + 2.0)
        expected = ring * sum(a * p for a, p in zip(amplitudes, legendre[: order + 1], strict=True))
        assert grown(found["none", variant], amplitudes) == pytest.approx(expected), variant
        course = {"middle_s": middle, "span_s": span} if order else {}
        assert found["none", variant].constants == {**course, "induced": 0.27}
    axis = scene().dipole_eci
    assert axis is not None
    assert scene().reference_eci_nt is not None
    bare = np.einsum("ni,ni->n", axis, scene().reference_eci_nt) / scene().magnitude_nt
    assert grown(found["none", "uniform, changing"], [1.0, 2.0]) == pytest.approx(bare * (1.0 + 2.0 * t))
    given = forms("external_field", replace(scene(), given={"middle_s": 1000.0, "span_s": 2000.0}))
    share = np.clip((TIME_S - 1000.0) / 1000.0, -1.0, 1.0)
    assert grown(given["none", "changing"], [1.0, 1.0]) == pytest.approx(ring * (1.0 + share))
