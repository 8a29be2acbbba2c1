"""A diagnosis of torquers on a beat that nobody recorded: named, their rows left out, the nine errors right between."""

from __future__ import annotations

from functools import cache

import numpy as np

from magcal_service import Recording
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict, diagnose
from magcal_service.diagnosis.result import entries, held_out_rms
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.summary import summary
from magcal_service.earth import geomagnetic
from magcal_service.model import measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import ORIGIN_NS, X, orbit_eci_km

COUNT, NOISE_NT, CYCLE_S = 4800, 80.0, 60.0


@cache
def diagnosed(size_nt: float = 250.0, coils: int = 3) -> Diagnosis:
    """A tumbling craft whose coils are on for a quarter of each minute, with a new dipole each time."""
    rng = np.random.default_rng(21)
    time_s = np.arange(COUNT) * 1.0
    time_ns = ORIGIN_NS + np.rint(time_s * 1e9).astype(np.int64)
    place = orbit_eci_km(time_s)
    reference = geomagnetic.igrf_eci_nt(time_ns, place)
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    angle = time_s / 1.7
    first = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    second = np.stack(
        [-np.sin(angle) * np.cos(angle / 7.0), np.cos(angle) * np.cos(angle / 7.0), np.sin(angle / 7.0)], 1
    )
    attitude = np.stack([first, second, np.cross(first, second)], axis=1) @ turn
    body = np.einsum("nij,nj->ni", attitude, reference)
    on = time_s % CYCLE_S < 0.25 * CYCLE_S
    fields = rng.normal(0.0, size_nt, (COUNT // int(CYCLE_S), 3))[(time_s // CYCLE_S).astype(int)]
    fields[:, coils:] = 0.0
    field = measure(X, body + on[:, None] * fields + rng.normal(0.0, NOISE_NT, body.shape))
    recording = Recording.from_arrays(
        time_ns.astype("datetime64[ns]"),
        field,
        reference,
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, place),
        noise_nt=NOISE_NT,
    )
    return diagnose(recording, effects=tuple(effect_named(name) for name in ("torquer", "bias_step", "tone")))


def test_the_torquer_is_named_and_something_is_left_to_doubt() -> None:
    assert diagnosed().verdict is Verdict.NAMED
    assert diagnosed().trusted
    (entry,) = entries(diagnosed())
    assert (entry.effect, entry.driver, entry.probability) == ("torquer", "inferred:pulses", 0.97)
    assert entry.parameters["period_s"].value == CYCLE_S
    assert "fire every 60.0" in entry.says


def test_faint_pulses_that_no_family_of_courses_shows_are_found_too() -> None:
    """60 nT beside 80 nT of noise, each pulse in a direction of its own."""
    (entry,) = entries(diagnosed(60.0))
    assert (entry.effect, entry.driver) == ("torquer", "inferred:pulses")
    assert entry.parameters["period_s"].value == CYCLE_S


def test_pulses_that_may_all_lie_in_one_direction_are_named_and_not_acted_on() -> None:
    """A wheel's motor has a current of both signs, too."""
    found = diagnosed(coils=1)
    assert found.verdict is Verdict.NAMED
    assert (entries(found)[0].effect, entries(found)[0].probability) == ("torquer", 0.94)
    assert found.reasons == ("name_uncertain",)
    assert found.concerned["name_uncertain"] == ("torquer",)


def test_what_pulses_may_be_instead_and_what_would_tell_are_said() -> None:
    """As of every other name: in the JSON, in the headline where the name is open, and on the terminal."""
    sure, open_one = (entries(diagnosed(coils=coils))[0] for coils in (3, 1))
    assert sure.rivals == (("unknown", 0.03),)
    assert open_one.rivals == (("current_loop", 0.03), ("unknown", 0.03))
    for entry in (sure, open_one):
        assert [one.against for one in entry.measure] == [name for name, _ in entry.rivals]
        assert all(one.do == "switch off the torquers and record as long again" for one in entry.measure)
        assert all(one.nats > 12.0 for one in entry.measure)
    content = open_one.as_json()
    assert content["rivals"] == [{"effect": name, "probability": 0.03} for name in ("current_loop", "unknown")]
    held_out = held_out_rms(diagnosed(coils=1))
    told = " ".join(" ".join(summary(diagnosed(coils=1), [open_one], held_out, [])).split())
    assert "The name is open: 94 % torquer (magnetic torquers); 3 % current_loop; or 3 % something that is in" in told
    assert "what would tell: switch off the torquers and record as long again (" in told
    told = " ".join(" ".join(summary(diagnosed(), [sure], held_out, [])).split())
    assert "97 % that it is this rather than a rival" in told


def test_the_rows_of_the_pulses_are_accounted_for() -> None:
    account = account_of(diagnosed().inspection, diagnosed().prepared)
    assert COUNT // 4 <= account.left_out["in_pulses"] < 0.4 * COUNT
    assert account.used == len(diagnosed().prepared.recording) == COUNT - account.left_out["in_pulses"]
    assert str(account).endswith("within pulses that nobody recorded, as named")


def test_between_the_pulses_the_nine_errors_are_right() -> None:
    fit = diagnosed().fit
    sigma = np.sqrt(np.diag(fit.covariance)[:9])
    assert np.all(np.abs(fit.x[:9] - X) < 4.0 * sigma)
    assert fit.rms_nt < 1.05 * NOISE_NT
