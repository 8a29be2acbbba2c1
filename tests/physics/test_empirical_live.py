"""A curve without a name, live: what the recording would be given, inside its range only, and said where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import d_matrix
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.empirical import Empirical, Kind
from magcal_service.physics.apply.model_file import ModelSpin
from magcal_service.physics.drivers.computed import COMPUTED, driver_values
from magcal_service.wire.messages import TelemetrySample, Vector
from tests.physics.given_scene import X, flight
from tests.physics.live_models import craft, hot, last_estimate, model_of, physics, stream
from tests.physics.modelled import effects_on
from tests.physics.test_compensation import feed
from tests.physics.test_empirical import BIAS, FIELD

LIVE_ROWS = 120


def over(driver: str, kind: Kind = Kind.BIAS, share: tuple[float, float] = (0.0, 1.0), **changes: object) -> Empirical:
    """A curve over what a driver does in the first rows, for use between two shares of its range."""
    channel = driver.partition(":")[2] if driver.startswith("channel:") else ""
    quantity = flight().channels[channel].quantity if channel else ""
    column = int(changes.pop("column", 0))  # type: ignore[call-overload]
    values = driver_values(flight(), driver, column, quantity)
    assert values is not None
    low, high = float(values[:LIVE_ROWS].min()), float(values[:LIVE_ROWS].max())
    wide = 0.02 * (high - low)
    knots = np.linspace(low - wide, high + wide, 4)
    span = tuple(float(knots[0] + part * (knots[-1] - knots[0])) for part in share)
    numbers = FIELD[:, 0] if kind is Kind.MAGNITUDE else 1e-5 * FIELD if kind is Kind.GAIN else FIELD
    return Empirical(driver, kind, quantity, column, knots, numbers, np.zeros_like(numbers), (span[0], span[1]))


def compensation_of(*curves: Empirical, spin: ModelSpin | None = None) -> Compensation:
    return Compensation(model_of(origin_ns=flight().origin_ns, x=X, empirical=curves, spin=spin))


BY_FIELD = [
    ("channel:temperature", Kind.BIAS, 0),
    ("channel:temperature", Kind.GAIN, 0),
    ("channel:boards", Kind.BIAS, 1),
    *((f"computed:{name}", Kind.BIAS, 0) for name in COMPUTED if name not in ("light", "sun_x", "sun_y", "sun_z")),
    ("computed:field_x", Kind.GAIN, 0),
]


@pytest.mark.parametrize(("driver", "kind", "column"), BY_FIELD, ids=[f"{one[1]}-{one[0]}" for one in BY_FIELD])
def test_what_is_taken_off_live_is_what_the_recording_would_be_given(driver: str, kind: Kind, column: int) -> None:
    curve = over(driver, kind, column=column)
    body, _ = effects_on(flight(), model_of(origin_ns=flight().origin_ns, x=X, empirical=(curve,)))
    compensation = compensation_of(curve)
    taken = np.zeros((LIVE_ROWS, 3))
    for row in range(LIVE_ROWS):
        _, sample = feed(compensation, row)
        assert compensation.missing == ()
        taken[row] = (np.eye(3) + d_matrix(X)) @ (flight().field_nt[row] - np.array(sample.field_body_nt))
    assert taken == pytest.approx(body[:LIVE_ROWS], abs=0.01)
    assert np.abs(taken).max() > 0.1


@pytest.mark.parametrize("driver", ["channel:temperature", "computed:latitude", "computed:field_size"])
def test_a_reference_grows_by_a_curve(driver: str) -> None:
    """As computed once a second, and held for the half second between."""
    curve = over(driver, Kind.MAGNITUDE)
    _, growth = effects_on(flight(), model_of(origin_ns=flight().origin_ns, x=X, empirical=(curve,)))
    compensation = compensation_of(curve)
    for row in range(LIVE_ROWS):
        reference, sample = feed(compensation, row)
        assert reference.field_nt is not None
        assert np.linalg.norm(reference.field_nt) - flight().magnitude_nt[row] == pytest.approx(growth[row], abs=0.01)
        assert sample.field_body_nt == tuple(flight().field_nt[row])
    assert np.ptp(growth[:LIVE_ROWS]) > 100.0


@pytest.mark.parametrize("kind", list(Kind))
def test_beyond_its_range_nothing_is_applied_and_that_is_said(kind: Kind) -> None:
    curve = over("channel:temperature", kind, share=(0.3, 0.7))
    compensation = compensation_of(curve)
    inside = curve.covers(flight().channels["temperature"].values[:LIVE_ROWS, 0])
    assert 0.2 < inside.mean() < 0.8
    for row in range(LIVE_ROWS):
        reference, sample = feed(compensation, row)
        assert compensation.missing == (() if inside[row] else ("empirical.driver_outside",))
        assert reference.field_nt is not None
        changed = (
            abs(float(np.linalg.norm(reference.field_nt)) - flight().magnitude_nt[row]) > 1e-6
            if kind is Kind.MAGNITUDE
            else sample.field_body_nt != tuple(flight().field_nt[row])
        )
        assert changed == inside[row]


@pytest.mark.parametrize(
    "change", [{"driver": "channel:none"}, {"quantity": "current"}, {"column": 1}, {"driver": "computed:sun_x"}]
)
def test_a_driver_that_is_not_there_is_named_and_the_sample_left_alone(change: dict[str, object]) -> None:
    compensation = compensation_of(replace(over("channel:temperature"), **change))  # type: ignore[arg-type]
    _, sample = feed(compensation, 0)
    assert compensation.missing == ("empirical",)
    assert sample.field_body_nt == tuple(flight().field_nt[0])


def test_the_others_are_compensated_where_one_is_not() -> None:
    good, lost = over("channel:temperature"), replace(over("channel:temperature"), driver="channel:none")
    alone, both = compensation_of(good), compensation_of(good, lost)
    assert feed(alone, 0)[1] == feed(both, 0)[1]
    assert (alone.missing, both.missing) == ((), ("empirical",))


def test_an_absurd_curve_is_left_out() -> None:
    huge = replace(over("channel:temperature"), values=np.full((4, 3), 9e11))
    compensation = compensation_of(huge)
    _, sample = feed(compensation, 0)
    assert compensation.missing == ("empirical",)
    assert sample.field_body_nt == tuple(flight().field_nt[0])
    grown = compensation_of(replace(over("channel:temperature", Kind.MAGNITUDE), values=np.full(4, 9e5)))
    feed(grown, 0)
    assert grown.missing == ("empirical",)


def test_only_a_curve_over_the_sun_waits_for_the_spin_axis() -> None:
    spin = ModelSpin((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 0.785)
    elsewhere = replace(feed(compensation_of(), 0)[1], time_ns=flight().origin_ns + 86_400 * 10**9)
    for driver, waits in (("channel:temperature", False), ("computed:latitude", False), ("computed:sun_x", True)):
        curve = over("channel:temperature") if driver.startswith("channel") else over(driver)
        assert compensation_of(curve, spin=spin).begins_elsewhere(elsewhere) is waits, driver


def test_a_restored_compensation_goes_on_bit_for_bit() -> None:
    curves = over("channel:temperature"), over("computed:latitude", Kind.MAGNITUDE)
    one, two = compensation_of(*curves), compensation_of(*curves)
    for row in range(20):
        feed(one, row)
    two.restore_state(one.export_state())
    assert [feed(one, row) for row in range(20, 40)] == [feed(two, row) for row in range(20, 40)]


def test_a_craft_says_counts_and_doubts_what_is_beyond_the_range() -> None:
    """As of an effect whose driver is missing; once the channel is silent it is missing."""
    scenario = hot()
    messages = stream(scenario, 300.0)
    curve = replace(BIAS, values=0.0 * BIAS.values, knots=BIAS.knots + 500.0, span=(510.0, 530.0))
    pipeline = Pipeline(craft("hot", physics(origin_ns=scenario.start_ns, empirical=(curve,))))
    estimate = last_estimate(pipeline, messages)
    assert "driver_missing" in estimate.reasons
    assert pipeline.counters["uncompensated.empirical.driver_outside"] == 300
    assert "empirical.driver_outside" in pipeline.summary()
    silent = tuple(m for m in messages if not isinstance(m, TelemetrySample))
    pipeline = Pipeline(craft("hot", physics(origin_ns=scenario.start_ns, empirical=(curve,))))
    last_estimate(pipeline, silent)
    assert pipeline.counters["uncompensated.empirical"] == 300
    assert "uncompensated.empirical.driver_outside" not in pipeline.counters


def test_a_craft_with_a_curve_of_nothing_publishes_what_one_without_does() -> None:
    scenario = hot()
    messages = stream(scenario, 200.0)
    nothing = replace(BIAS, values=0.0 * BIAS.values, knots=np.array([-100.0, 0.0, 50.0, 100.0]), span=(-100.0, 100.0))
    vectors: list[list[Vector]] = []
    for model in (None, physics(origin_ns=scenario.start_ns, empirical=(nothing,))):
        pipeline = Pipeline(craft("hot", model))
        outputs = [out for message in messages for out in pipeline.handle(message)]
        vectors.append([out.field_body_nt for out in outputs if hasattr(out, "field_body_nt")])
    assert vectors[0] == vectors[1]
    assert len(vectors[0]) >= 200
