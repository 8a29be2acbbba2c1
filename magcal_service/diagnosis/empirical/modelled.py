"""What has no name, as curves over drivers that are there again on another day, kept if held-out blocks gain.

A curve is piecewise linear over the driver's recorded range: a growth of the magnitude, a body field or a gain per
axis (``physics.apply.empirical``).  It is fitted together with the nine errors and the effects beside it, under a prior
of the size of the residual.  Driver, kind and number of knots are chosen by the residual on blocks that took no part.
It says nothing of a cause.

Where no such driver holds anything, a course over the recording's own time is fitted, which is of no use elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.doubts import FEWEST_SAMPLES, STANDS_OUT
from magcal_service.diagnosis.empirical.curves import ELAPSED, Form, drivers_of, unit_of
from magcal_service.diagnosis.empirical.gain import forward_rms_nt, gain_in_blocks, gain_of
from magcal_service.diagnosis.empirical.trials import Trial, trials_of
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.term_columns import amplitude_columns
from magcal_service.model import BIAS, STATE_SIZE, d_matrix
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.apply.empirical import NAME, Empirical
from magcal_service.physics.interface import Effect

MOST_CURVES: Final = 3
"""Curves of one recording, one driver each; as many as it has effects (``MOST_EFFECTS``)."""

_FITTED: Final = 3
"""Of the curves tried, those fitted jointly, one after another until one stands; choice: each is a whole fit."""

_WORTH_FITTING: Final = 2.0
"""Standard errors of the gain, to first order, from which on a joint fit is tried: one that stands at 3 has as much."""

_WIDE: Final = 3.0
"""Times the residual's rms, what a knot may add: of a body field the residual sees one part only."""

_ALIKE: Final = 0.9
"""Share of the best curve's drop in held-out squares from which a curve over another driver is reported beside it."""


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """What has no name, modelled.

    Parameters
    ----------
    before, fit: nine errors and effects, without and with the curves.
    curves: the curves.
    standard_errors: by how many of its errors over blocks the held-out gain stands out.
    seen, blocks: in how many blocks it gains, of how many.
    forward_nt: rms of the last third, foretold from the rest, without and with the curves [nT]; None where the drivers
        had no such values before.
    alike: other drivers that do nearly as well.
    """

    before: Fit
    fit: Fit
    curves: tuple[Empirical, ...]
    standard_errors: float
    seen: int
    blocks: int
    forward_nt: tuple[float, float] | None
    alike: tuple[str, ...]

    @property
    def held_out_rms_nt(self) -> tuple[float, float]:
        """rms on blocks that took no part, without and with the curves [nT]."""
        return self.before.held_out_rms_nt, self.fit.held_out_rms_nt

    @property
    def is_usable(self) -> bool:
        """Whether it may be used on another day, inside its range: a course over time has none there."""
        return all(curve.driver != ELAPSED for curve in self.curves)

    def as_json(self) -> dict[str, Any]:
        """For ``diagnosis.json``."""
        return {
            "curves": [_as_json(curve) for curve in self.curves],
            "held_out_rms_nt": _pair(self.held_out_rms_nt),
            "forward_rms_nt": None if self.forward_nt is None else _pair(self.forward_nt),
            "gain_standard_errors": round(self.standard_errors, 2),
            "gains_in_blocks": [self.seen, self.blocks],
            "usable_elsewhere": self.is_usable,
            "interpolating_only": True,
            "outside": "not applied (driver_outside)",
            "alike": list(self.alike),
            "bias_nt": self.fit.x[BIAS].tolist(),
            "D": d_matrix(self.fit.x[:STATE_SIZE]).tolist(),
        }


def modelled(search: Search, fit: Fit, floor_nt: float, with_sun: bool) -> Modelled | None:
    """The curves that lower a residual most on held-out blocks; None where no gain stands out of its scatter.

    Parameters
    ----------
    search: as it has explained.
    fit: nine errors and effects.
    floor_nt: least noise that evidence is counted in [nT].
    with_sun: whether the craft's attitude can be had on another day, as a steady spin's.
    """
    if len(fit.problem.scene) < FEWEST_SAMPLES or is_collapsed(fit.x):
        return None
    largest_nt = _WIDE * fit.rms_nt
    found: Modelled | None = None
    taken = {term.hypothesis.driver for term in fit.terms}
    if any(driver.startswith("inferred") for driver in taken):  # the same light under another name
        taken |= {f"computed:{name}" for name in ("light", "sun_zenith", "sun_x", "sun_y", "sun_z")}
    forms: list[Form] = []
    while len(forms) < MOST_CURVES:
        before = fit if found is None else found.fit
        drivers = [one for one in drivers_of(before.problem.scene, with_sun) if one[0] not in taken]
        larger = _larger(search, fit, before, forms, drivers, largest_nt, floor_nt)
        if larger is None:
            break
        found, form = larger
        forms.append(form)
        taken.add(form.driver)
    if found is not None:
        return found
    larger = _larger(search, fit, fit, [], [(ELAPSED, 0, "")], largest_nt, floor_nt)
    return None if larger is None else larger[0]


def _pair(rms_nt: tuple[float, float]) -> dict[str, float]:
    return {"before": rms_nt[0], "after": rms_nt[1]}


def _as_json(curve: Empirical) -> dict[str, Any]:
    return {
        "driver": curve.driver,
        "quantity": curve.quantity,
        "column": curve.column,
        "driver_unit": unit_of(curve),
        "kind": str(curve.kind),
        "form": f"piecewise linear, {len(curve.knots)} knots",
        "knots": curve.knots.tolist(),
        "values": curve.values.tolist(),
        "sigma": curve.sigma.tolist(),
        "unit": curve.kind.unit,
        "range": list(curve.span),
    }


def _larger(
    search: Search,
    fit: Fit,
    before: Fit,
    forms: Sequence[Form],
    drivers: Sequence[tuple[str, int, str]],
    largest_nt: float,
    floor_nt: float,
) -> tuple[Modelled, Form] | None:
    """One curve more than ``before`` has, ``forms``; None where no gain stands out."""
    trials = trials_of(search, before, drivers, largest_nt, floor_nt)
    worth = [
        one for one in trials if gain_in_blocks(before.held_out_white, one.residual, before.problem)[0] > _WORTH_FITTING
    ]
    for best in worth[:_FITTED]:
        trial = _fitted(search, before, [*forms, best.form], best, largest_nt)
        both = [*forms, best.form]
        if not _stands(before, trial, both):
            continue
        curves, alike = _curves(trial, both), _alike(before, trials, best)
        return Modelled(fit, trial, curves, *gain_of(fit, trial), forward_rms_nt(fit, trial, both), alike), best.form
    return None


def _stands(before: Fit, trial: Fit, forms: Sequence[Form]) -> bool:
    """Whether a gain stands out of its scatter.

    Of what is to be used elsewhere also in a fit that has arrived, and forward in time.
    """
    gain = gain_of(before, trial)[0]
    left = [fit.held_out_rms_nt / fit.noise_gain for fit in (before, trial)]
    if is_collapsed(trial.x) or gain < STANDS_OUT or not left[1] < left[0]:
        return False
    if forms[-1].driver == ELAPSED:
        return True
    forward_nt = forward_rms_nt(before, trial, forms)
    return trial.converged and forward_nt is not None and forward_nt[1] < forward_nt[0]


def _alike(before: Fit, trials: Sequence[Trial], best: Trial) -> tuple[str, ...]:
    """Other drivers whose curve lowers the held-out squares nearly as much."""
    whole = float((before.held_out_white**2).sum())
    close = (one.form.driver for one in trials if whole - one.left > _ALIKE * (whole - best.left))
    return tuple(driver for driver in dict.fromkeys(close) if driver != best.form.driver)


def _fitted(search: Search, before: Fit, forms: Sequence[Form], best: Trial, largest_nt: float) -> Fit:
    """Everything jointly, with columns made of vectors that the fit has calibrated."""
    beside = replace(search, problem=before.problem, effects=(*search.effects, _effect(forms, largest_nt)), close=set())
    rows = before.problem.rows(best.hypothesis.columns(np.zeros(0)), before.unit)
    assert rows is not None
    space = beside.workspace(before)
    amplitudes = space.gain(beside.white(rows), max(before.white_rms_nt, 1e-3)).amplitudes
    terms = (*before.terms, Term(best.hypothesis, np.zeros(0), amplitudes))
    return beside.refreshed(solve(before.problem, before.x, terms))


def _effect(forms: Sequence[Form], largest_nt: float) -> Effect:
    """The curves as the search takes them."""
    return Effect(
        name=NAME,
        acts_on=ActsOn.FIELD,
        title="a curve without a name",
        equation="m = f(x), d_i = f_i(x) or d_i = -f_i(x) B_i, f piecewise linear",
        units={"values": "nT"},
        prior=(0.0, largest_nt),
        valid="inside the driver's recorded range",
        confused_with=(),
        separated_by="",
        source="",
        says=(),
        hypotheses=lambda scene: [form.hypothesis(scene, largest_nt) for form in forms],
    )


def _curves(fit: Fit, forms: Sequence[Form]) -> tuple[Empirical, ...]:
    by_label = {form.hypothesis(fit.problem.scene, 1.0).label: form for form in forms}
    found = []
    for index, term in enumerate(fit.terms):
        if term.hypothesis.effect == NAME:
            own = amplitude_columns(fit, index)
            found.append(by_label[term.hypothesis.label].curve(term.amplitudes, fit.covariance[own, own]))
    return tuple(found)
