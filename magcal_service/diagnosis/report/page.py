"""A diagnosis as one page: everything the template shows, in words and rounded numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.empirical.modelled import Modelled
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.errors_spread import errors_sigma
from magcal_service.diagnosis.report.figures import curve_picture, pictures, track
from magcal_service.diagnosis.report.frame import Origin, check_packages, rendered
from magcal_service.diagnosis.result import held_out_rms
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.words import (
    belief,
    chance,
    compared_with,
    driver_in_words,
    expected,
    members,
    modelled_sentence,
    noise_of,
    not_borne_out,
    not_told_from,
    odds,
    percent,
    remaining,
    strength,
    titles,
    verdict_sentence,
)
from magcal_service.model import BIAS, STATE_NAMES
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.apply.advice import advice, in_order
from magcal_service.physics.held import held_in_words
from magcal_service.physics.interface import UNLISTED, Value
from magcal_service.physics.saying import AXES, labels_of, measured

_MOST_PLACES: Final = 8
"""Rows of the table of places; choice: the rest is in ``diagnosis.json``."""

_BEYOND: Final = 700.0  # nats, which underflow as a probability
_TEMPLATE: Final = Path(__file__).with_name("page.html")


def report(diagnosis: Diagnosis, found: Sequence[Entry], content: str, origin: Origin) -> str:
    """The page as HTML; ``content`` is the ``diagnosis.json`` beside it.

    Raises ``ExtraMissingError`` without jinja2 or matplotlib.
    """
    check_packages()
    numbers = json.loads(content)
    return rendered(
        _TEMPLATE,
        origin,
        (percent, chance, odds, strength, belief, expected),
        diagnosis=diagnosis,
        numbers=numbers,
        sentence=verdict_sentence(diagnosis, found, held_out_rms(diagnosis)),
        advice=in_order(advice(diagnosis.reasons, diagnosis.concerned)),
        levels=_levels(diagnosis),
        pictures=pictures(diagnosis),
        track=track(diagnosis),
        places=_places(numbers["located"]),
        effects=[_effect(diagnosis, entry) for entry in found if entry.effect != UNLISTED],
        unknown=next((_unknown(entry) for entry in found if entry.effect == UNLISTED), None),
        remaining=remaining(diagnosis),
        modelled=None if diagnosis.modelled is None else _modelled(diagnosis.modelled),
        errors=_errors(diagnosis),
        held_at=held_in_words(diagnosis.held_at),
        misled=diagnosis.misled if diagnosis.fit.terms else None,
        noise=noise_of(diagnosis),
        unseen=_unseen(diagnosis, found),
        rows=_rows(diagnosis),
        facts=_facts(diagnosis),
    )


def _levels(diagnosis: Diagnosis) -> dict[str, Any]:
    """The three held-out numbers as bars, and the sensor noise as a mark on the same scale."""
    rms, floor = held_out_rms(diagnosis), diagnosis.noise_nt
    words = {
        "simulation": compared_with(has_simulation=diagnosis.has_simulation),
        "recalibrated": "nine errors fitted anew",
        "with_effects": "with what was left out" if diagnosis.fit.terms else "with effects (none)",
    }
    top = 1.05 * max(*rms.values(), floor)
    bars = [
        {"key": key, "name": name, "nt": rms[key], "width": round(100.0 * rms[key] / top, 2)}
        for key, name in words.items()
    ]
    return {"bars": bars, "floor": floor, "mark": round(100.0 * floor / top, 2)}


def _places(located: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Places of the mismatch, one row for those that say the same."""
    rows: list[dict[str, Any]] = []
    for place in located:
        says = str(place["says"])
        if place["kind"] != "channel":
            says = says.rpartition(" (")[0] or says
        else:
            says = says.replace(" (channel ", " (").removesuffix(")") + ")"
        if all(row["says"] != says for row in rows):
            part, nats = float(place["share"]), float(place["significance_nats"])
            rows.append({"says": says, "kind": place["kind"], "share": part, "nats": nats})
    return rows[:_MOST_PLACES]


def _effect(diagnosis: Diagnosis, entry: Entry) -> dict[str, Any]:
    effect = next(effect for effect in diagnosis.effects if effect.name == entry.effect)
    known = titles(diagnosis.effects)
    return {
        "entry": entry,
        "title": effect.title,
        "equation": effect.equation,
        "valid": effect.valid,
        "source": effect.source,
        "absorbed": effect.absorbed,
        "driver": driver_in_words(entry.driver),
        "share": entry.extent,
        "in_samples": effect.acts_on is ActsOn.SAMPLES,
        "members": members(entry),
        "not_told_from": not_told_from(entry),
        "rivals": [
            {
                "name": name,
                "title": (entry.unlisted if name == UNLISTED else "") or known.get(name, ""),
                "probability": p,
                "here": _here(entry, name, p),
            }
            for name, p in entry.rivals
        ],
        "parameters": [
            row
            for name, value in entry.parameters.items()
            if not name.startswith(("column", "face"))
            for row in _parameter_rows(name, value)
        ],
        "time": entry.where["time_s"],
        "frequency": ", ".join(f"{f:.4g} Hz" for f in entry.where["frequency_hz"]),
    }


def _here(entry: Entry, rival: str, probability: float) -> str:
    """How a rival stands against the name."""
    if rival in entry.as_well:
        return "leaves exactly the same"
    own = entry.probability
    nats = abs(math.log(own) - math.log(probability)) if min(own, probability) > 0.0 else _BEYOND
    than = f"{'likelier' if probability > own else 'less likely'}, {odds(nats)}"
    return f"not told apart: {than}" if rival in entry.members else than


def _parameter_rows(name: str, value: Value) -> list[dict[str, Any]]:
    """Rows of the table of numbers: three axes in one row, a matrix of them row by row, else one number a row."""
    labels, unit, bounds = labels_of(value.value.shape, value.labels), value.unit, _range(value)
    row = {"name": name, "of": "", "unit": unit, "range": bounds}
    if value.value.ndim == 0:
        return [row | {"cells": [measured(float(value.value), float(value.sigma))]}]
    if labels[-1] != AXES:
        pairs = zip(np.ndindex(value.value.shape), value.value.ravel(), value.sigma.ravel(), strict=True)
        names = [", ".join(labels[dim][i] for dim, i in enumerate(at)) for at in np.ndindex(value.value.shape)]
        return [row | {"of": names[i], "cells": [measured(float(v), float(s))]} for i, (_, v, s) in enumerate(pairs)]
    lines = zip(
        labels[0] if value.value.ndim == 2 else ("",),
        np.atleast_2d(value.value),
        np.atleast_2d(value.sigma),
        strict=True,
    )
    return [
        row | {"of": of, "cells": [measured(float(v), float(s)) for v, s in zip(values, sigmas, strict=True)]}
        for of, values, sigmas in lines
    ]


def _range(value: Value) -> str:
    """What a number lies between by its physics or its search; empty without a limit."""
    if value.bounds is None:
        return ""
    low, high = value.bounds
    return f"± {high:.4g}" if low == -high else f"{low:.4g} to {high:.4g}"


def _unknown(entry: Entry) -> dict[str, Any]:
    where = entry.where
    return {
        "entry": entry,
        "shape": where["fitted_shape"],
        "places": _places(where["correlates_with"]),
        "nearest": where["nearest"],
        "time": where["time_s"],
        "frequency": ", ".join(f"{f:.4g} Hz" for f in where["frequency_hz"]),
    }


def _modelled(modelled: Modelled) -> dict[str, Any]:
    return {
        "says": modelled_sentence(modelled),
        "forward_nt": modelled.forward_nt,
        "usable": modelled.is_usable,
        "alike": [driver_in_words(driver) or driver.partition(":")[2] for driver in modelled.alike],
        "pictures": [curve_picture(curve) for curve in modelled.curves],
    }


def _errors(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """The nine errors before and after, with 1 sigma."""
    before, after = diagnosis.prepared.baseline, diagnosis.fit
    sigma = errors_sigma(after)
    rows = []
    for i, name in enumerate(STATE_NAMES):
        places, unit = (1, "nT") if i < BIAS.stop else (5, "")
        numbers = {"before": before.x[i], "after": after.x[i], "moved": after.x[i] - before.x[i], "sigma": sigma[i]}
        rows.append({"name": name, "unit": unit} | {key: f"{float(v):.{places}f}" for key, v in numbers.items()})
    return rows


def _unseen(diagnosis: Diagnosis, found: Sequence[Entry]) -> list[dict[str, str]]:
    """What such a recording cannot show, because the nine errors take it up."""
    named = {entry.effect for entry in found}
    return [
        {"name": effect.name, "title": effect.title, "says": effect.absorbed}
        for effect in diagnosis.effects
        if effect.absorbed and effect.name not in named
    ]


def _rows(diagnosis: Diagnosis) -> list[str]:
    """The account of the rows, by kind."""
    defects = [f"{one.code}: {one.rows}" for one in diagnosis.inspection.findings if one.certain]
    account = account_of(diagnosis.inspection, diagnosis.prepared)
    return [*diagnosis.prepared.recording.report.lines(), *defects, str(account), *diagnosis.made_where]


def _facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What the recording is."""
    scene, recording = diagnosis.prepared.problem.scene, diagnosis.prepared.recording
    facts = [("recording", recording.name)]
    if scene.utc:
        begin, end = (np.datetime64(int(ns), "ns").astype("datetime64[s]") for ns in recording.time_ns[[0, -1]])
        facts.append(("from, to (UTC)", f"{begin} to {end}"))
    facts.append(("samples used", f"{len(scene)}, one every {scene.period_s:.3g} s"))
    facts.append(("noise, 1 sigma per axis", noise_of(diagnosis)))
    if diagnosis.refused:
        facts.append(("compared by", not_borne_out(diagnosis)))
    if diagnosis.spin is not None:
        axis = ", ".join(f"{v:.3f}" for v in diagnosis.spin.axis_body.tolist())
        facts.append(("spin", f"{diagnosis.spin.rate_rpm:.4g} rpm about ({axis}) in the body"))
    if diagnosis.prepared.sun is not None:
        facts.append(("Sun", str(diagnosis.prepared.sun)))
    if scene.channels:
        facts.append(("telemetry", ", ".join(f"{c.name} ({c.quantity})" for c in scene.channels.values())))
    return facts
