"""The reference comes from old coefficients, or from a series cut short."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

_YEAR_NS: Final = round(365.25 * 86400 * 1e9)
_BASE_YEARS: Final = 5.0
"""Years over which the yearly change is taken: IGRF is linear between epochs, five years apart."""

DEGREES: Final[tuple[int, ...]] = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12)
"""Degrees at which a series may have been cut: all below the 13 of IGRF."""


def yearly_change(scene: Scene) -> Array:
    """(n,) growth of |H| in the last year [nT], by the secular variation of the five years before."""
    rows = scene.knots
    assert scene.position_ecef_km is not None
    position, now = scene.position_ecef_km[rows], scene.time_ns[rows]
    before = now - round(_BASE_YEARS * _YEAR_NS)
    return scene.from_knots((scene.model_magnitude(position) - scene.model_magnitude(position, before)) / _BASE_YEARS)


def truncated_change(scene: Scene, degree: int) -> Array:
    """(n,) what the terms above a degree add to |H| [nT]."""
    assert scene.position_ecef_km is not None
    position = scene.position_ecef_km[scene.knots]
    whole = scene.once("whole series", lambda: scene.model_magnitude(position))
    return scene.from_knots(whole - scene.model_magnitude(position, degree=degree))


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if not scene.has_model:
        return
    degrees = DEGREES
    if scene.given is None or "degree" not in scene.given:
        change = scene.once("yearly change", lambda: yearly_change(scene))[None]
        block = Block("years", "a", ())
        yield Hypothesis("reference_epoch", "none", lambda _: Columns(magnitude=change), (block,))
    if scene.given is not None:
        degrees = tuple(degree for degree in DEGREES if degree == scene.given.get("degree"))
    for degree in degrees:
        column = scene.once(f"degree {degree}", lambda degree=degree: truncated_change(scene, degree))[None]  # type: ignore[misc]
        share = Block("share", "1", ())
        yield Hypothesis(
            "reference_epoch",
            "none",
            lambda _, column=column: Columns(magnitude=column),  # type: ignore[misc]
            (share,),
            f"degree {degree}",
            constants={"degree": float(degree)},
        )


EFFECT = Effect(
    name="reference_epoch",
    acts_on=ActsOn.REFERENCE,
    title="the reference comes from old coefficients or a truncated series",
    equation="|A H| = |H_ref| + years * d|H|/dt (secular variation); or the terms above a degree, times a share",
    units={"years": "a", "share": "1"},
    in_orbit_only=True,
    prior=(5.0, 3000.0),
    valid="secular variation taken as linear over the years",
    confused_with=("external_field", "position_offset"),
    separated_by="the version of the coefficients in the reference's log; passes over other longitudes",
    source="Alken et al. 2021 (IGRF-13) and IAGA 2024 (IGRF-14): secular variation to 80-100 nT/a locally",
    says=(
        "The reference's coefficients are {years.signed} old.",
        "The reference is a series cut short: the terms above degree {degree} are missing.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
