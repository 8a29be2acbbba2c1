"""The table of forms has every effect, and of each what it is tried as."""

from __future__ import annotations

import re

import pytest

from magcal_service.physics.catalogue import catalogue
from tests.figures.forms import MEANS, forms, forms_of, parts_of

ROWS = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in forms().splitlines()[2:]]


def test_every_effect_of_the_catalogue_has_a_row() -> None:
    assert {row[0] for row in ROWS} == {f"`{effect.name}`" for effect in catalogue()}


@pytest.mark.parametrize(
    ("effect", "form"),
    [
        ("bias_step", "steps at 2 to 6 instants"),  # alike but for a number
        ("response_lag", "by the steps, from its start"),  # in place of a turn that is not known
        ("thermal_bias", "answer to light"),  # where nobody recorded it
        ("thermal_bias", "column 1 to 2"),  # of a channel that has several
        ("saturation", "sought in the samples themselves"),  # beside its forms
        ("torquer", "sought in when it acts, beside the names"),
    ],
)
def test_forms_of_every_kind_are_in_it(effect: str, form: str) -> None:
    assert any(row[0] == f"`{effect}`" and form in row[2].split("; ") for row in ROWS)


def test_numbers_are_named_once_and_what_is_sought_beside_forms_has_its_own() -> None:
    assert ["`bias_step`", "`none`", "*plain*", "`step_nt`, `at_s`"] in ROWS
    (knee, found) = (row[3] for row in ROWS if row[0] == "`saturation`")
    assert not set(knee.split(", ")) & set(found.split(", "))


def test_drivers_stand_there_as_in_a_physics_file() -> None:
    found = {row[1] for row in ROWS}
    assert found >= {"`none`", "`channel:NAME`", "`inferred:temperature`", "`inferred:array_current`"}
    assert all(re.fullmatch(r"(`(none|channel:NAME|inferred:[a-z_]+)`)?", one) for one in found)


def test_every_part_of_a_name_is_explained_and_nothing_else() -> None:
    parts = {
        part for effect in catalogue() for form in forms_of(effect) if form.variant for part in parts_of(form.variant)
    }
    assert parts == set(MEANS)
