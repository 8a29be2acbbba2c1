"""A curve before it is fitted, and the drivers that one recording has for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.apply.empirical import NAME, Empirical, Kind, hats
from magcal_service.physics.columns import Columns, along_axes, gains
from magcal_service.physics.drivers.computed import COMPUTED, driver_unit, driver_values
from magcal_service.physics.interface import Block, Hypothesis
from magcal_service.physics.scene.scene import Scene

ELAPSED: Final = "elapsed_time"
"""Driver of a course over the recording's own time."""

_EDGE: Final = 0.005
"""Share of the samples at each end of a driver's values that lie beyond the range: single values hold no curve."""

_FEWEST_IN_RANGE: Final = 100
"""Samples inside the range from which on a curve is tried."""

_SAME_FIELD: Final = 0.01
"""Of the field's size, what it has to change by to drive anything: less is a place within a field."""

_CLOCK: Final = 0.98
"""Rank correlation with time from which on a driver is a clock: the recording cannot tell it from elapsed time."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """A curve before it is fitted: driver, kind, knots (k,), and the mean (k,) of their weights over the samples."""

    driver: str
    kind: Kind
    quantity: str
    column: int
    knots: Array
    mean: Array

    def hypothesis(self, scene: Scene, largest_nt: float) -> Hypothesis:
        """As the fit takes it, on a scene."""
        return Hypothesis(
            NAME,
            self.driver,
            lambda _: self._columns(scene),
            (Block("values", self.kind.unit, (len(self.knots), self.kind.axes)),),
            variant=f"{self.kind} {self.column}",
            largest_nt=largest_nt,
        )

    def _columns(self, scene: Scene) -> Columns:
        x = values_of(scene, self.driver, self.column, self.quantity)
        assert x is not None, "the driver was there when the form was made"
        weights = hats(x, self.knots) - self.mean
        weights[(x < self.knots[0]) | (x > self.knots[-1])] = 0.0
        if self.kind is Kind.MAGNITUDE:
            return Columns(magnitude=np.ascontiguousarray(weights.T))
        return along_axes(weights) if self.kind is Kind.BIAS else gains(scene.clean_field_nt, weights)

    def curve(self, amplitudes: Array, covariance: Array) -> Empirical:
        """As ``physics.toml`` has it: values beyond the mean, of amplitudes (k a,) with covariance (k a, k a)."""
        count = self.kind.axes
        centred = np.eye(len(self.knots)) - np.outer(np.ones(len(self.knots)), self.mean)
        spread = np.kron(centred, np.eye(count))
        shape = (len(self.knots),) if self.kind is Kind.MAGNITUDE else (len(self.knots), count)
        sigma = np.sqrt(np.maximum(np.diagonal(spread @ covariance @ spread.T), 0.0))
        return Empirical(
            driver=self.driver,
            kind=self.kind,
            quantity=self.quantity,
            column=self.column,
            knots=self.knots,
            values=(spread @ amplitudes).reshape(shape),
            sigma=sigma.reshape(shape),
            span=(float(self.knots[0]), float(self.knots[-1])),
        )


def unit_of(curve: Empirical) -> str:
    """Unit of a curve's driver, elapsed time among them."""
    return "s" if curve.driver == ELAPSED else driver_unit(curve.driver, curve.quantity)


def values_of(scene: Scene, driver: str, column: int = 0, quantity: str = "") -> Array | None:
    """Values (n,) of a driver, elapsed time among them; None where the scene lacks it."""
    return scene.time_s if driver == ELAPSED else driver_values(scene, driver, column, quantity)


def drivers_of(scene: Scene, with_sun: bool) -> Iterator[tuple[str, int, str]]:
    """Driver, column and quantity of what changes here and is no clock."""
    recorded = [(f"channel:{c.name}", i, c.quantity) for c in scene.channels.values() for i in range(c.values.shape[1])]
    computed = [
        (f"computed:{name}", 0, "")
        for name in COMPUTED
        if with_sun or not name.startswith("sun_") or name == "sun_zenith"
    ]
    for driver, column, quantity in [*recorded, *computed]:
        values = driver_values(scene, driver, column, quantity)
        if values is None or not np.isfinite(values).all():
            continue
        least = _SAME_FIELD * float(np.mean(values)) if driver == "computed:field_size" else 0.0
        if np.ptp(values) > least and not _once(scene, driver, f"clock {column}", partial(_is_clock, values)):
            yield driver, column, quantity


def _once(scene: Scene, driver: str, name: str, make: Callable[[], T]) -> T:
    """What follows of a driver's values alone, made once of a channel; what is computed of the field may change."""
    return scene.once(f"{name} of {driver}", make) if driver.startswith("channel:") else make()


def _is_clock(values: Array) -> bool:
    """Whether values (n,) only rise or only fall with time."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(len(values))
    ties = np.unique(values, return_inverse=True)[1]
    mean = np.bincount(ties, weights=rank) / np.bincount(ties)
    return bool(abs(np.corrcoef(mean[ties], np.arange(len(values)))[0, 1]) > _CLOCK)


def form_of(scene: Scene, driver: str, column: int, quantity: str, kind: Kind, count: int) -> Form | None:
    """Knots at equal shares of the samples; None where too few values are told apart."""
    x = values_of(scene, driver, column, quantity)
    assert x is not None
    edge = 0.0 if driver == ELAPSED else _EDGE
    knots = _once(scene, driver, f"{count} knots over {column}", partial(_knots, x, edge, count))
    return None if knots is None else Form(driver, kind, quantity, column, *knots)


def _knots(x: Array, edge: float, count: int) -> tuple[Array, Array] | None:
    """Knots (k,) at equal shares of values (n,), with the mean weight of each; None where too few are told apart."""
    knots = np.unique(np.quantile(x, np.linspace(edge, 1.0 - edge, count)))
    inside = (x >= knots[0]) & (x <= knots[-1])
    if len(knots) < 2 or np.count_nonzero(inside) < _FEWEST_IN_RANGE:
        return None
    return knots, hats(x[inside], knots).mean(axis=0)
