"""Several recordings together, one of which changes: at an instant, or over a while, on its own clock."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from magcal_service.diagnosis.joint.diagnose import diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.result import as_json
from magcal_service.physics.catalogue import effect_named
from tests.diagnosis.joint_days import TIME_S, day

PER_K = np.array([12.0, -8.0, 15.0])
NONE = np.zeros(3)
EFFECTS = tuple(effect_named(name) for name in ("thermal_bias", "bias_step", "bias_drift"))


def named(
    number: int, from_s: float, to_s: float, size_nt: list[float], seed: int, days: int = 3
) -> list[dict[str, Any]]:
    """The effects named beside the temperature's, where day ``number`` of some changes between two times."""
    course = np.interp(TIME_S, [from_s, to_s], [0.0, 1.0]) if to_s > from_s else (from_s <= TIME_S).astype(float)
    added = [np.outer(course, size_nt) if one == number else None for one in range(days)]
    each = [day(one, PER_K, NONE, added[one], seed=seed) for one in range(days)]
    gathered = gather([one.recording for one in each])
    found = diagnose_together(gathered.inspections, gathered.names, EFFECTS)
    effects = json.loads(as_json(found))["effects"]
    assert effects[[one["effect"] for one in effects].index("thermal_bias")]["common"]
    return [one for one in effects if one["effect"] != "thermal_bias"]


def test_a_ramp_in_one_recording_is_a_drift_with_its_times_there() -> None:
    (one,) = named(1, 2000.0, 2600.0, [300.0, -200.0, 150.0], 968)
    assert (one["effect"], one["recordings"]) == ("bias_drift", ["arrays-2"])
    for name, true in (("from_s", 2000.0), ("to_s", 2600.0)):
        value = one["parameters"][name]
        assert abs(value["value"] - true) < 3.0 * value["sigma"] < 300.0


def test_a_ramp_over_much_of_one_recording_leaves_no_step() -> None:
    """A drift of each recording's own follows it nearly as well; its end was a step while its times were too early."""
    (one,) = named(1, 1200.0, 3200.0, [300.0, 300.0, -100.0], 968, days=2)
    assert one["effect"] == "bias_drift"
    assert "arrays-2" in one["recordings"]


def test_a_jump_in_one_recording_is_a_step_at_its_instant_there() -> None:
    (one,) = named(2, 2500.0, 2500.0, [300.0, -200.0, 150.0], 968)
    assert (one["effect"], one["recordings"]) == ("bias_step", ["arrays-3"])
    at_s = one["parameters"]["at_s"]
    assert abs(at_s["value"] - 2500.0) < 10.0
