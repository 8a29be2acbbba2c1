"""A scene that has every driver of the catalogue, from a simulated flight of 100 minutes, and cuts of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from magcal_service.earth import geomagnetic
from magcal_service.model import Array, measure
from magcal_service.physics.scene.scene import Scene, Telemetry
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

X = np.array([5000.0, -3000.0, 4000.0, 0.05, 0.1, -0.05, 0.02, 0.03, -0.01])
ROWS = 3000


@cache
def flight() -> Scene:
    """3000 samples, one every 2 s, with temperature, currents, torquers, Sun sensors, gyro, position and attitude."""
    scenario = load_scenario("hot-electronics")
    scenario = replace(scenario, duration_s=2.0 * ROWS, sensor=replace(scenario.sensor, rate_hz=0.5))
    simulation = Simulation(scenario)
    run = simulation.arrays()
    time_s = (run.times_ns - run.times_ns[0]) * 1e-9
    position = simulation.truth.orbit.position_eci_km(run.times_ns)
    sun = simulation.environment.sun_body(time_s) * simulation.environment.lit(time_s)[:, None]
    commands = np.sign(np.sin(time_s / 150.0))[:, None] * (np.mod(time_s, 300.0) < 140.0)[:, None] * [0.1, 0.0, -0.2]
    channels = (
        Telemetry("temperature", "temperature", simulation.environment.temperature_degc(time_s)[:, None]),
        Telemetry("boards", "temperature", np.stack([20.0 + time_s / 600.0, 5.0 + np.sin(time_s / 900.0)], axis=1)),
        Telemetry("bus", "current", np.stack([np.maximum(sun[:, 0], 0.0), 0.0 * time_s, 1.0 + sun[:, 1]], axis=1)),
        Telemetry("torquer", "magnetic moment", commands),
        Telemetry("sun", "dimensionless", sun),
        Telemetry("photodiodes", "counts", 800.0 * sun),
        Telemetry("gyro", "angular rate", simulation.truth.spin.rate_body_rad_s(time_s)),
    )
    return Scene(
        time_s=time_s,
        origin_ns=int(run.times_ns[0]),
        utc=True,
        field_nt=measure(X, run.ambient_body_nt),
        calibrated_nt=run.ambient_body_nt,
        clean_field_nt=measure(X, run.ambient_body_nt),
        magnitude_nt=np.linalg.norm(run.true_eci_nt, axis=1),
        reference_eci_nt=run.true_eci_nt,
        position_ecef_km=geomagnetic.ecef_from_eci(run.times_ns, position),
        channels={channel.name: channel for channel in channels},
        body_from_eci=run.body_from_eci,
    )


def cut(scene: Scene, first: int, end: int) -> Scene:
    """Rows of a scene as a recording of its own: its time counts from its own first sample."""

    def part(values: Array | None) -> Array | None:
        return None if values is None else values[first:end]

    rows = slice(first, end)
    return replace(
        scene,
        time_s=scene.time_s[rows] - scene.time_s[first],
        origin_ns=scene.origin_ns + round(float(scene.time_s[first]) * 1e9),
        field_nt=scene.field_nt[rows],
        calibrated_nt=scene.calibrated_nt[rows],
        clean_field_nt=scene.clean_field_nt[rows],
        magnitude_nt=scene.magnitude_nt[rows],
        reference_eci_nt=part(scene.reference_eci_nt),
        position_ecef_km=part(scene.position_ecef_km),
        channels={n: Telemetry(c.name, c.quantity, c.values[rows]) for n, c in scene.channels.items()},
        body_from_eci=part(scene.body_from_eci),
    )
