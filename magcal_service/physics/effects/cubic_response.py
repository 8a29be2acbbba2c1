"""The sensor's response is not linear: a cubic term of each axis, and the transverse field effect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import AFTER_BIAS, Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene

_MOST_PER_NT2: Final = 1.0 / 3.0 / 50e3**2
"""A cube's size at the most [1/nT^2]: with more a reading would no longer rise with the field at 50 uT."""

_PAIRS: Final = ("axes x and y", "axes x and z", "axes y and z")
_BOTH_WAYS: Final = ((0, 2), (1, 4), (3, 5))
"""Cross terms of each pair, of six: how the first bends with the second, and the second with the first.  Along the
field both are B_i^2 B_j^2 over its size, so a magnitude shows their sum alone; each by itself could be any."""


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield from _forms(scene.free_field_nt)
    for hypothesis in _forms(scene.calibrated_nt):
        yield replace(hypothesis, variant=f"{AFTER_BIAS}, {hypothesis.variant}".removesuffix(", "))


def _forms(field: Array) -> Iterator[Hypothesis]:
    """Cubes of ``field`` (n, 3): what is measured, as it would be without them; or the field where the bias arises
    behind what bends."""
    own = np.zeros((3, len(field), 3))
    across = np.zeros((6, len(field), 3))
    index = 0
    for axis in range(3):
        own[axis, :, axis] = field[:, axis] ** 3
        for other in range(3):
            if other != axis:
                across[index, :, axis] = field[:, axis] * field[:, other] ** 2
                index += 1
    cubic = Block("per_nt2", "1/nT2", most=_MOST_PER_NT2)
    yield Hypothesis("cubic_response", "none", lambda _: Columns(body=own), (cubic,))
    both = np.stack([across[one] + across[other] for one, other in _BOTH_WAYS])
    cross = Block("cross_per_nt2", "1/nT2", (3,), _MOST_PER_NT2, labels=(_PAIRS,))
    alike = Hypothesis(
        "cubic_response",
        "none",
        lambda _: Columns(body=np.concatenate([own, both])),
        (cubic, cross),
        "with cross terms",
    )
    yield alike
    each = Block("cross_each_per_nt2", "1/nT2", (3, 2), _MOST_PER_NT2, labels=(AXES, ("first other", "second other")))
    yield replace(
        alike,
        columns=lambda _: Columns(body=np.concatenate([own, across])),
        blocks=(cubic, each),
        variant="with cross terms of each axis",
        needs_vectors=True,
    )
    length: Array = np.einsum("ni,ni->n", field, field)
    common = (field * length[:, None])[None]
    one = Block("common_per_nt2", "1/nT2", (), _MOST_PER_NT2)
    yield Hypothesis("cubic_response", "none", lambda _: Columns(body=common), (one,), "by the field's size")


EFFECT = Effect(
    name="cubic_response",
    acts_on=ActsOn.FIELD,
    watched=((Watched.CUBE, ""),),
    title="the sensor's answer bends with the field",
    equation="d_i = c_i B_i^3 + sum_j c_ij B_i B_j^2, with B as it would be without d; or of w behind a bias that does "
    "not bend; c_ij = c_ji where only magnitudes are compared",
    units={"per_nt2": "1/nT2", "cross_per_nt2": "1/nT2", "cross_each_per_nt2": "1/nT2", "common_per_nt2": "1/nT2"},
    prior=(5.0, 3000.0),
    valid="small against the field: 0.02-0.5 % of full scale",
    confused_with=("saturation", "hysteresis"),
    separated_by="a larger field on one axis: a knee is flat below its start, a cube is not",
    source="Brauer et al. 1997 (transverse field effect); data sheets of AMR sensors (linearity 0.1-1 %)",
    says=(
        "The answer of {per_nt2.place} bends with the cube of the field, by {per_nt2.size}, and of "
        "{cross_per_nt2.place} with the field across, by {cross_per_nt2.size}.",
        "The answer of {per_nt2.place} bends with the cube of the field, by {per_nt2.size}, and of "
        "{cross_each_per_nt2.place} with the field across, by {cross_each_per_nt2.size}.",
        "The answer of {per_nt2.place} bends with the cube of the field, by {per_nt2.size}.",
        "The answer bends with the field's size, by {common_per_nt2.size}.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    bends=True,
)
