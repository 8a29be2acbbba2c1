"""Days of one craft by the simulator of ``tests.regimes``: nine errors of each, fields that follow its telemetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_service.earth import geomagnetic
from magcal_service.recordings.recording import Recording
from tests.regimes.attitude import spinning
from tests.regimes.orbit import Floats, Orbit

FIRST_DAY = np.datetime64("2025-03-20T12:00:00", "ns")
NOISE_NT = 50.0
PERIOD_S, COUNT = 5.0, 1000
TIME_S = PERIOD_S * np.arange(COUNT)


@dataclass(frozen=True)
class Day:
    """One day's recording, with what is true of it: nine errors, and fields [nT/K], [nT/A]."""

    recording: Recording
    bias_nt: Floats
    D: Floats


def day(
    number: int,
    per_k: Floats,
    per_a: Floats,
    added_nt: Floats | None = None,
    noise_nt: float = NOISE_NT,
    stated_nt: float | None = NOISE_NT,
    seed: int = 700,
    current: Floats | None = None,
) -> Day:
    """Day ``number`` with a field (3,) per kelvin of its temperature and one (3,) per ampere of its current.

    Parameters
    ----------
    added_nt: a body field (COUNT, 3) besides.
    noise_nt, stated_nt: the noise, and what the recording says of it.
    seed: of all that is random.
    current: (COUNT,) in place of the usual one [A].
    """
    rng = np.random.default_rng(seed + number)
    t = TIME_S
    start = FIRST_DAY + np.timedelta64(number * 9, "D")
    time_ns = start.astype(np.int64) + np.rint(t * 1e9).astype(np.int64)
    orbit = Orbit(6900.0, 0.001, 0.9 + 0.1 * number, 1.3 * number, 0.4, 2.0 * number)
    place = orbit.position_km(t)
    field = geomagnetic.igrf_eci_nt(time_ns, place)
    motion = spinning(rng, 0.7 + 0.3 * number, np.array([0.36, 0.48, 0.8]))
    body = np.einsum("nij,nj->ni", motion(t), field)
    temperature = 12.0 + 8.0 * np.sin(t / 900.0 + number) + 2.0 * np.sin(t / 400.0)
    usual = 0.8 + 0.6 * np.sign(np.sin(t / 170.0 + 2.0 * number)) * np.sin(t / 1300.0 + number)
    current = usual if current is None else current
    spoiled = body + np.outer(temperature - 12.0, per_k) + np.outer(current, per_a)
    if added_nt is not None:
        spoiled = spoiled + added_nt
    bias = rng.normal(0.0, 3000.0, 3)
    scale = rng.normal(0.0, 0.02, (3, 3))
    D = scale + scale.T
    noisy = spoiled + bias + rng.normal(0.0, noise_nt, (COUNT, 3))
    recording = Recording.from_arrays(
        time_ns.astype("datetime64[ns]"),
        np.linalg.solve(np.eye(3) + D, noisy.T).T,
        field,
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, place),
        noise_nt=stated_nt,
        channels={"board": (temperature, "degC"), "bus": (current, "A")},
    )
    return Day(recording, bias, D)
