"""Places of rows without any, from those around them, against the orbit that was flown."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.recordings.places import filled
from tests.physics.scenes import orbit_eci_km

TIME_S = np.arange(0.0, 1200.0, 2.0)


def lost(*gaps: tuple[float, float]) -> np.ndarray:
    """The orbit, with noise of 10 m, without places in some stretches of time [s]."""
    places = orbit_eci_km(TIME_S) + np.random.default_rng(7).normal(0.0, 0.01, (len(TIME_S), 3))
    for first, last in gaps:
        places[(first <= TIME_S) & (last >= TIME_S)] = np.nan
    return places


@pytest.mark.parametrize(
    ("gap", "off_km"),
    [((500.0, 500.0), 0.05), ((500.0, 790.0), 0.1), ((0.0, 40.0), 2.0), ((1180.0, 1198.0), 0.5), ((8.0, 60.0), 0.3)],
)
def test_a_short_gap_is_filled_by_the_orbit_around_it(gap: tuple[float, float], off_km: float) -> None:
    found = filled(TIME_S, lost(gap))
    assert found is not None
    assert np.linalg.norm(found - orbit_eci_km(TIME_S), axis=1).max() < off_km


@pytest.mark.parametrize("gap", [(500.0, 810.0), (0.0, 70.0), (1130.0, 1198.0), (4.0, 1198.0)])
def test_a_long_one_is_not(gap: tuple[float, float]) -> None:
    assert filled(TIME_S, lost(gap)) is None


def test_what_is_known_stays_as_it_is() -> None:
    whole = lost()
    assert filled(TIME_S, whole) is whole
    some = lost((100.0, 120.0), (700.0, 700.0))
    known = np.isfinite(some).all(axis=1)
    found = filled(TIME_S, some)
    assert found is not None
    assert np.array_equal(found[known], some[known])
    assert filled(TIME_S, np.full((len(TIME_S), 3), np.nan)) is None
