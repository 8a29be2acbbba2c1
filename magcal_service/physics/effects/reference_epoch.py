"""The reference comes from old coefficients, or from a series cut short."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene

_YEAR_NS: Final = round(365.25 * 86400 * 1e9)
_BASE_YEARS: Final = 5.0
"""Years over which the yearly change is taken: IGRF is linear between epochs, five years apart."""

_STEP, _OLDEST = 2.5, 40.0
"""Ages at which coefficients are taken, and the last of them [years]: IGRF is linear over twice the step."""

_OLD: Final = 6.0
"""Age from which on the yearly change itself has changed by more than 1 in 20 on the way [years]: jerks."""

BY_DECADES: Final = "by decades"
"""Form of an age over which the secular variation is not linear."""

_LARGEST_NT: Final = 3000.0
"""rms of what forty years change in |H| along any low orbit [nT]."""

DEGREES: Final[tuple[int, ...]] = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12)
"""Degrees at which a series may have been cut: all below the 13 of IGRF."""


def yearly_change(scene: Scene) -> Array:
    """(n,) growth of |H| in the last year [nT], by the secular variation of the five years before."""
    before = scene.time_ns[scene.knots] - round(_BASE_YEARS * _YEAR_NS)
    return scene.from_knots((scene.model_magnitude() - scene.model_magnitude(times_ns=before)) / _BASE_YEARS)


def change_over(scene: Scene, age: float) -> Array:
    """(n,) growth of |H| [nT] over so many years, straight between the ages at which it is computed, each once."""
    place = float(np.clip(age / _STEP, 0.0, _OLDEST / _STEP - 1e-9))
    left = int(place)
    younger, older = _since(scene, left * _STEP), _since(scene, (left + 1) * _STEP)
    return np.asarray(younger + (place - left) * (older - younger))


def _since(scene: Scene, age: float) -> Array:
    """(n,) growth of |H| [nT] since coefficients of an age [years], computed once."""
    before = scene.time_ns[scene.knots] - round(age * _YEAR_NS)
    today = scene.once("whole series", scene.model_magnitude)
    then = scene.once(f"{age} years ago", lambda: scene.model_magnitude(times_ns=before))
    return scene.from_knots(today - then)


def _by_decades(scene: Scene) -> Hypothesis:
    """The mean yearly change since coefficients of an age, which gives it its shape."""

    def columns(theta: Array) -> Columns:
        age = float(np.clip(theta[0], _STEP, _OLDEST))
        return Columns(magnitude=change_over(scene, age)[None] / age)

    yearly_nt = float(np.sqrt(np.mean(scene.once("yearly change", lambda: yearly_change(scene)) ** 2)))
    return Hypothesis(
        "reference_epoch",
        "none",
        columns,
        (Block("years", "a", (), most=_OLDEST),),
        BY_DECADES,
        (Nonlinear("shape_years", "a", np.arange(_OLD, _OLDEST, 3.0), spans=True),),
        largest_nt=_LARGEST_NT,
        least_nt=_OLD * yearly_nt,
    )


def truncated_change(scene: Scene, degree: int) -> Array:
    """(n,) what the terms above a degree add to |H| [nT]."""
    whole = scene.once("whole series", scene.model_magnitude)
    return scene.from_knots(whole - scene.model_magnitude(degree=degree))


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    if not scene.has_model:
        return
    degrees = DEGREES
    if scene.given is None or "degree" not in scene.given:
        change = scene.once("yearly change", lambda: yearly_change(scene))[None]
        block = Block("years", "a", (), most=_OLDEST)
        yield Hypothesis("reference_epoch", "none", lambda _: Columns(magnitude=change), (block,))
        yield _by_decades(scene)
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
            is_whole=True,
        )


EFFECT = Effect(
    name="reference_epoch",
    acts_on=ActsOn.REFERENCE,
    title="the reference comes from old coefficients or a truncated series",
    equation="|A H| = |H_ref| + years d|H|/dt; dH/dt of the last year or the mean of many; or the terms above a degree",
    units={"years": "a", "shape_years": "a", "share": "1"},
    in_orbit_only=True,
    prior=(5.0, 3000.0),
    valid="secular variation linear over a few years, by the published coefficients over decades",
    confused_with=("external_field", "position_offset"),
    separated_by="the version of the coefficients in the reference's log; passes over other longitudes",
    source="Alken et al. 2021 (IGRF-13) and IAGA 2024 (IGRF-14): secular variation to 80-100 nT/a locally",
    says=(
        "The reference's coefficients are {years.signed} old.",
        "The reference is a series cut short: the terms above degree {degree} are missing.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
