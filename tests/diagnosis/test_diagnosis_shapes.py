"""Families without a name: their signals by hand, and what is left of a residual by them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.cycle import CYCLE
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.leftover import (
    Structure,
    fitted_terms,
    significant,
    structures,
)
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.locate import Place, _coincidence, locate
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.shapes import (
    Shape,
    _cosines,
    _in_windows,
    _places,
    _products,
    _quantiles,
    body_shape,
    products_of_two,
    shapes,
)
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.scenes import COUNT, NOISE_NT, PERIOD_S, RATE_RAD_S, X, scene, spoiled

FLOOR_NT = 0.3 * NOISE_NT
TIME_S = scene().time_s
QUIET = np.zeros((COUNT, 3))
SPIN_HZ = RATE_RAD_S / (2.0 * math.pi)


def flown(disturbance_nt: Array = QUIET, grown_nt: Array | float = 0.0, **changes: object) -> Scene:
    """The clean craft at its usual noise with a body field (n, 3) and a growth of the magnitude (n,)."""
    noise = np.random.default_rng(33).normal(0.0, NOISE_NT, (COUNT, 3))
    noisy = spoiled(measure(X, scene().calibrated_nt + disturbance_nt + noise), scene())
    return replace(noisy, **{"channels": {}, "magnitude_nt": scene().magnitude_nt - grown_nt} | changes)


def searched(of: Scene, spin_hz: float | None = None) -> tuple[Search, Fit]:
    """A search without any physics, and the nine errors' fit."""
    problem = Problem(of, NOISE_NT)
    return Search(problem, [], spin_hz=spin_hz), solve(problem, X)


# Signals


def test_courses_are_cosines_of_half_turns() -> None:
    share = np.array([0.0, 0.25, 0.5, 1.0])
    expected = [[1.0, 1.0], [math.sqrt(0.5), 0.0], [0.0, -1.0], [-1.0, 1.0]]
    assert _cosines(share, 2) == pytest.approx(np.array(expected), abs=1e-12)


def test_windows_are_even_and_the_last_sample_is_in_the_last() -> None:
    share = np.array([0.0, 0.24, 0.26, 0.5, 0.9, 1.0])
    assert _in_windows(share, 4).number.tolist() == [0, 0, 1, 2, 3, 3]
    few = _in_windows(np.array([0.0, 0.1, 0.9]), 4)
    assert (few.number.tolist(), few.count) == ([0, 0, 1], 2)


def test_products_of_the_field_are_scaled_centred_and_named() -> None:
    """Six of two components and ten of three, in units of the rms of all components."""
    field = np.random.default_rng(4).normal(0.0, 20e3, (50, 3))
    signals, names = _products(field)
    unit = field / np.sqrt(np.mean(field**2))
    letters = {"Bx": 0, "By": 1, "Bz": 2}
    assert len(set(names)) == len(names) == 16
    assert sorted(len(name.split()) for name in names) == [2] * 6 + [3] * 10
    for signal, name in zip(signals.T, names, strict=True):
        product = np.prod([unit[:, letters[part]] for part in name.split()], axis=0)
        assert signal == pytest.approx(product - product.mean())
    tiny = field * 1e-6
    assert _products(tiny)[0] == pytest.approx(_by_one(tiny))


def _by_one(field: Array) -> Array:
    """Products of components in nT, centred, in the order of ``_products``."""
    found = []
    for i in range(3):
        for j in range(i, 3):
            found += [field[:, i] * field[:, j], *(field[:, i] * field[:, j] * field[:, k] for k in range(j, 3))]
    signals = np.stack(found, axis=1)
    return np.asarray(signals - signals.mean(axis=0))


def test_products_of_two_are_six_signals_on_three_axes() -> None:
    columns = products_of_two(Problem(scene(), NOISE_NT))
    assert columns.axes is not None
    assert columns.axes.shape == (6, COUNT, 3)
    unit = scene().clean_field_nt / np.sqrt(np.mean(scene().clean_field_nt ** 2))
    first = unit[:, 0] * unit[:, 0]
    assert columns.axes[0, :, 1] == pytest.approx(first - first.mean())


def test_ranges_of_a_channel_hold_equally_many_samples() -> None:
    """Ten of them; the last is the sum of nothing else and left out."""
    values = np.random.default_rng(5).permutation(np.arange(1000.0))
    made = _quantiles(values)
    assert made is not None
    bins = made.columns(np.ones((1000, 1)))
    assert bins.shape == (1000, 9)
    assert bins.sum(axis=0) == pytest.approx(np.full(9, 100.0), abs=1.0)
    assert np.array_equal(bins[:, 0] > 0, values < np.quantile(values, 0.1))
    two = _quantiles(np.array([0.0, 1.0] * 20))
    assert two is not None
    assert two.columns(np.ones((40, 1))).tolist() == [[1.0], [0.0]] * 20
    assert _quantiles(np.full(30, 4.0)) is None


def test_places_are_squares_of_15_degrees_that_were_seen_twenty_times() -> None:
    def at(latitude: float, longitude: float, count: int) -> Array:
        phi, lam = np.radians([latitude, longitude])
        unit = [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)]
        return np.tile(7000.0 * np.array(unit), (count, 1))

    seen = [(14.0, 1.0, 20), (16.0, 1.0, 21), (14.0, -1.0, 19), (14.0, 14.0, 3), (-1.0, 16.0, 30)]
    made = _places(np.concatenate([at(*place) for place in seen]))
    assert made is not None
    found = made.columns(np.ones((len(made.number), 1)))
    assert found.sum(axis=0).tolist() == [30.0, 23.0, 21.0]
    assert found[:20, 1].all()
    assert found[60:63, 1].all()
    assert _places(at(14.0, 1.0, 60)) is None  # one alone says nothing


def test_a_family_in_the_body_has_each_signal_on_each_axis() -> None:
    unit = np.random.default_rng(6).normal(size=(5, 3))
    signals = np.random.default_rng(7).normal(size=(5, 2))
    flat = body_shape(Problem(scene(), NOISE_NT), "name", "says", signals).columns(unit)
    expected = [[s * u for s in row for u in direction] for row, direction in zip(signals, unit, strict=True)]
    assert flat == pytest.approx(np.array(expected))
    room = Problem(scene(), NOISE_NT, np.tile(np.eye(3), (COUNT, 1, 1)))
    assert body_shape(room, "name", "says", signals).columns(unit).shape == (15, 6)


def names_of(of: Scene, phase: Array | None = None, line_hz: float | None = None, room: bool = False) -> list[str]:
    problem = Problem(of, NOISE_NT, np.tile(np.eye(3), (COUNT, 1, 1)) if room else None)
    return [shape.name for shape in shapes(problem, phase, line_hz)]


def test_each_family_needs_its_means() -> None:
    """A bare recording has courses, stretches and the field; more comes with light, place, spin, a line, channels."""
    bare = replace(scene(), channels={}, position_ecef_km=None, body_from_eci=None)
    plain = ["slow 12", "slow 40", "time 24", "time 160", "field"]
    assert names_of(bare) == plain
    assert names_of(bare, room=True) == ["slow 12", "slow 40", "field"]
    assert names_of(bare, np.zeros(COUNT), 0.02) == [*plain, "line", "spin phase"]
    assert names_of(replace(scene(), channels={})) == [*plain, "sunlight", "place"]
    channels = {
        "one": Telemetry("one", "current", np.sin(TIME_S)[:, None]),
        "two": Telemetry("two", "current", np.stack([np.cos(TIME_S), np.ones(COUNT)], axis=1)),
    }
    assert names_of(replace(bare, channels=channels)) == [*plain, "channel one", "channel two 1"]


def columns_of(name: str, of: Scene, phase: Array | None = None, line_hz: float | None = None) -> Array:
    """Columns of a family by its name, seen along x alone."""
    found = {shape.name: shape for shape in shapes(Problem(of, NOISE_NT), phase, line_hz)}
    return found[name].columns(np.tile([1.0, 0.0, 0.0], (COUNT, 1)))[:, :: 1 if name.startswith("time") else 3]


def test_courses_and_stretches_span_the_recording() -> None:
    share = TIME_S / TIME_S[-1]
    assert columns_of("slow 12", scene()) == pytest.approx(np.cos(np.pi * np.outer(share, np.arange(1, 13))))
    assert columns_of("slow 40", scene()).shape == (COUNT, 40)
    assert columns_of("time 24", scene()).sum(axis=0) == pytest.approx(np.full(24, COUNT / 24), abs=2.0)
    assert columns_of("time 160", scene()).shape == (COUNT, 160)


def test_a_line_that_comes_and_goes_has_a_course_every_four_minutes() -> None:
    """At most 48 of them, at least four."""
    swinging = columns_of("line", scene(), line_hz=0.02)
    count = int(TIME_S[-1] / 240.0)
    assert swinging.shape == (COUNT, 2 * count)
    first = TIME_S[-1] / count > TIME_S
    assert swinging[first, 0] == pytest.approx(np.cos(2.0 * np.pi * 0.02 * TIME_S[first]))
    assert swinging[first, 1] == pytest.approx(np.sin(2.0 * np.pi * 0.02 * TIME_S[first]))
    assert not swinging[~first, 0].any()
    long = replace(scene(), time_s=3.0 * TIME_S, channels={}, position_ecef_km=None, body_from_eci=None)
    assert columns_of("line", long, line_hz=0.02).shape == (COUNT, 2 * 48)
    short = replace(long, time_s=0.02 * TIME_S)
    assert columns_of("line", short, line_hz=0.02).shape == (COUNT, 2 * 4)


def test_the_spins_phase_has_three_harmonics() -> None:
    phase = RATE_RAD_S * TIME_S
    expected = [f(k * phase) for k in (1, 2, 3) for f in (np.cos, np.sin)]
    assert columns_of("spin phase", scene(), phase) == pytest.approx(np.stack(expected, axis=1))


def test_sunlight_is_the_suns_direction_its_half_waves_and_light_itself() -> None:
    assert scene().sun_body is not None
    assert scene().lit is not None
    sun, lit = scene().sun_body, scene().lit
    expected = np.concatenate([sun, np.maximum(sun, 0.0), np.ones((COUNT, 1))], axis=1) * lit[:, None]
    assert columns_of("sunlight", scene()) == pytest.approx(expected)


# What is left


def structure(nats: float) -> Structure:
    return Structure(Shape("name", "says", lambda unit: unit), nats, 1.0, lambda: np.zeros(COUNT))


def test_a_family_counts_from_six_nats_on() -> None:
    assert [significant(structure(nats)) for nats in (5.9, 6.1)] == [False, True]


def worked_out(
    search: Search, fit: Fit, found: list[Structure], sigma_nt: float
) -> dict[str, tuple[float, float, Array]]:
    """Nats, squares and signal of each family at a noise, from its columns alone."""
    space = Workspace(fit.residual, fit.columns)
    families = [one.shape for one in found if one.shape.name != "transients"]
    known = {}
    for shape in families:
        columns = shape.columns(fit.unit)
        gain = space.gain(columns, sigma_nt)
        squares = max(gain.squares - gain.effective * sigma_nt**2, 0.0)
        cost = math.log(len(families))
        if shape.name == CYCLE:  # its period, and where each of its levels ends
            cost += math.log(COUNT) + columns.shape[1] // 3 * math.log(48)
        known[shape.name] = gain.nats - cost, squares, space.projected(columns) @ gain.amplitudes
    return known


def swaying(size_nt: float) -> Array:
    """Half a turn of a cosine along x over the recording (n, 3)."""
    return np.outer(size_nt * np.cos(np.pi * TIME_S / TIME_S[-1]), [1.0, 0.0, 0.0])


def test_a_structure_is_the_gain_of_its_columns_less_what_noise_gives() -> None:
    """Evidence less ln of how many families there are; squares less the noise's own; the signal that it finds."""
    search, fit = searched(flown(swaying(30.0)))
    found = structures(search, fit, None, FLOOR_NT)
    assert [one.nats for one in found] == sorted((one.nats for one in found), reverse=True)
    known = worked_out(search, fit, found, fit.rms_nt)
    for one in found:
        if one.shape.name == "transients":
            continue
        nats, squares, signal = known[one.shape.name]
        assert one.nats == pytest.approx(nats, abs=1e-6)
        assert one.squares == pytest.approx(squares, rel=1e-6)
        assert one.signal == pytest.approx(signal, abs=1e-6)


def test_what_one_family_holds_sharpens_the_look_at_all_of_them() -> None:
    """Beside a swing ten times the noise, evidence is counted at the noise that the best family leaves."""
    search, fit = searched(flown(swaying(800.0)))
    found = structures(search, fit, None, FLOOR_NT)
    first = worked_out(search, fit, found, fit.rms_nt)
    best = max(first.values(), key=lambda one: one[0])
    left = math.sqrt((float(fit.residual @ fit.residual) - best[1]) / COUNT)
    assert left < 0.5 * fit.rms_nt
    known = worked_out(search, fit, found, left)
    for one in found:
        if one.shape.name in known:
            assert one.nats == pytest.approx(known[one.shape.name][0], rel=1e-6)


def test_a_floor_keeps_a_look_from_becoming_too_sharp() -> None:
    search, fit = searched(flown())
    wide = structures(search, fit, None, 100.0 * NOISE_NT)
    assert max(one.nats for one in wide) < 0.0


def test_terms_of_a_family_are_those_that_were_put_in() -> None:
    """By By By on y and Bz Bz on z, with their sizes [nT rms]; a family without names has none, nor has noise."""
    products, names = _products(scene().clean_field_nt)
    field = np.zeros((COUNT, 3))
    field[:, 1], field[:, 2] = (400.0 * products[:, names.index(name)] for name in ("By By By", "Bz Bz"))
    search, fit = searched(flown(field))
    families = {one.shape.name: one for one in structures(search, fit, None, FLOOR_NT)}
    terms = dict(fitted_terms(families["field"], search, fit)[:2])
    assert set(terms) == {"By By By on y", "Bz Bz on z"}
    columns = field[:, 1:] * fit.unit[:, 1:]
    seen = columns - fit.columns @ np.linalg.lstsq(fit.columns, columns, rcond=None)[0]
    sizes = np.sqrt(np.mean(seen**2, axis=0))
    assert terms["By By By on y"] == pytest.approx(float(sizes[0]), rel=0.15)
    assert terms["Bz Bz on z"] == pytest.approx(float(sizes[1]), rel=0.15)
    assert fitted_terms(families["slow 12"], search, fit) == []
    quiet, at = searched(flown())
    families = {one.shape.name: one for one in structures(quiet, at, None, FLOOR_NT)}
    assert fitted_terms(families["field"], quiet, at) == []


# Where it sits


def test_a_change_is_located_at_its_instant() -> None:
    late = 300.0 * np.outer(TIME_S >= 5000.0, [0.0, 1.0, 0.0])
    search, fit = searched(flown(late))
    places = locate(search, fit)
    change = next(place for place in places if place.says.startswith("a change at "))
    assert change.at is not None
    assert change.at == pytest.approx(5000.0, abs=65.0)
    assert change.says == f"a change at {change.at:.0f} s"
    assert change.kind == "time"
    assert 0.8 < change.share <= 1.0


def test_a_line_is_located_at_its_frequency_with_its_share() -> None:
    """A swing of 200 nT beside noise of 80: most of what is beyond the noise, said in five digits."""
    swing = 200.0 * np.outer(np.sin(2.0 * np.pi * 0.0213 * TIME_S), [0.0, 0.6, 0.8])
    search, fit = searched(flown(swing))
    lines = [place for place in locate(search, fit) if place.kind == "frequency" and place.at is not None]
    assert lines[0].at == pytest.approx(0.0213, abs=0.3 / TIME_S[-1])
    assert lines[0].says == f"a line at {lines[0].at:.5g} Hz in the body"
    assert lines[0].share > 0.9


def test_nothing_is_located_in_noise_and_what_is_located_is_sorted() -> None:
    assert locate(*searched(flown())) == []
    places = locate(*searched(flown(swaying(200.0))))
    assert len(places) > 2
    assert [place.significance for place in places] == sorted((place.significance for place in places), reverse=True)
    assert all(place.significance > 5.0 for place in places)


def test_every_family_has_its_kind_of_place() -> None:
    """Told from its name; a channel's by its own."""
    search, fit = searched(flown())
    kinds = {
        "line": "frequency",
        "cycle": "frequency",
        "wandering": "frequency",
        "slow 40": "time",
        "time 24": "time",
        "transients": "time",
        "field": "field",
        "spin phase": "phase",
        "sunlight": "light",
        "place": "place",
        "channel of 2": "channel",
    }
    found = [Structure(Shape(name, "says", lambda u: u), 90.0, 2.0, lambda: np.zeros(COUNT)) for name in kinds]
    places = {place.says: place for place in locate(search, fit, found)}
    assert {f"says ({name})": kind for name, kind in kinds.items()} == {
        says: place.kind for says, place in places.items()
    }


def test_significance_pays_for_the_places_that_were_looked_at() -> None:
    """Families, the change and the lines: ln of their number is taken off, and five nats more are asked for."""
    search, fit = searched(flown())
    looked = math.log(2 + 1 + 4)
    found = [
        Structure(Shape("field", "says", lambda u: u), nats, 2.0, lambda: np.zeros(COUNT))
        for nats in (looked + 5.1, looked + 4.9)
    ]
    (place,) = locate(search, fit, found)
    assert place.significance == pytest.approx(5.1)
    excess = float(fit.residual @ fit.residual) - COUNT * NOISE_NT**2
    assert place.share == pytest.approx(min(1.0, 2.0 / max(2.0, excess)), rel=0.2)


def test_a_place_as_json_is_rounded() -> None:
    place = Place("time", "says", 0.123456, 7.891, 12.0)
    expected = {"kind": "time", "says": "says", "share": 0.1235, "significance_nats": 7.89, "at": 12.0}
    assert place.as_json() == expected


RATE_HZ = 1.0 / PERIOD_S


@pytest.mark.parametrize(
    ("frequency", "spin_hz", "words"),
    [
        (0.0334, 0.0334, ", at the spin"),
        (0.0345, 0.0334, ", at the spin"),
        (0.0347, 0.0334, ""),
        (0.0668, 0.0334, ", at twice the spin"),
        (0.1002, 0.0334, ", at three times the spin"),
        (RATE_HZ - 0.18, 0.09, ", at twice the spin, an alias"),
        (0.27 - RATE_HZ, 0.09, ", at three times the spin, an alias"),
        (0.0334, None, ""),
    ],
)
def test_a_line_at_the_spin_or_its_alias_is_said_to_be(frequency: float, spin_hz: float | None, words: str) -> None:
    assert _coincidence(frequency, spin_hz, PERIOD_S) == words


def test_single_samples_far_out_are_no_shape() -> None:
    """Two where the Sun stands as it seldom does: a function of its direction follows them, and by 9 sigma is sure."""
    seldom = _seldom("follows the Sun")
    search, fit = searched(flown(grown_nt=-9.0 * NOISE_NT * np.isin(np.arange(COUNT), seldom)))
    assert not any(significant(one) for one in structures(search, fit, None, FLOOR_NT))


def _seldom(family: str) -> Array:
    """The two rows that a family of shapes follows most easily: largest on the diagonal of its projection."""
    search, fit = searched(flown())
    shape = next(one for one in shapes(search.problem, None, None) if family in one.says)
    columns = search.workspace(fit).projected(shape.columns(fit.unit))
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    return np.argsort(-((basis**2).sum(axis=1)))[:2]


def test_what_lasts_is_a_shape_however_far_out_it_is() -> None:
    """Of ten times the noise for two minutes hardly anything is lost by what a single sample counts for at the most."""
    lasting = 10.0 * NOISE_NT * (np.abs(TIME_S - 4000.0) < 60.0)
    search, fit = searched(flown(grown_nt=lasting))
    best = structures(search, fit, None, FLOOR_NT)[0]
    assert significant(best)
    assert best.squares > 0.7 * float(np.sum(fit.residual**2) - COUNT * NOISE_NT**2)
