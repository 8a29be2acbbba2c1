"""Currents above: the ring current, nearly uniform along the dipole's axis, with the part it induces in the Earth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from magcal_service.earth.igrf14 import RADIUS_KM as IGRF_RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene

INDUCED: Final = 0.27
"""Induced over inducing field at the Earth's surface and the dipole's equator, both to the north there: Q1 of Olsen et
al. 2006 (CHAOS).  A perfect conductor up to the surface, which no field enters, has 0.5."""

_NORTHWARD_NT: Final = 50.0
"""Most that currents above add along the dipole's axis to the north, as a mean [nT].  The ring current's field is to
the south; a magnetopause pressed inwards adds some tens for an hour or two, in hardly any hour more than 50 of Dst."""

_GUESSED: Final = 0.3
"""Of the evidence, what a polynomial course leaves of a storm's: beside three concealed ones of a sine, places were
found wrong by 0.16, 0.27 and 0.3 of it."""

_INDUCED: Final = "induced"
"""Constant of a form with the induced part: Q1 as it was fitted; before its sign was right there was none."""

UNIFORM: Final = "uniform"
"""Form without the induced part: what changes within the hour, and what was modelled as no more."""


def ring_current(scene: Scene, induced: float = INDUCED) -> Array | None:
    """(n,) growth of |H| per nT of uniform field along the dipole axis (towards north), with an induced dipole's.

    In a potential a q (r / a + Q1 (a / r)^2) cos(theta), theta from the axis, the uniform field is -q along the axis,
    and the induced one is Q1 q (a / r)^3 (3 cos(theta) up - axis): it adds to the uniform one at the equator.
    """
    if scene.reference_eci_nt is None or scene.dipole_eci is None:
        return None
    field = np.array(scene.dipole_eci)
    if scene.position_eci_km is not None:
        radius = np.linalg.norm(scene.position_eci_km, axis=1)[:, None]
        up = scene.position_eci_km / radius
        axial = np.einsum("ni,ni->n", up, scene.dipole_eci)[:, None]
        field = field + induced * (IGRF_RADIUS_KM / radius) ** 3 * (scene.dipole_eci - 3.0 * axial * up)
    direction = scene.reference_eci_nt / scene.magnitude_nt[:, None]
    return np.asarray(np.einsum("ni,ni->n", field, direction))


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    """With its induced part where places are known, and uniform."""
    induced = scene.constant(_INDUCED, INDUCED)
    for column, form in ((ring_current(scene, induced), ""), (ring_current(scene, 0.0), UNIFORM)):
        if column is not None and (form == UNIFORM or scene.position_eci_km is not None):
            yield from _courses(scene, column, form)


def _courses(scene: Scene, column: Array, form: str) -> Iterator[Hypothesis]:
    """Polynomials in time of a column (n,)."""
    middle_s = scene.constant("middle_s", float(scene.time_s.mean()))
    span_s = scene.constant("span_s", max(float(np.ptp(scene.time_s)), 1.0))
    share = (scene.time_s - middle_s) / span_s * 2.0
    if scene.is_given:  # a course is known within its recording only; beyond, its ends hold
        share = np.clip(share, -1.0, 1.0)
    constants = {} if form == UNIFORM else {_INDUCED: scene.constant(_INDUCED, INDUCED)}
    course = {"middle_s": middle_s, "span_s": span_s}
    for order, variant in ((0, ""), (1, "changing"), (2, "curved"), (4, "storm")):
        powers = np.polynomial.legendre.legvander(share, order).T
        made = Columns(magnitude=powers * column[None])
        blocks: tuple[Block, ...] = (Block("mean_nt", "nT", (), highest=_NORTHWARD_NT),)
        if order:
            blocks = (*blocks, Block("course_nt", "nT", (order,)))
        yield Hypothesis(
            "external_field",
            "none",
            lambda _, made=made: made,  # type: ignore[misc]
            blocks,
            ", ".join(filter(None, (form, variant))),
            constants=constants | (course if order else {}),
            inexact=_GUESSED,
        )


def _outdated(form: str, constants: Mapping[str, float]) -> str:
    if form.startswith(UNIFORM) or _INDUCED in constants:
        return ""
    return (
        f"the constant {_INDUCED} is required: before it the induced part had another sign and size, and "
        "the numbers of such a file mean another field; diagnose the recording again"
    )


EFFECT = Effect(
    name="external_field",
    acts_on=ActsOn.REFERENCE,
    title="currents above the craft: the ring current",
    equation="|A H| = |H_ref| + q(t) h . (m + induced), m the dipole's axis; q Legendre polynomials; or m alone",
    units={"mean_nt": "nT", "course_nt": "nT", "middle_s": "s", "span_s": "s", "induced": "1"},
    in_orbit_only=True,
    prior=(5.0, 500.0),
    of_one_recording=True,
    valid="below 60 degrees of dipole latitude; field-aligned currents are not in it",
    confused_with=("reference_epoch", "bias_drift", "position_offset"),
    separated_by="the Dst or SYM-H index of the day; a second craft at the same time",
    source="Olsen et al. 2006 (CHAOS): ring current with Q1 = 0.27; Dst -20 to -400 nT",
    says=("A field of {mean_nt.signed} along the Earth's dipole axis, from currents above, is not in the reference.",),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    outdated=_outdated,
)
