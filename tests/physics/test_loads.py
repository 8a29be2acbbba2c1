"""Recorded currents that change at an instant: a load that was switched may stand behind a jump of the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.sized import may_as_well_be
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.loads import jumps_along
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.scenes import COUNT, NOISE_NT, X, scene

TIME_S = scene().time_s
AT_S = 3001.0


def recorded(*currents: Array) -> Scene:
    rng = np.random.default_rng(41)
    named = {f"i{k}": one + rng.normal(0.0, 0.02, COUNT) for k, one in enumerate(currents)}
    channels = {name: Telemetry(name, "current", values[:, None]) for name, values in named.items()}
    return replace(scene(), channels=channels)


SLOW = 0.8 + 0.3 * np.sin(TIME_S / 900.0)
LOAD = 0.5 * (TIME_S >= AT_S)
OFTEN = 2.0 * (np.sin(TIME_S / 60.0 + 1.8) > 0.0)  # in the middle of a pulse at the jump


@pytest.mark.parametrize(
    ("currents", "along"),
    [((SLOW,), False), ((SLOW, LOAD), True), ((SLOW + LOAD,), True), ((SLOW + LOAD + OFTEN,), False), ((), False)],
)
def test_a_record_that_seldom_changes_so_is_seen_to_jump(currents: tuple[Array, ...], along: bool) -> None:
    of = recorded(*currents)
    assert jumps_along(of, np.array([AT_S])) is along
    assert not jumps_along(of, np.array([AT_S + 400.0]))
    assert not jumps_along(of, np.array([TIME_S[0], TIME_S[-1]]))


@pytest.mark.parametrize(("currents", "as_well"), [((SLOW,), ()), ((SLOW, LOAD), ("current_loop",))])
def test_a_jump_along_with_a_record_may_as_well_be_a_loads(
    currents: tuple[Array, ...], as_well: tuple[str, ...]
) -> None:
    of = recorded(*currents)
    jump = next(h for h in effect_named("bias_step").hypotheses(of) if not h.variant)
    fit = solve(Problem(of, NOISE_NT), X, [Term(jump, np.array([AT_S]), np.array([90.0, 0.0, 0.0]))])
    assert may_as_well_be(fit, 0) == as_well
