"""Figures of the report: light and dark colours, and the Earth's coasts."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import numpy as np
import pytest

import magcal_service.diagnosis.report as package
from magcal_service.diagnosis.report.curves import _ranges
from magcal_service.diagnosis.report.drawing import AFTER, AFTER_POINTS, BEFORE, BEFORE_POINTS, DIVERGING, picture
from magcal_service.diagnosis.report.figures import coastlines
from magcal_service.views import PAGE
from tests.figures.coastlines import arcs, simplified, without_frame


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.1) of a colour as #rrggbb or #rgb."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    parts = np.frombuffer(bytes.fromhex(digits), np.uint8) / 255.0
    linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: str, other: str) -> float:
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


LIGHT, DARK = re.findall(r"--card:(#[0-9a-f]+)", (PAGE / "base.css").read_text("utf-8"))
"""What a figure is drawn on."""


def test_what_takes_few_values_has_a_range_for_each() -> None:
    """Something that is on or off was one point in the figure that shows the residual against it."""
    number, centres = _ranges(np.array([0.0, 120.0, 120.0, 0.0, 120.0]))
    assert (number.tolist(), centres.tolist()) == ([0, 1, 1, 0, 1], [0.0, 120.0])
    number, centres = _ranges(np.arange(1000.0))
    assert np.bincount(number).tolist() == [50] * 20
    assert centres[0] == pytest.approx(24.5)


def drawn() -> str:
    """A figure with every kind of vector ink."""

    def draw(figure: object) -> None:
        axes = figure.subplots()  # type: ignore[attr-defined]
        axes.plot([0, 1], [0, 1], color=BEFORE, label="before")
        axes.plot([0, 1], [1, 0], color=AFTER, label="after")
        axes.set(xlabel="time", title="words")
        axes.legend()

    return base64.b64decode(picture(draw, "", "").src.partition(",")[2]).decode()


def test_vector_ink_follows_the_scheme_of_the_page() -> None:
    """Outside of the rules no colour is fixed, and each name has one value for light and one for dark."""
    rules = re.search(r":root\{(.*?)\}@media\(prefers-color-scheme:dark\)\{:root\{(.*?)\}\}", drawn())
    assert rules is not None
    light, dark = (dict(re.findall(r"(--c\d+):(#[0-9a-f]{6})", part)) for part in rules.groups())
    rest = drawn().replace(rules[0], "")
    assert not re.findall(r"#[0-9a-f]{6}\b", rest)
    used = set(re.findall(r"var\((--c\d+)\)", rest))
    assert {light[name] for name in used} >= {BEFORE, AFTER}
    assert used <= set(light) == set(dark)


def test_curves_and_words_are_read_on_light_and_dark_ground() -> None:
    light, dark = (
        dict(re.findall(r"(--c\d+):(#[0-9a-f]{6})", part)) for part in drawn().split("@media(prefers-color-scheme")
    )
    inks = [name for name, colour in light.items() if contrast(colour, LIGHT) > 4.5]
    assert len(inks) >= 4
    assert all(contrast(dark[name], DARK) > 4.5 for name in inks)


@pytest.mark.parametrize("colour", [BEFORE_POINTS, AFTER_POINTS, *DIVERGING])
def test_what_is_drawn_as_pixels_is_seen_on_both(colour: str) -> None:
    assert min(contrast(colour, LIGHT), contrast(colour, DARK)) > 3.0


def test_the_coasts_are_those_of_the_earth() -> None:
    """Capes lie on a line, the pole of inaccessibility of the ocean far from any, and the file is small."""
    points = np.concatenate(coastlines())

    def distance(longitude: float, latitude: float) -> float:
        return float(np.hypot(*(points - [longitude, latitude]).T).min())

    capes = {"Agulhas": (20.0, -34.8), "Comorin": (77.5, 8.1), "Finisterre": (-9.3, 42.9), "York": (142.5, -10.7)}
    assert {name for name, place in capes.items() if distance(*place) > 1.0} == set()
    assert distance(-123.4, -48.9) > 20.0
    assert distance(24.0, 0.0) > 8.0
    assert Path(package.__path__[0], "coastlines.json").stat().st_size < 40_000


def test_a_coast_is_thinned_within_the_tolerance_and_cut_from_the_maps_frame() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.1], [2.0, -0.1], [3.0, 5.0], [4.0, 0.0]])
    assert simplified(line, 0.2).tolist() == [[0.0, 0.0], [2.0, -0.1], [3.0, 5.0], [4.0, 0.0]]
    framed = np.array([[170.0, 60.0], [175.0, 62.0], [180.0, 63.0], [180.0, -90.0], [175.0, -80.0], [170.0, -78.0]])
    assert [part.tolist() for part in without_frame(framed)] == [framed[:2].tolist(), framed[4:].tolist()]
    topology = {"transform": {"scale": [0.1, 0.2], "translate": [-180.0, -90.0]}, "arcs": [[[10, 5], [1, -1]]]}
    assert np.allclose(arcs(topology), [[[-179.0, -89.0], [-178.9, -89.2]]])
