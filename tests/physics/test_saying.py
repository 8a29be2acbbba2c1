"""Parameters in sentences: digits by sigma, natural units, the sign as a verb, and which number is said."""

from __future__ import annotations

import math
import string

import numpy as np
import pytest

from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.interface import Effect, Value, value_of
from magcal_service.physics.saying import Said, labels_of, measured


def said(value: object, sigma: object, unit: str, *labels: tuple[str, ...]) -> Said:
    return Said(np.asarray(value, dtype=float), np.asarray(sigma, dtype=float), unit, labels)


@pytest.mark.parametrize(
    ("value", "sigma", "words"),
    [
        (12.3456, 0.1, "12.35"),
        (12.3456, 0.3, "12.35"),
        (12.3456, 1.0, "12.3"),
        (12.3456, 12.0, "12"),
        (-12.3456, 0.02, "-12.346"),
        (12.3456, math.nan, "12.346"),
        (12.3456, 0.0, "12.346"),
        (0.00012345, 1e-6, "1.234e-04"),
        (0.0, 1e-6, "0.0e+00"),
        (1.0, 1e-6, "1.0000000e+00"),
        (1.0, 1.1e-5, "1.000000"),
        ([1.0, 2.0], [0.1, 1.0], "(1.00, 2.0)"),
    ],
)
def test_numbers_have_as_many_digits_as_their_sigma_deserves(value: object, sigma: object, words: str) -> None:
    assert str(said(value, sigma, "nT")) == words


def test_every_number_of_a_list_is_said() -> None:
    assert said([1204.52, 3410.48, 5002.5], [0.5, 0.5, 0.5], "s").each == "1204.52, 3410.48 and 5002.50 s"
    assert said([10.0, 20.0], [math.nan, math.nan], "s").each == "10 and 20 s"


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "words"),
    [
        (-12.437, 0.31, "nT", "-12.44 ± 0.31 nT"),
        (0.0012, 0.0001, "1/K", "0.120 ± 0.010 %/K"),
        (2e-6, 3e-7, "1/K", "2.00 ± 0.30 ppm/K"),
        (-3e-3, 1e-4, "nT/s", "-10.80 ± 0.36 nT/h"),
        (1e-7, 1e-8, "1/s", "0.0360 ± 0.0036 %/h"),
        (2e-12, 1e-13, "1/nT2", "0.500 ± 0.025 % at 50 uT"),
        (4.0, math.nan, "a", "4 years"),
        (4.1, 0.2, "rpm", "4.10 ± 0.20 rpm"),
        (0.7, 0.03, "1", "0.700 ± 0.030"),
    ],
)
def test_a_number_is_said_with_its_sigma_in_the_unit_of_the_field(
    value: float, sigma: float, unit: str, words: str
) -> None:
    assert said(value, sigma, unit).signed == words
    assert said(value, sigma, unit).size == words.removeprefix("-")


def test_of_several_numbers_the_largest_is_said_with_its_place_and_sign() -> None:
    three = said([1.0, -5.0, 3.0], [0.1, 0.2, 0.3], "nT")
    assert (three.signed, three.size, three.place) == ("-5.00 ± 0.20 nT", "5.00 ± 0.20 nT", "axis y")
    panels = said([[1.0, 2.0, 3.0], [9.0, 0.0, 0.0]], np.ones((2, 3)), "nT", ("panel +x", "panel -x"), ("x", "y", "z"))
    assert (panels.place, panels.size) == ("panel -x, x", "9.0 ± 1.0 nT")
    assert said(0.0012, 0.0001, "1").percent == "0.120 ± 0.010 %"


def test_what_may_be_nothing_does_not_speak_for_the_others() -> None:
    """724 with a sigma of 789 is passed over for 40 with one of 5; where none stands out, the largest is said."""
    per_face = said([724.0, -40.0, 14.0], [789.0, 5.0, 10.0], "nT")
    assert (per_face.signed, per_face.place) == ("-40.0 ± 5.0 nT", "axis y")
    assert said([724.0, -40.0, 14.0], [789.0, 50.0, 10.0], "nT").place == "axis x"
    assert said([724.0, -40.0], [math.nan, math.nan], "nT").place == "1"


@pytest.mark.parametrize(
    "blocks",
    [
        ("along_km", "along_km_per_h", "along_km_per_h2"),
        ("radial_km", "along_km", "cross_km", "along_km_per_h"),
        ("radial_km", "along_km", "cross_km"),
        ("along_km", "along_km_per_h"),
    ],
)
def test_no_part_of_a_place_is_left_out_of_its_sentence(blocks: tuple[str, ...]) -> None:
    """Kilometres that grow with the square of time are most of an old element set's error."""
    numbers = {name: value_of(11.0 + 10.0 * k, 0.1, "km") for k, name in enumerate(blocks)}
    sentence = effect_named("position_offset").sentence(numbers, "none")
    assert all(f"{11.0 + 10.0 * k:.2f}" in sentence for k in range(len(blocks)))


def test_a_growing_correction_is_a_falling_gain() -> None:
    """D takes off again what a sensor has too much: where D grows the sensor answers with less."""
    assert (said(0.1, 0.01, "1/K").falls, said(-0.1, 0.01, "1/K").falls) == ("falls", "rises")


@pytest.mark.parametrize(("value", "words"), [(52.5, "52.5 ± 2.6 km ahead"), (-52.5, "52.5 ± 2.6 km behind")])
def test_a_direction_is_said_by_its_word(value: float, words: str) -> None:
    assert f"{said(value, 2.6, 'km'):ahead|behind}" == words
    assert f"{said(value, 2.6, 'km')}" == f"{value}"


def test_what_is_not_named_is_an_axis_or_a_number() -> None:
    assert labels_of((3,)) == (("axis x", "axis y", "axis z"),)
    assert labels_of((2, 3)) == (("1", "2"), ("axis x", "axis y", "axis z"))
    assert labels_of((2, 3), (("a", "b"), ("p", "q", "r"))) == (("a", "b"), ("p", "q", "r"))
    assert labels_of((2, 3), (("a",),)) == labels_of((2, 3))
    assert labels_of(()) == ()


def test_sigma_has_as_many_places_as_its_number() -> None:
    assert measured(1234.567, 12.0) == "1235 ± 12"
    assert measured(2.4e-5, 8.8e-5) == "2.4e-05 ± 8.8e-05"
    assert measured(0.0, 0.6) == measured(2.4e-5, 0.6) == "0.00 ± 0.60"
    assert measured(5.0, 0.0) == measured(5.0, math.nan) == "5"


FIELDS = [(effect, text) for effect in catalogue() for text in effect.says]


@pytest.mark.parametrize(("effect", "text"), FIELDS, ids=lambda part: getattr(part, "name", ""))
def test_every_sentence_holds_a_size_with_its_sigma(effect: Effect, text: str) -> None:
    """Cause and size: all sentences of the catalogue say a number with 1 sigma, but for what has none."""
    fields = [(field, either) for _, field, either, _ in string.Formatter().parse(text) if field and field != "driver"]
    names = [field.partition(".") for field, _ in fields]
    given: dict[str, Value] = {name: value_of([2.0, 7.0, 1.0], [0.2, 0.4, 0.3], "nT") for name, _, _ in names}
    given |= {name: value_of(7.0, 0.4, "nT") for name in given if name.endswith(("_s", "degree"))}
    sentence = effect.sentence(given, "channel:bus")
    assert "{" not in sentence
    assert sentence.endswith(".")
    sized = [field for field, either in fields if either or field.endswith((".size", ".signed", ".percent"))]
    assert (sized != []) == ("±" in sentence)
    assert sized or effect.name in ("stuck_axis", "reference_epoch")
