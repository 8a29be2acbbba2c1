"""Flights with something wrong: what is sent, what is counted, and the study over two scenarios."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import d_matrix, field_jacobian
from magcal_service.studies import integrity
from magcal_service.studies.study import Request
from magcal_service.studies.unseen import flight as flight_module
from magcal_service.studies.unseen import scenarios
from magcal_service.studies.unseen.flight import Heard, Sent, begin, hear
from magcal_service.studies.unseen.motion import SPIN_RPM, Motion
from magcal_service.studies.unseen.scenarios import SCENARIOS, Group
from magcal_service.studies.unseen.score import EDGES_NT, Asked, scored
from magcal_service.wire.messages import CalibratedVector, Estimate
from tests.many.here import HERE

pytest.importorskip("ppigrf")

SHORT_S = 120


def sent(motion: Motion = Motion.SPIN) -> Sent:
    return begin(motion, 10.0, SHORT_S, np.random.SeedSequence(3))


def asked(scenario: str, noise_nt: float) -> Asked:
    return Asked(scenario, "spin", noise_nt, 10, (1,))


def heard(**changes: object) -> Heard:
    """Ten seconds: trusted from the third on, 60 nT off from the sixth, doubtful in the last two."""
    time_s = np.arange(10.0)
    made = Heard(
        time_s=time_s,
        error_nt=np.where(time_s < 5.0, 10.0, 60.0),
        sigma_nt=np.full(10, 4.0),
        protection_nt=np.full(10, 30.0),
        trusted=(time_s >= 2.0) & (time_s < 8.0),
        doubt_s=np.array([8.0, 9.0]),
        bias_sigma_nt=np.full(10, 5.0),
        reasons={"drifting_residual": 1, "model_doubtful": 5},
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def test_seconds_are_counted_while_trusted() -> None:
    """Three of six trusted ones are 60 nT off: beyond 50 nT and five of 4 nT; protection of 30 and four sigma is 46."""
    found = scored(heard(), since_s=5.0)
    assert (found.heard_s, found.trusted_s, found.wrong_s, found.misled_s, found.unprotected_s) == (10, 6, 3, 3, 0)
    assert (found.worst_nt, found.worst_beyond_nt, found.trusted_at_s, found.alarm_s) == (60.0, 14.0, 2.0, 3.0)
    assert found.near_ratio == pytest.approx(np.median([3.0, 3.0, 3.0, 0.5, 0.5, 0.5]))
    assert found.reasons == ["model_doubtful", "drifting_residual"]
    counted = np.array(found.diagram)
    assert counted.sum() == 6.0
    (rows, columns) = np.nonzero(counted)
    assert all(EDGES_NT[row] <= error <= EDGES_NT[row + 1] for row, error in zip(rows, (10.0, 60.0), strict=True))
    assert set(columns) == {int(np.searchsorted(EDGES_NT, 30.0)) - 1}


@pytest.mark.parametrize(
    ("changes", "wrong_s", "misled_s", "unprotected_s"),
    [
        ({"sigma_nt": np.full(10, 13.0)}, 0.0, 0.0, 0.0),  # within five and within four sigma
        ({"protection_nt": np.full(10, 50.0)}, 3.0, 0.0, 0.0),
        ({"protection_nt": np.full(10, np.nan)}, 3.0, 0.0, 6.0),
        ({"trusted": np.zeros(10, dtype=bool)}, 0.0, 0.0, 0.0),
    ],
)
def test_what_is_wrong_and_what_misleads(
    changes: dict[str, object], wrong_s: float, misled_s: float, unprotected_s: float
) -> None:
    found = scored(heard(**changes), since_s=5.0)
    assert (found.wrong_s, found.misled_s, found.unprotected_s) == (wrong_s, misled_s, unprotected_s)


def test_a_clean_flight_has_no_alarm_and_a_pause_counts_for_five_seconds() -> None:
    paused = heard(time_s=np.array([0.0, 1, 2, 3, 4, 100, 101, 102, 103, 104]))
    found = scored(paused, since_s=math.inf)
    assert math.isnan(found.alarm_s)
    assert found.heard_s == 9 + 5


def test_rates_are_of_the_time_with_a_protection_level_and_a_flight_counts_once() -> None:
    """Two flights misled for 3 s each, of 6 s trusted; a third has no level: 2 events of 12 s; 6.2958 at 95 %."""
    bare = scored(heard(protection_nt=np.full(10, np.nan)), since_s=5.0)
    made = [(asked("step_200", 20.0), scored(heard(), since_s=5.0))] * 2 + [(asked("step_200", 100.0), bare)]
    figures = integrity._figures(made, 3)
    assert figures["trusted [s]"] == 18.0
    assert figures["trusted with a protection level [s]"] == 12.0
    assert figures["flights that misled, per second of that time"] == 2 / 12
    assert figures["the same, at most (95%)"] == pytest.approx(6.2958 / 12, abs=1e-4)
    assert figures["flights that misled against the promise"] == 2
    beyond = integrity._figures([(asked("step_1000", 20.0), scored(heard(), since_s=5.0))], 1)
    assert beyond["flights that misled"] == 1
    assert beyond["flights that misled against the promise"] == 0


def test_a_warning_is_told_by_noise_with_how_many_came() -> None:
    late = scored(heard(doubt_s=np.array([480.0])), since_s=0.0)
    never = scored(heard(doubt_s=np.zeros(0)), since_s=0.0)
    made = [(asked("step_200", 20.0), late), (asked("step_200", 20.0), never), (asked("step_200", 100.0), never)]
    table = integrity.warnings([*made, (asked("clean", 20.0), never)])
    assert table.columns[2:] == ("20 nT of noise", "100 nT of noise")
    assert [row[2:] for row in table.rows] == [("8 in 1 of 2", "not, of 1")]


@pytest.mark.parametrize(("events", "limit"), [(0, 2.9957), (1, 4.7439), (5, 10.5130)])
def test_the_upper_limit_is_that_of_a_poisson_law(events: int, limit: float) -> None:
    """Half of the quantile of chi square with 2 (k + 1) degrees of freedom: tables, e.g. PDG 2022, table 40.3."""
    assert integrity.upper_limit(events) == pytest.approx(limit, abs=1e-3)


@pytest.mark.parametrize("motion", list(Motion))
def test_the_field_in_the_body_is_the_reference_turned(motion: Motion) -> None:
    flight = sent(motion)
    lengths = np.linalg.norm(flight.reference_nt, axis=1)
    assert np.linalg.norm(flight.field_nt, axis=1) == pytest.approx(lengths)
    assert np.all((lengths > 18_000.0) & (lengths < 60_000.0))
    turns = flight.track.body_from_eci
    assert np.einsum("nij,nkj->nik", turns, turns) == pytest.approx(np.broadcast_to(np.eye(3), turns.shape), abs=1e-12)


def test_a_spin_turns_about_its_axis_by_its_rate() -> None:
    """B across the axis goes round -3 times a minute in the body of a craft that turns by +3 rpm."""
    across = sent().field_nt[:, :2] @ np.array([1.0, 1.0j])
    turned = np.angle(across[1:] / across[:-1])
    assert turned == pytest.approx(-SPIN_RPM * 2.0 * np.pi / 60.0, abs=2e-3)


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_a_scenario_changes_what_is_sent(name: str) -> None:
    """Each but the clean one changes something, and none what the vector should be."""
    clean, spoiled = sent(), sent()
    SCENARIOS[name].spoil(spoiled)
    assert np.array_equal(clean.field_nt, spoiled.field_nt)
    assert np.array_equal(clean.x, spoiled.x)
    arrays = ("disturbance_nt", "gain", "noise", "reference_nt", "reference_sent", "sample_sent", "sample_ns")
    changed = any(not np.array_equal(getattr(clean, one), getattr(spoiled, one)) for one in arrays)
    changed |= bool(spoiled.post) or spoiled.step_nt > 0.0 or spoiled.config != clean.config
    assert changed == (name != "clean")


def test_a_warmth_follows_light_by_twenty_minutes() -> None:
    """From 0.6 in light, a third of the way to 1 is gone after 487 s: 1200 s times the logarithm of 3 / 2."""
    flight = begin(Motion.TUMBLE, 10.0, 600, np.random.SeedSequence(3))
    SCENARIOS["heat_1000"].spoil(flight)
    warm = np.linalg.norm(flight.disturbance_nt, axis=1) / np.linalg.norm([0.6, -0.48, 0.64])
    assert warm[[0, 486]] == pytest.approx([600.0, 733.4], abs=0.5)


def test_the_study_sums_up_what_its_flights_come_to() -> None:
    few = ("clean", "scaled_5")
    request = Request(2, 1, HERE, duration_s=400, scenarios=few, noises_nt=(100.0,), motions=("spin",))
    findings = integrity.run(request)
    assert findings.figures["flights"] == 4
    assert [row[0] for row in findings.tables[1].rows] == list(few)
    parts = {row[0]: row[1] for row in findings.tables[0].rows}
    assert parts == {
        "clean": 2, "what protection promises to hold": 2, "all that can be seen": 2, "what nothing can show": 2,
    }  # fmt: skip
    assert {scenarios.SCENARIOS[name].group for name in few} == {Group.CLEAN, Group.REFERENCE}


def test_the_cells_of_the_diagram_are_the_classes_with_time_in_them() -> None:
    seconds = np.zeros((len(EDGES_NT) - 1,) * 2)
    seconds[3, 7] = 60.0
    assert integrity._cells(seconds) == ((*EDGES_NT[3:5], *EDGES_NT[7:9], 60.0),)


def test_a_motion_alone_flies_what_it_flies_among_all(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: dict[tuple[str, ...], list[Asked]] = {}
    for motions in (("tumble",), ()):
        taken: list[Asked] = []
        monkeypatch.setattr(integrity, "fly", lambda one, into=taken: into.append(one) or scored(heard(), math.inf))
        integrity.run(Request(1, 1, HERE, 400, scenarios=("clean", "wrong_sense"), noises_nt=(100.0,), motions=motions))
        flown[motions] = taken
    assert flown[("tumble",)] == [one for one in flown[()] if one.motion == "tumble"]
    assert [one.scenario for one in flown[("tumble",)]] == ["clean"]


@pytest.mark.parametrize("motion", ["spin", "nadir"])
def test_errors_are_those_of_each_answer_with_its_own_estimate(motion: str) -> None:
    """Of a whole flight in blocks, against equation (5) and its sigma for one answer after the other."""
    flight = begin(Motion(motion), 100.0, 1500, np.random.SeedSequence(8))
    measured, noisefree = flight.readings(flight.noise), flight.readings(np.zeros_like(flight.noise))
    pipeline, rows, latest = Pipeline(flight.config), [], None
    for index, time_ns in enumerate(flight.track.time_ns.tolist()):
        pipeline.handle(flight_module._reference(index, time_ns, flight.reference_nt[index]))
        for message in pipeline.handle(flight_module._sample(index, time_ns, measured[index])):
            if isinstance(message, CalibratedVector) and latest is not None:
                gain = np.eye(3) + d_matrix(np.array([0.0, 0.0, 0.0, *latest.D]))
                noise = gain @ (measured[index] - noisefree[index])
                error = np.array(message.field_body_nt) - noise - flight.field_nt[index]
                size = np.linalg.norm(error)
                upper = np.zeros((9, 9))
                upper[np.triu_indices(9)] = latest.covariance
                covariance = upper + np.triu(upper, 1).T
                along = field_jacobian(noisefree[index]).T @ error / size
                rows.append((size, np.sqrt(along @ covariance @ along), np.sqrt(np.diagonal(covariance)[:3].max())))
            elif isinstance(message, Estimate):
                latest = message
    found = hear(flight)
    known = np.isfinite(found.error_nt)
    assert known.sum() == len(rows) > 1024
    columns = np.stack([found.error_nt, found.sigma_nt, found.bias_sigma_nt], axis=1)[known]
    assert columns == pytest.approx(np.array(rows), rel=1e-9, abs=1e-6)
