"""The search for the largest size of a hazard that is not seen, and what is given to a flight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from magcal_service.studies.unseen.flight import Heard, Sent, begin, hear
from magcal_service.studies.unseen.motion import Motion
from magcal_service.trust.hazards import Hazard
from tests.benchmarks.just_below import GIVEN, STEP_S, Case, Flight, medians, new_step_row, row_of, search

pytest.importorskip("ppigrf")

DURATION_S = 6000


def sent() -> Sent:
    return begin(Motion.SPIN, 10.0, DURATION_S, np.random.SeedSequence(3))


@dataclass(frozen=True, slots=True)
class Seen(Case):
    """Seen beyond a share of the largest size, by the protector or, where ``blind``, by something else."""

    share: float = 0.1
    blind: bool = False

    def fly(self, size: float) -> Flight:
        evidence = (size / self.share / self.largest()) ** 2
        time_s = np.array([0.0, 1.0])
        heard = Heard(
            time_s=time_s,
            error_nt=np.array([size, 2.0 * size]),
            sigma_nt=np.zeros(2),
            protection_nt=np.array([6.0 * size, 4.0 * size]),
            trusted=np.array([True, True]),
            bias_sigma_nt=np.zeros(2),
            doubt_s=np.zeros(0),
            reasons={},
        )
        own_nt, shown = 3.0 * heard.error_nt, np.array([0.0, 0.0 if self.blind else evidence])
        return Flight(size, math.nan if evidence < 1.0 else 5.0, shown, own_nt, heard, heard.trusted)


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.parametrize("share", [0.003, 0.02, 0.5, 0.95])
def test_the_largest_unseen_size_is_found_to_a_tenth(share: float, blind: bool) -> None:
    found = search(Seen(Hazard.BIAS_DRIFT, Motion.SPIN, 100.0, share=share, blind=blind))
    assert found is not None
    assert not row_of(found)["bounded"]
    assert share / 1.11 < found.unseen.size / found.largest < share


def test_what_is_not_seen_at_its_largest_is_told_apart_and_is_in_no_median() -> None:
    bounded = search(Seen(Hazard.BIAS_DRIFT, Motion.SPIN, 100.0, share=2.0))
    seen = search(Seen(Hazard.BIAS_DRIFT, Motion.TUMBLE, 100.0, share=0.1))
    assert bounded is not None
    assert seen is not None
    assert row_of(bounded)["bounded"]
    assert row_of(bounded)["unseen"] == 1000.0
    assert medians([row_of(bounded), row_of(seen)]) == {
        "searches": 2,
        "limited by detection": 1,
        "level over error": pytest.approx(4.0),
        "level over error, just below the alarm": pytest.approx(2.0),
        "level for this hazard over error": pytest.approx(3.0),
        "level for this hazard over error, just below the alarm": pytest.approx(3.0),
    }


def test_a_reference_is_late_by_seconds_and_parts_of_one() -> None:
    clean, late = sent(), sent()
    GIVEN[Hazard.REFERENCE_LATE].spoil(late, 10.5)
    between = 0.5 * (clean.reference_nt[89] + clean.reference_nt[90])
    np.testing.assert_allclose(late.reference_nt[100], between, rtol=0.0, atol=1e-9)
    assert late.reference_sent.tolist()[9:12] == [False, False, True]


@pytest.mark.parametrize("hazard", [Hazard.BIAS_STEP, Hazard.ORBIT_BIAS, Hazard.PANEL_CURRENT])
def test_a_field_swings_by_its_size(hazard: Hazard) -> None:
    flight = sent()
    GIVEN[hazard].spoil(flight, 100.0)
    length = np.linalg.norm(flight.disturbance_nt, axis=1)
    assert length.min() == pytest.approx(0.0, abs=0.5)
    assert 80.0 < length.max() <= 100.0 + 1e-9
    assert hazard is not Hazard.BIAS_STEP or length[int(STEP_S) - 1] == 0.0


def test_a_flight_ends_where_it_is_asked_to() -> None:
    asked: list[float] = []

    def ends(time_s: float, _: object) -> bool:
        asked.append(time_s)
        return time_s >= 5.0

    assert hear(sent(), ends).time_s.tolist() == asked == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_a_new_step_of_the_largest_size_is_within_the_published_level_until_it_is_seen() -> None:
    row = new_step_row(Motion.SPIN, 100.0, 1)
    assert (row["flights"], row["beyond_s"]) == (1, 0)
    assert row["unseen_s"] < 600.0
    assert 0.9 < row["ratio"] < 1.5
