"""One vector against the newest reference: what noise, age and a hazard within protection may do passes, no more."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.trust.vector_gate import FASTEST_NT_S, OLDEST_S, strays
from magcal_service.wire.messages import CalibratedVector, Verdict

REFERENCE_NT = 40_000.0


def vector(length_nt: float, sigma_nt: float = 100.0, protection_nt: float | None = None) -> CalibratedVector:
    """A vector of a length in a direction of no axis; its noise makes it longer by sigma^2 / |H| in the mean."""
    x, y, z = (length_nt * np.array([0.6, -0.48, 0.64])).tolist()
    variance = sigma_nt**2
    return CalibratedVector(
        craft="a",
        source="b",
        sequence=1,
        time_ns=2,
        field_body_nt=(x, y, z),
        covariance_nt2=(variance, 0.0, 0.0, variance, 0.0, variance),
        verdict=Verdict.TRUSTED,
        protection_nt=protection_nt,
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("sigma_nt", "age_s", "protection_nt", "allowed_nt"),
    [
        (100.0, 0.0, None, 600.0 + 400.0),
        (10.0, 5.0, None, 60.0 + 400.0 + 5.0 * FASTEST_NT_S),
        (20.0, 1.0, 350.0, 120.0 + 400.0 + 350.0 + FASTEST_NT_S),
    ],
)
def test_a_vector_may_be_off_by_all_that_is_allowed_for(
    side: float, sigma_nt: float, age_s: float, protection_nt: float | None, allowed_nt: float
) -> None:
    longer = REFERENCE_NT + sigma_nt**2 / REFERENCE_NT
    within, beyond = (vector(longer + side * (allowed_nt + by), sigma_nt, protection_nt) for by in (-1.0, 1.0))
    assert not strays(within, REFERENCE_NT, age_s)
    assert strays(beyond, REFERENCE_NT, age_s)


def test_an_old_reference_says_nothing() -> None:
    assert strays(vector(10_000.0), REFERENCE_NT, OLDEST_S)
    assert not strays(vector(10_000.0), REFERENCE_NT, OLDEST_S + 0.1)
