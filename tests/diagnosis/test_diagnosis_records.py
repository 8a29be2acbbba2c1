"""Another selection that begins with a record, where a computed course has taken up a second cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.records import from_records
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.stages import untold
from magcal_service.model import Array
from tests.diagnosis.made_up import FLOOR_NT, SLOW, TIME_S, along, body_form, flown, searching

AFTER = (TIME_S > 3500.0).astype(np.float64)
RAMP = np.clip((TIME_S - 2500.0) / 2000.0, 0.0, 1.0)


def stands(disturbance_nt: Array, *, record: Array = SLOW) -> list[str]:
    """What stands of a computed course that is free to bend, beside a record of it and a jump."""
    recorded = replace(body_form("warm", "recorded", along(0, record)), driver="channel:t")
    bending = body_form("warm", "computed", along(0, SLOW), along(1, RAMP))
    computed = replace(bending, driver="inferred:temperature")
    search, baseline = searching(flown(disturbance_nt), computed, recorded, body_form("jump", "", along(1, AFTER)))
    search.close |= {recorded.label, computed.label}
    fit = search.refreshed(solve(search.problem, baseline.x, [Term(computed, np.zeros(0), np.array([400.0, 150.0]))]))
    found = from_records(search, search.compared(fit, FLOOR_NT), FLOOR_NT, untold)
    assert found.fit.problem is search.problem  # the search goes on at what stands
    assert all(any(term.hypothesis is one for one in search.hypotheses) for term in found.fit.terms)
    return [term.hypothesis.label for term in found.fit.terms]


def test_a_record_and_a_jump_stand_where_a_computed_course_takes_up_both() -> None:
    """A ramp holds most of a jump; the record leaves all of it to be found."""
    assert stands(along(0, 400.0 * SLOW) + along(1, 200.0 * AFTER)) == ["warm[recorded] by channel:t", "jump"]


def test_a_computed_course_stands_where_nothing_further_foretells_better() -> None:
    """What bends as the course does is no jump, beside the record either."""
    assert stands(along(0, 400.0 * SLOW) + along(1, 200.0 * RAMP)) == ["warm[computed] by inferred:temperature"]


def test_a_record_that_holds_too_little_is_not_begun_with() -> None:
    """Another thermometer, which the computed course hardly resembles."""
    other = SLOW + 1.5 * np.sin(TIME_S / 310.0)
    disturbance = along(0, 400.0 * SLOW) + along(1, 200.0 * AFTER)
    assert stands(disturbance, record=other) == ["warm[computed] by inferred:temperature"]
