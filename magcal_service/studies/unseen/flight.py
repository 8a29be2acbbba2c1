"""One flight: the truth, what is done to it, and everything the daemon's pipeline says of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import STATE_SIZE, Array, d_matrix, field_jacobian, measure
from magcal_service.studies.unseen.motion import SPIN_AXIS, SPIN_RPM, Motion, Track, field_eci_nt, track
from magcal_service.wire.messages import (
    CalibratedVector,
    Estimate,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    Verdict,
)

CRAFT: Final = "study"

SIGMA_BIAS_NT, SIGMA_D = 4000.0, 0.03
"""Spread of the true nine errors that are drawn [nT, -]."""


@dataclass(eq=False)
class Sent:
    """What is sent to the daemon, open to be spoiled; all of n seconds.

    Parameters
    ----------
    track: the craft's way.
    rng: for what a scenario draws.
    noise_nt: true white noise, 1 sigma per axis [nT].
    x: true nine errors (9,).
    field_nt: (n, 3) the field at the sensor, body [nT]: what a calibrated vector should be.
    disturbance_nt: (n, 3) what the craft adds, in the body [nT].
    gain: (n, 3) by how much each axis reads more than its calibration says.
    noise: (n, 3) [nT].
    reference_nt: (n, 3) reference as sent, ECI [nT].
    reference_sent: (n,) whether one is sent.
    sample_sent: (n,) whether a sample is sent.
    sample_ns: (n,) what its time is off by [ns].
    config: the craft's configuration.
    step_nt: of the readings' rounding, a part of the noise; 0 where they are not rounded [nT].
    post: what the sensor makes of its readings (n, 3), after noise.
    places_ecef_km: (n, 3) positions that are sent in place of the reference, of which the daemon makes it; None: none.
    """

    track: Track
    rng: np.random.Generator
    noise_nt: float
    x: Array
    field_nt: Array
    disturbance_nt: Array
    gain: Array
    noise: Array
    reference_nt: Array
    reference_sent: NDArray[np.bool_]
    sample_sent: NDArray[np.bool_]
    sample_ns: NDArray[np.int64]
    config: CraftConfig
    step_nt: float = 0.0
    post: list[Callable[[Array], Array]] = field(default_factory=list)
    places_ecef_km: Array | None = None

    @property
    def time_s(self) -> Array:
        """(n,) [s]."""
        return self.track.time_s

    def late(self, share: float) -> Array:
        """(n,) 1 from a share of the flight on, else 0."""
        return np.asarray(self.time_s >= share * self.time_s[-1], dtype=np.float64)

    def readings(self, noise: Array) -> Array:
        """(n, 3) what the sensor reads with this noise (n, 3), before ``post`` [nT]."""
        inside = self.field_nt + self.disturbance_nt + noise
        return np.asarray(measure(self.x, inside * (1.0 + self.gain)))


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What the daemon said of each vector that it answered (m, ...).

    Parameters
    ----------
    time_s: of the sample.
    error_nt: length of the vector's error, but for the sample's own noise [nT].
    sigma_nt: 1 sigma of that by the estimate's covariance, along the error [nT].
    protection_nt: as published; NaN where none was.
    trusted: whether the verdict was that.
    bias_sigma_nt: largest 1 sigma of the bias [nT].
    doubt_s: (k,) times at which a vector or an estimate was doubtful: a sensor that is stuck has no vectors.
    reasons: distinct reasons that were given while doubtful, by how many estimates.
    """

    time_s: Array
    error_nt: Array
    sigma_nt: Array
    protection_nt: Array
    trusted: NDArray[np.bool_]
    bias_sigma_nt: Array
    doubt_s: Array
    reasons: dict[str, int]


def begin(motion: Motion, noise_nt: float, duration_s: int, seed: np.random.SeedSequence) -> Sent:
    """A clean flight, and the configuration that fits it."""
    way, errors, noise, own = (np.random.default_rng(child) for child in seed.spawn(4))
    of = track(motion, duration_s, way)
    reference = field_eci_nt(of.position_eci_km)
    x = np.concatenate([errors.normal(0.0, SIGMA_BIAS_NT, 3), errors.normal(0.0, SIGMA_D, 6)])
    count = len(of.time_s)
    spin = SpinConfig(axis=SPIN_AXIS, rate_rpm=SPIN_RPM) if motion is Motion.SPIN else None
    return Sent(
        track=of,
        rng=own,
        noise_nt=noise_nt,
        x=x,
        field_nt=np.einsum("nij,nj->ni", of.body_from_eci, reference),
        disturbance_nt=np.zeros((count, 3)),
        gain=np.zeros((count, 3)),
        noise=noise.normal(0.0, noise_nt, (count, 3)),
        reference_nt=reference.copy(),
        reference_sent=np.ones(count, dtype=bool),
        sample_sent=np.ones(count, dtype=bool),
        sample_ns=np.zeros(count, dtype=np.int64),
        config=CraftConfig(CRAFT, sensor=SensorConfig(noise_nt=noise_nt), spin=spin),
    )


def hear(sent: Sent, ends: Callable[[float, Pipeline], bool] | None = None) -> Heard:
    """Send it all through the daemon's pipeline: each second the reference, then the sample.

    Parameters
    ----------
    sent: what is sent.
    ends: asked after each sample, with its time [s] and the pipeline as it stands, whether the flight ends here.
    """
    measured = sent.readings(sent.noise)
    noisefree = sent.readings(np.zeros_like(sent.noise))
    for change in sent.post:
        measured, noisefree = change(measured), change(noisefree)
    if sent.step_nt:
        measured = np.round(measured / sent.step_nt) * sent.step_nt
    pipeline = Pipeline(sent.config)
    rows = _Rows(sent, measured - noisefree, noisefree)
    doubts: list[float] = []
    reasons: dict[str, int] = {}
    latest: Estimate | None = None
    for index, time_ns in enumerate(sent.track.time_ns.tolist()):
        if sent.reference_sent[index]:
            pipeline.handle(_told(sent, index, time_ns))
        if not sent.sample_sent[index]:
            continue
        sample = _sample(index, time_ns + int(sent.sample_ns[index]), measured[index])
        for message in pipeline.handle(sample):
            if isinstance(message, CalibratedVector | Estimate) and message.verdict is Verdict.DOUBTFUL:
                doubts.append(float(sent.time_s[index]))
            if isinstance(message, CalibratedVector):
                rows.add(index, message, latest)
            elif isinstance(message, Estimate):
                latest = message
                if message.verdict is Verdict.DOUBTFUL:
                    for reason in message.reasons:
                        reasons[reason] = reasons.get(reason, 0) + 1
        if ends is not None and ends(float(sent.time_s[index]), pipeline):
            break
    return _heard(rows.table(), doubts, reasons)


@dataclass(slots=True)
class _Rows:
    """Vectors as they are answered, each with the estimate it was made by; errors and sigmas are worked out in blocks.

    Parameters
    ----------
    sent: what was sent.
    noise, noisefree: (n, 3) what noise adds to the readings, and the readings without it [nT].
    """

    sent: Sent
    noise: Array
    noisefree: Array
    _open: list[tuple[int, CalibratedVector, Estimate | None]] = field(default_factory=list)
    _closed: list[Array] = field(default_factory=list)

    def add(self, index: int, vector: CalibratedVector, estimate: Estimate | None) -> None:
        """The answer to sample ``index``."""
        self._open.append((index, vector, estimate))
        if len(self._open) >= _BLOCK:
            self._close()

    def table(self) -> Array:
        """(m, 6) the columns of ``Heard`` of the answers so far."""
        self._close()
        return np.concatenate([np.zeros((0, 6)), *self._closed])

    def _close(self) -> None:
        if not self._open:
            return
        index, vectors, estimates = zip(*self._open, strict=True)
        table = np.full((len(index), 6), np.nan)
        table[:, 0] = self.sent.time_s[list(index)]
        table[:, 4] = [vector.verdict is Verdict.TRUSTED for vector in vectors]
        known = [row for row, estimate in enumerate(estimates) if estimate is not None]
        if known:
            table[known, 3] = [np.nan if (level := vectors[row].protection_nt) is None else level for row in known]
            found = self._errors([index[row] for row in known], [vectors[row] for row in known], estimates)
            table[np.ix_(known, [1, 2, 5])] = found
        self._closed.append(table)
        self._open.clear()

    def _errors(
        self, index: list[int], vectors: list[CalibratedVector], estimates: tuple[Estimate | None, ...]
    ) -> Array:
        """(k, 3) error without the sample's noise, its sigma, and the bias's largest sigma [nT]."""
        by = [estimate for estimate in estimates if estimate is not None]
        d = d_matrix(np.array([(0.0, 0.0, 0.0, *estimate.D) for estimate in by]))
        noise = self.noise[index] + np.einsum("nij,nj->ni", d, self.noise[index])
        error = np.array([vector.field_body_nt for vector in vectors]) - noise - self.sent.field_nt[index]
        size = np.linalg.norm(error, axis=1)
        covariance = np.zeros((len(by), STATE_SIZE, STATE_SIZE))
        covariance[:, _UPPER[0], _UPPER[1]] = [estimate.covariance for estimate in by]
        covariance += np.triu(covariance, 1).swapaxes(1, 2)
        towards = error / np.maximum(size, 1e-9)[:, None]
        along = np.einsum("nij,ni->nj", field_jacobian(self.noisefree[index]), towards)
        sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", along, covariance, along), 0.0))
        bias = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :3].max(axis=1))
        return np.stack([size, sigma, bias], axis=1)


_BLOCK: Final = 1024
"""Answers that are worked out at once: 2 MB, and numpy's calls cost nothing beside them."""

_UPPER: Final = np.triu_indices(STATE_SIZE)


def _heard(table: Array, doubts: list[float], reasons: dict[str, int]) -> Heard:
    time_s, error, sigma, protection, trusted, bias = table.T
    return Heard(time_s, error, sigma, protection, trusted > 0.5, bias, np.array(doubts), reasons)


def _reference(index: int, time_ns: int, field_nt: Array) -> ReferenceSample:
    x, y, z = field_nt.tolist()
    return ReferenceSample(
        craft=CRAFT, source="model", sequence=index, time_ns=time_ns, field_nt=(x, y, z), frame=Frame.ECI
    )


def _told(sent: Sent, index: int, time_ns: int) -> ReferenceSample | PositionSample:
    """The reference, or the position that is sent in its place."""
    if sent.places_ecef_km is None:
        return _reference(index, time_ns, sent.reference_nt[index])
    x, y, z = sent.places_ecef_km[index].tolist()
    return PositionSample(
        craft=CRAFT, source="gps", sequence=index, time_ns=time_ns, position_km=(x, y, z), frame=Frame.ECEF
    )


def _sample(index: int, time_ns: int, field_nt: Array) -> MagnetometerSample:
    x, y, z = field_nt.tolist()
    return MagnetometerSample(craft=CRAFT, source="mag", sequence=index, time_ns=time_ns, field_body_nt=(x, y, z))


def reconfigured(config: CraftConfig, **changes: Any) -> CraftConfig:
    """A configuration whose spin or sensor says something else; ``spin`` and ``sensor`` as dictionaries of changes."""
    parts: dict[str, Any] = {}
    if "spin" in changes and config.spin is not None:
        parts["spin"] = replace(config.spin, **changes["spin"])
    if "sensor" in changes:
        parts["sensor"] = replace(config.sensor, **changes["sensor"])
    return replace(config, **parts)
