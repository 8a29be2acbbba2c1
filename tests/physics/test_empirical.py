"""[[empirical]]: every bit comes back, faults are named, and a curve acts inside its range only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import Empirical, Kind, hats
from magcal_service.physics.apply.forward import DriverMissingError
from magcal_service.physics.apply.model_file import ModelError, PhysicsModel, parse_model, text_of
from magcal_service.physics.drivers.computed import COMPUTED, driver_values
from sim_sensor.simulation import Simulation
from tests.physics.given_scene import flight
from tests.physics.live_models import model_of
from tests.physics.modelled import effects_on
from tests.physics.test_model_file import model
from tests.physics.test_simulated_physics import cold

KNOTS = np.array([10.0, 20.0, 24.0, 30.0])
FIELD = np.array([[1.0, 0.0, -2.0], [4.0, 1.0 / 3.0, 0.0], [7.0, 1.0, 5.0], [-1.0, 2.0, 0.5]]) * 100.0
BIAS = Empirical(
    driver="channel:temperature",
    kind=Kind.BIAS,
    quantity="temperature",
    column=0,
    knots=KNOTS,
    values=FIELD,
    sigma=np.abs(FIELD) / 7.0,
    span=(10.0, 30.0),
)
GAIN = replace(BIAS, kind=Kind.GAIN, values=1e-5 * FIELD, sigma=1e-7 * np.abs(FIELD))
GROWTH = replace(
    BIAS, driver="computed:latitude", kind=Kind.MAGNITUDE, quantity="", values=FIELD[:, 0], sigma=np.zeros(4)
)


def with_curves(*curves: Empirical) -> PhysicsModel:
    return model(empirical=curves)


def test_a_curve_keeps_every_bit() -> None:
    again = parse_model(text_of(with_curves(BIAS, GAIN, GROWTH)).encode())
    assert text_of(again) == text_of(with_curves(BIAS, GAIN, GROWTH))
    for own, back in zip((BIAS, GAIN, GROWTH), again.empirical, strict=True):
        assert (own.driver, own.kind, own.quantity, own.column, own.span) == (
            back.driver,
            back.kind,
            back.quantity,
            back.column,
            back.span,
        )
        for name in ("knots", "values", "sigma"):
            assert np.array_equal(getattr(own, name), getattr(back, name))
        assert back.interpolating_only


def test_a_file_without_curves_has_no_table_of_them() -> None:
    assert "empirical" not in text_of(model())
    assert parse_model(text_of(model()).encode()).empirical == ()


FAULTS = (
    ("channel:temperature", "elapsed_time", "driver", '"channel:NAME" or "computed:NAME"'),
    ("channel:temperature", "computed:latitud", "driver", "did you mean 'latitude'?"),
    ('kind = "bias"', 'kind = "offset"', "kind", "bias"),
    ('quantity = "temperature"', 'quantity = "warmth"', "quantity", "temperature"),
    ("column = 0", "column = 64", "column", "63"),
    ("knots = [10.0, 20.0,", "knots = [20.0, 20.0,", "knots", "rising"),
    ("knots = [10.0, 20.0, 24.0, 30.0]", "knots = [10.0]", "knots", "2 to 21"),
    ("knots = [10.0,", "knots = [nan,", "knots", "finite"),
    ("values = [[100.0,", "values = [[1e7,", "values", "-1e+06 to 1e+06"),
    ("values = [[100.0, 0.0, -200.0], ", "values = [", "values", "three numbers for each of the 4 knots"),
    ("sigma = [[", "sigma = [[-", "sigma", "none below 0"),
    ("range = [10.0, 30.0]", "range = [9.0, 30.0]", "range", "from 10.0 to 30.0"),
    ("range = [10.0, 30.0]", "range = [30.0, 10.0]", "range", "two rising numbers"),
    ("interpolating_only = true", "interpolating_only = false", "interpolating_only", "true is accepted"),
    ("interpolating_only = true", "", "interpolating_only", "missing; true is accepted"),
    ("interpolating_only = true", "interpolating_only = true\ncolour = 1", "colour", "unknown key"),
)


@pytest.mark.parametrize(("old", "new", "where", "accepted"), FAULTS, ids=[f"{one[2]}-{one[1]}" for one in FAULTS])
def test_a_fault_is_named_with_what_is_accepted(old: str, new: str, where: str, accepted: str) -> None:
    text = text_of(with_curves(BIAS))
    assert text.count(old) == 1
    with pytest.raises(ModelError) as caught:
        parse_model(text.replace(old, new).encode())
    lines = [
        line for line in str(caught.value).splitlines() if line.startswith(f"physics.toml: empirical[0].{where}: ")
    ]
    assert len(lines) == 1
    assert accepted in lines[0]


@pytest.mark.parametrize("driver", [f"computed:{name}" for name, one in COMPUTED.items() if one.of_sensor])
def test_no_reference_grows_by_what_the_sensor_reads(driver: str) -> None:
    text = text_of(with_curves(GROWTH)).replace("computed:latitude", driver)
    with pytest.raises(ModelError, match=r"empirical\[0\]\.kind: 'magnitude' is refused; a reference cannot follow"):
        parse_model(text.encode())


def test_a_quantity_of_what_is_computed_is_refused() -> None:
    text = text_of(with_curves(GROWTH)).replace('kind = "magnitude"', 'kind = "magnitude"\nquantity = "angle"')
    with pytest.raises(ModelError, match=r"empirical\[0\]\.quantity: 'angle' is refused"):
        parse_model(text.encode())


@pytest.mark.parametrize(("count", "accepted"), [(8, True), (9, False)])
def test_a_file_has_at_most_eight_curves(count: int, accepted: bool) -> None:
    text = text_of(with_curves(*[BIAS] * count)).encode()
    if accepted:
        assert len(parse_model(text).empirical) == count
    else:
        with pytest.raises(ModelError, match=r"^physics.toml: empirical: 9 is refused; at most 8"):
            parse_model(text)


def test_a_curve_is_straight_between_its_knots_and_nothing_beyond_its_range() -> None:
    narrow = replace(BIAS, span=(12.0, 30.0))
    x = np.array([9.999, 10.0, 11.999, 12.0, 15.0, 20.0, 22.0, 30.0, 30.001])
    found = narrow.at(x)[:, 0]
    assert found == pytest.approx([0.0, 0.0, 0.0, 160.0, 250.0, 400.0, 550.0, -100.0, 0.0])


def test_weights_of_the_knots_make_the_curve() -> None:
    x = np.linspace(10.0, 30.0, 77)
    assert hats(x, KNOTS) @ FIELD == pytest.approx(BIAS.at(x))


def interpolated(x: Array) -> Array:
    inside = (x >= 10.0) & (x <= 30.0)
    return np.stack([np.interp(x, KNOTS, column) * inside for column in FIELD.T], axis=1)


def test_what_curves_add_to_a_scene() -> None:
    """A bias along its driver, a gain against the measured vector, a growth of the magnitude by latitude."""
    scene = flight()
    expected = interpolated(scene.channels["temperature"].values[:, 0])
    assert 0.1 < float(np.mean(expected[:, 0] == 0.0)) < 0.9  # the scene leaves the range, and comes into it
    body, growth = effects_on(scene, with_curves(BIAS))
    assert body == pytest.approx(expected)
    assert not growth.any()
    body, _ = effects_on(scene, with_curves(GAIN))
    assert body == pytest.approx(-1e-5 * expected * scene.clean_field_nt)
    body, growth = effects_on(scene, with_curves(GROWTH))
    latitude = driver_values(scene, "computed:latitude")
    assert latitude is not None
    assert growth == pytest.approx(interpolated(latitude)[:, 0])
    assert not body.any()
    assert np.abs(growth).max() > 1.0


@pytest.mark.parametrize("change", [{"driver": "channel:none"}, {"quantity": "current"}, {"column": 1}])
def test_a_scene_without_the_driver_is_refused_by_name(change: dict[str, object]) -> None:
    with pytest.raises(DriverMissingError, match=r"^empirical: driver 'channel:"):
        effects_on(flight(), with_curves(replace(BIAS, **change)))  # type: ignore[arg-type]


def test_every_computed_driver_is_there_on_a_whole_scene() -> None:
    scene = flight()
    assert scene.sun_body is not None
    assert scene.lit is not None
    for name in COMPUTED:
        values = driver_values(scene, f"computed:{name}")
        assert values is not None, name
        assert values.shape == (len(scene),), name
        assert np.ptp(values) > 0.0, name
    along = driver_values(scene, "computed:sun_y")
    assert along == pytest.approx(scene.sun_body[:, 1] * scene.lit)
    assert driver_values(scene, "computed:field_xz") == pytest.approx(
        scene.calibrated_nt[:, 0] * scene.calibrated_nt[:, 2]
    )
    bare = replace(scene, position_ecef_km=None, body_from_eci=None)
    there = [name for name in COMPUTED if driver_values(bare, f"computed:{name}") is not None]
    assert there == ["field_size", "field_x", "field_y", "field_z", "field_xy", "field_xz", "field_yz"]


def test_the_simulator_adds_a_curve() -> None:
    """What is measured more is (I + D)^-1 of the curve at the scenario's temperature."""
    scenario = replace(cold(), sensor=replace(cold().sensor, noise_nt=(0.0, 0.0, 0.0)))
    curve = replace(BIAS, knots=KNOTS - 5.0, span=(5.0, 25.0))
    plain, bent = (
        Simulation(scenario, 1, 900.0, model_of(origin_ns=scenario.start_ns, empirical=curves))
        for curves in ((), (curve,))
    )
    x = bent.environment.temperature_degc(bent.elapsed_s(bent.arrays().times_ns))
    added = bent.arrays().measured_nt - plain.arrays().measured_nt
    inverse = np.linalg.inv(np.eye(3) + np.array([[0.05, 0.05, 0.05], [0.05, 0.10, 0.05], [0.05, 0.05, 0.05]]))
    assert added == pytest.approx(curve.at(x) @ inverse.T, abs=1e-6)
    assert np.abs(added).max() > 50.0


def test_the_simulator_refuses_a_curve_whose_driver_it_lacks(tmp_path: Path) -> None:
    wind = replace(BIAS, driver="channel:wind")
    with pytest.raises(ConfigError, match=r"physics: empirical\.driver: 'channel:wind' is refused"):
        Simulation(cold(), 1, 60.0, model_of(origin_ns=0, empirical=(wind,)))
