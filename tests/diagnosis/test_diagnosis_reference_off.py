"""A reference vector that is off by the same all the time, in axes of its own: found with its sigma, and no physics."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.diagnosis.aimed import Aimed
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict, diagnose
from magcal_service.diagnosis.offset import Offset
from magcal_service.diagnosis.prepare import Form
from magcal_service.diagnosis.reference_off import ReferenceOff, reference_off_of
from magcal_service.earth.geomagnetic import ecef_from_geodetic, ecef_from_ned, eci_from_ecef
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.recording import Recording
from tests.diagnosis.turntable import Bench, course, turned

OFF_NT = np.array([180.0, -120.0, 90.0])
STEADY_NT = np.array([20e3, -1e3, 30e3])
BIAS_NT = np.array([1500.0, -900.0, 700.0])


def off_of(found: Diagnosis) -> ReferenceOff:
    """What a diagnosis by whole vectors says of the reference."""
    assert found.prepared.form is Form.AIMED
    off = reference_off_of(found.fit)
    assert off is not None
    return off


@pytest.mark.parametrize(("seed", "size"), [(40, 0.3), (41, 1.0), (42, 4.0)])
def test_a_reference_that_is_off_is_found_with_its_sigma_and_is_no_physics(seed: int, size: float) -> None:
    """It was structure without a name, or vectors were not believed; the bias is true beside it."""
    found = diagnose(Bench(seed, with_attitude=True, reference_off_nt=size * OFF_NT).recording())
    off = off_of(found)
    assert (found.verdict, found.trusted, off.is_certain) == (Verdict.NONE, True, True)
    assert np.abs((off.off_nt - size * OFF_NT) / off.sigma_nt).max() < 4.0
    assert off.sigma_nt.max() < 12.0
    sigma = np.sqrt(np.diagonal(found.fit.covariance)[:3])
    assert np.abs((found.fit.x[:3] - BIAS_NT) / sigma).max() < 4.0


def test_it_is_said_in_the_verdict_s_words_and_in_the_json() -> None:
    found = diagnose(Bench(41, with_attitude=True, reference_off_nt=OFF_NT).recording())
    content = json.loads(as_json(found))
    assert "The reference vector is off by (" in content["sentence"]
    assert "in its own frame (eci)" in content["sentence"]
    assert content["reference_off"]["is_certain"]
    assert content["reference_off"]["off_nt"] == pytest.approx(OFF_NT.tolist(), abs=25.0)


def test_a_reference_as_stated_is_not_said_to_be_off() -> None:
    found = diagnose(Bench(43, with_attitude=True).recording())
    off = off_of(found)
    assert not off.is_certain
    assert "is off by" not in json.loads(as_json(found))["sentence"]


def test_in_a_steady_field_only_what_is_across_it_is_seen() -> None:
    """Along the field it is a gain of all axes, and the reference is as stated: the gain's sigma stays small."""
    found = diagnose(Bench(44, with_attitude=True, steady=True, reference_off_nt=OFF_NT).recording())
    off = off_of(found)
    along = STEADY_NT / np.linalg.norm(STEADY_NT)
    assert found.verdict is Verdict.NONE
    assert off.seen.shape == (3, 2)
    assert np.abs(along @ off.seen).max() < 0.02
    assert off.off_nt == pytest.approx(OFF_NT - along * float(along @ OFF_NT), abs=25.0)
    assert f"across ({along[0]:.2f}," in str(off)
    assert np.sqrt(np.diagonal(found.fit.covariance)[3:6]).max() < 1e-3


def test_a_body_that_does_not_turn_shows_nothing_of_it() -> None:
    """There it is a bias, which stays as sure as it is."""
    found = diagnose(Bench(45, with_attitude=True, is_still=True, reference_off_nt=OFF_NT).recording())
    assert found.prepared.form is Form.AIMED
    assert reference_off_of(found.fit) is None


def test_heat_is_named_beside_a_reference_that_is_off() -> None:
    """With as much certainty as beside one that is not."""
    bench = Bench(46, with_attitude=True, reference_off_nt=2.0 * OFF_NT)
    warm = course(np.random.default_rng(461), bench.time_s)
    bench.channels = {"temperature": (20.0 + 5.0 * warm, "degC")}
    bench.added_nt = np.outer(5.0 * warm, [20.0, -10.0, 15.0])
    found = diagnose(bench.recording())
    (term,) = found.fit.terms
    assert (term.hypothesis.effect, found.trusted) == ("thermal_bias", True)
    assert np.abs(term.amplitudes - [20.0, -10.0, 15.0]).max() < 2.0
    assert off_of(found).off_nt == pytest.approx(2.0 * OFF_NT, abs=25.0)


def test_on_the_ground_it_stays_north_east_and_down_while_the_earth_turns() -> None:
    """Over two hours, beside an attitude in inertial axes, which turn by 30 degrees meanwhile."""
    bench = Bench(47, with_attitude=True)
    inertial = bench.recording()
    time_ns = 1_700_000_000_000_000_000 + 4 * inertial.time_ns
    place = np.tile(ecef_from_geodetic(np.array([40.0]), np.array([33.0]), np.array([0.9])), (bench.count, 1))
    latitude, longitude = np.full(bench.count, 40.0), np.full(bench.count, 33.0)
    local = np.stack(
        [20e3 + 5e3 * np.sin(bench.time_s / 300.0), 0.0 * bench.time_s - 9e3, 0.0 * bench.time_s + 30e3], 1
    )
    field = eci_from_ecef(time_ns, ecef_from_ned(latitude, longitude, local + OFF_NT))
    attitude = inertial.channels["attitude"].values
    made = Recording.from_arrays(
        time=time_ns.astype("datetime64[ns]"),
        B=turned(attitude, field) + np.random.default_rng(471).normal(0.0, 100.0, (bench.count, 3)),
        H=local,
        frame="ned",
        position_ecef_km=place,
        noise_nt=100.0,
        attitude=attitude,
    )
    found = diagnose(made)
    off = off_of(found)
    assert (found.verdict, off.axes) == (Verdict.NONE, Axes.NED)
    assert np.abs(off.seen.T @ (off.off_nt - OFF_NT)).max() < 25.0


def test_derivatives_by_turn_and_offset_are_those_of_the_target() -> None:
    rng = np.random.default_rng(462)
    turns = Rotation.random(6, random_state=7).as_matrix()
    offset = Offset(turns, Axes.NED, 500.0, np.linalg.qr(rng.normal(size=(3, 2)))[0])
    aimed = Aimed(rng.normal(0.0, 3e4, (6, 3)), np.eye(3), offset=offset)
    unknowns = np.array([0.2, -0.3, 0.1, 150.0, -400.0])
    assert aimed.size == 5
    assert aimed.tie == pytest.approx([0.0, 0.0, 0.0, 4e-6, 4e-6])
    for number, step in enumerate([1e-6, 1e-6, 1e-6, 1.0, 1.0]):
        moved = step * np.eye(5)[number]
        numeric = (aimed.turned(unknowns + moved) - aimed.turned(unknowns - moved)) / (2.0 * step)
        assert aimed.slopes(unknowns)[:, :, number] == pytest.approx(numeric, abs=1e-4)


def test_a_part_and_a_continuation_keep_the_offset_s_columns() -> None:
    turns = Rotation.random(4, random_state=8).as_matrix()
    aimed = Aimed(np.ones((4, 3)), np.eye(3), offset=Offset(turns, Axes.NED, 500.0, np.eye(3)))
    first = aimed.part(2).offset
    assert first is not None
    assert first.columns == pytest.approx(turns[:2])
    longer = aimed.continued(turns).offset
    assert longer is not None
    assert longer.columns == pytest.approx(np.concatenate([turns, turns @ turns]))


def test_a_reference_that_is_too_far_off_is_not_acted_on() -> None:
    """Magnitudes agree as well with gains that are all off by what the field is stronger than stated."""
    found = diagnose(Bench(45, with_attitude=True, reference_off_nt=np.array([2500.0, -1500.0, 800.0])).recording())
    assert (found.prepared.form, found.refused) == (Form.SCALAR, (Form.AIMED,))
    assert "reference_far_off" in found.reasons
    assert not found.trusted


def test_an_attitude_in_turned_axes_is_no_reference_that_is_off() -> None:
    """By 15 degrees it would have to be off by thousands of nT, which the nine errors follow: magnitudes are taken."""
    apart = Rotation.from_euler("z", 15.0, degrees=True).apply(STEADY_NT) - STEADY_NT
    found = diagnose(Bench(44, with_attitude=True, steady=True, reference_off_nt=apart).recording())
    assert (found.verdict, found.prepared.form, found.refused) == (Verdict.NONE, Form.SCALAR, (Form.AIMED,))
    sigma = np.sqrt(np.diagonal(found.fit.covariance)[:3])
    assert np.abs((found.fit.x[:3] - BIAS_NT) / sigma).max() < 4.0
