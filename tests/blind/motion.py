"""Causes in how the craft turns, and in a sensor that is late while it does."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.blind.attitude import RPM, RateProfile
from tests.blind.cause import Cause, Measure, plain
from tests.blind.sensor import Sampling, Spoiling
from tests.blind.vectors import Floats, OverTime, log_uniform
from tests.blind.world import World

NODES = 12


def nutation(world: World, _recorded: bool) -> Cause:
    """The craft cones about its momentum without torque; ``scale`` is the cone's half angle [deg]."""
    rng = world.streams.rng("nutation")
    ratio = float(rng.uniform(0.3, 0.9) if rng.random() < 0.5 else rng.uniform(1.1, 1.8))
    coning = replace(world.motion, inertia_ratio=ratio)
    spin_hz = world.motion.rate.start_rad_s / math.tau

    def parameters(scale: float) -> dict[str, object]:
        precession = ratio * spin_hz / math.cos(math.radians(scale))
        return {"angle_deg": scale, "inertia_ratio": ratio, "precession_hz": precession}

    return Cause(
        name="nutation",
        world=world,
        spoil=lambda scale: Spoiling(motion=replace(coning, cone_rad=math.radians(scale))),
        parameters=parameters,
        scale=log_uniform(rng, 0.3, 12.0),
        fixed=True,
        measure=Measure.TURNED,
        needs_spin=True,
    )


def spin_rate(world: World, _recorded: bool) -> Cause:
    """The rate is not the one that is stated, or it changes: a constant torque, or an eddy current's."""
    rng = world.streams.rng("spin_rate")
    stated = world.motion.rate.start_rad_s
    sign = -1.0 if abs(stated) > 0.6 * math.pi / world.period_s else float(rng.choice([-1.0, 1.0]))
    choice = rng.random()
    wrong = sign * log_uniform(rng, 1e-3, 0.05) if choice < 0.6 else 0.0
    change = sign * log_uniform(rng, 2e-3, 0.15) if choice > 0.3 else 0.0
    eddy = change < 0.0 and rng.random() < 0.4

    def profile(scale: float) -> RateProfile:
        start = stated * (1.0 + scale * wrong)
        if eddy and scale:
            return RateProfile(start, 0.0, tau_s=-world.duration_s / math.log1p(scale * change))
        return RateProfile(start, start, slope_rad_s2=stated * scale * change / world.duration_s)

    def parameters(scale: float) -> dict[str, object]:
        first, last = profile(scale).rate(np.array([0.0, world.duration_s])) / RPM
        says: dict[str, object] = {"rate_rpm": float(first), "rate_rpm_at_end": float(last)}
        return says if eddy else says | {"rate_rpm_per_s": float(last - first) / world.duration_s}

    return Cause(
        name="spin_rate",
        world=world,
        spoil=lambda scale: Spoiling(motion=replace(world.motion, rate=profile(scale))),
        parameters=parameters,
        fixed=True,
        measure=Measure.TURNED,
        needs_spin=True,
    )


def despun(world: World, rng: np.random.Generator) -> World:
    """The world with a spin that falls to a tenth up to a half of its rate within the recording."""
    fastest = min(30.0, 0.45 * 60.0 / world.period_s) * RPM
    start = math.copysign(rng.uniform(0.3, 1.0) * fastest, world.motion.rate.start_rad_s)
    share = rng.uniform(0.1, 0.5)
    if rng.random() < 0.5:
        slope = -(1.0 - share) * start / world.duration_s
        return world.with_rate(RateProfile(start, start, slope_rad_s2=slope))
    return world.with_rate(RateProfile(start, 0.0, tau_s=-world.duration_s / math.log(share)))


def _late(name: str, world: World, sampling: Callable[[float], Sampling], says: Callable[[float], object]) -> Cause:
    """A cause in when the sensor takes its values, in a craft that slows down; its scale is a time [s]."""
    key = {"response_lag": "tau_s", "axis_skew": "delay_s"}[name]
    return Cause(
        name=name,
        world=world,
        spoil=lambda scale: Spoiling(sampling=sampling(scale)),
        parameters=lambda scale: {key: says(scale)},
        scale=0.02,
        largest_scale=0.7 / abs(world.motion.rate.start_rad_s),
        measure=Measure.SCALAR,
        also=("spin_rate",),
    )


def _steady(cause: Cause, rng: np.random.Generator) -> Cause:
    """The same at a constant rate, where the nine errors absorb it: another calibration, the same residual."""
    scale = log_uniform(rng, 1e-3, min(0.5, 0.4 * cause.largest_scale))
    return replace(cause, scale=scale, fixed=True, absorbed=True, also=(cause.name,))


def _lag(world: World) -> Cause:
    nodes, weights = np.polynomial.laguerre.laggauss(NODES)

    def sampling(tau: float) -> Sampling:
        def late(field: OverTime, instants: Floats) -> Floats:
            parts = [weight * field(instants - tau * node) for node, weight in zip(nodes, weights, strict=True)]
            return np.asarray(np.sum(parts, axis=0), dtype=np.float64)

        return late

    return _late("response_lag", world, sampling, float)


def _skew(world: World, rng: np.random.Generator) -> Cause:
    order = rng.permutation(3).astype(np.float64)
    whole = np.eye(3) + world.scale
    inverse = np.linalg.inv(whole)

    def sampling(delay: float) -> Sampling:
        def one_by_one(field: OverTime, instants: Floats) -> Floats:
            taken = [
                (field(instants + delay * place) + world.bias_nt) @ row
                for place, row in zip(order, inverse, strict=True)
            ]
            return np.asarray(np.stack(taken, axis=-1) @ whole - world.bias_nt, dtype=np.float64)

        return one_by_one

    return _late("axis_skew", world, sampling, lambda delay: plain(delay * order))


def response_lag(world: World, _recorded: bool) -> Cause:
    """A first-order low-pass in front of the converter, tau dy/dt = x - y, in a craft whose spin slows down.

    y(t) is the integral of x(t - tau s) exp(-s) over s > 0, taken by Gauss-Laguerre quadrature: exact to 1e-6 of the
    turning part while the craft turns by less than 0.7 rad in tau.
    """
    return _lag(despun(world, world.streams.rng("response_lag")))


def moving_average(world: World, _recorded: bool) -> Cause:
    """A driver that keeps y_k = a x_k + (1 - a) y_(k-1) of what it reads, noise and all, in a craft that slows down.

    ``scale`` is (1 - a) / a, the mean age of what it tells in samples.
    """
    world = despun(world, world.streams.rng("moving_average"))

    def averaged(scale: float, read: Floats) -> Floats:
        share, kept, told = 1.0 / (1.0 + scale), read[0], []
        for sample in read:
            kept = share * sample + (1.0 - share) * kept
            told.append(kept)
        return np.array(told)

    return Cause(
        name="response_lag",
        world=world,
        spoil=lambda scale: Spoiling(output=lambda _tags, read: averaged(scale, read)),
        parameters=lambda scale: {"new_share": 1.0 / (1.0 + scale)},
        scale=0.2,
        largest_scale=min(3.0, 0.7 / abs(world.motion.rate.start_rad_s) / world.period_s),
        measure=Measure.SCALAR,
        also=("spin_rate", "coloured_noise"),
    )


def axis_skew(world: World, _recorded: bool) -> Cause:
    """The axes are digitised one after another, in some order, in a craft whose spin slows down."""
    rng = world.streams.rng("axis_skew")
    return _skew(despun(world, rng), rng)


def steady_lag(world: World, _recorded: bool) -> Cause:
    """The low-pass of ``response_lag`` at a constant rate: nothing of it shows."""
    return _steady(_lag(world), world.streams.rng("steady_lag"))


def steady_skew(world: World, _recorded: bool) -> Cause:
    """The delays of ``axis_skew`` at a constant rate: nothing of them shows."""
    rng = world.streams.rng("steady_skew")
    return _steady(_skew(world, rng), rng)
