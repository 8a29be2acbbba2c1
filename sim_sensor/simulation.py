"""A scenario and a seed become samples: vectorised blocks, the truth behind them, and the messages they are sent as.

Nothing here reads a clock or a link.  The same scenario and seed give the same numbers on every run, and every random
stream has its own child seed, so switching one effect on leaves every other number as it was.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_service.physics.apply.model_file import PhysicsModel
from magcal_service.wire.messages import (
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from sim_sensor import faults, physics, sensor, streams
from sim_sensor.beside import OWN_SOURCE, Beside
from sim_sensor.environment import Environment, rotate
from sim_sensor.faults import Emission
from sim_sensor.physics import AddedPhysics
from sim_sensor.scenario import UNITS, Channel, ReferenceForm, Scenario, resolve
from sim_sensor.sensor import Effects
from sim_sensor.streams import Stream

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

_SUN_SENSOR_LIT = 0.5  # lit fraction from which the Sun sensor has a direction
_BLOCK = 8192  # magnetometer samples computed at once: 0.1 s of work, 20 MB


@dataclass(frozen=True)
class Block:
    """Consecutive magnetometer samples with the truth behind them; n samples.

    Parameters
    ----------
    times_ns: source times (n,) UTC [ns].
    measured_nt: B (n, 3) [nT], body.
    ambient_body_nt: A H before the response lag (n, 3) [nT], body, without noise.
    true_eci_nt: field that acts (n, 3) [nT], ECI.
    body_from_eci: attitude A (n, 3, 3).
    bias_nt, D: true errors at each sample (n, 3) [nT], (n, 6) [-]; without what temperature adds.
    """

    times_ns: Times
    measured_nt: Floats
    ambient_body_nt: Floats
    true_eci_nt: Floats
    body_from_eci: Floats
    bias_nt: Floats
    D: Floats

    def first(self, count: int) -> Block:
        """The first ``count`` samples."""
        return Block(*(getattr(self, name)[:count] for name in Block.__annotations__))


class Simulation:
    """One run of a scenario.

    Parameters
    ----------
    scenario: what to simulate; its random parts are drawn here (see ``truth``).
    seed: the seed; the scenario's own where None.
    duration_s: length [s]; the scenario's own where None.
    model: a ``physics.toml`` whose nine errors take the place of the scenario's, and whose effects are added to it.

    Raises ConfigError where the scenario lacks what drives an effect of the model.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None = None,
        duration_s: float | None = None,
        model: PhysicsModel | None = None,
    ) -> None:
        self.seed = scenario.seed if seed is None else seed
        self.model = model
        drawn = resolve(scenario, self.seed)
        self.truth = drawn if model is None else physics.with_errors(drawn, model)
        """The scenario with nothing left to chance: the nine errors, the spin, the orbit.  Never sent."""
        self.duration_s = scenario.duration_s if duration_s is None else duration_s
        self.environment = Environment(self.truth, self.duration_s)
        self._newest_field: tuple[Times, Floats] | None = None
        if model is not None:  # refused now rather than on the way
            self._added(
                AddedPhysics(model, self.truth.telemetry.channels), self.times_ns(self.truth.sensor.rate_hz)[:3]
            )

    def times_ns(self, rate_hz: float, offset_s: float = 0.0) -> Times:
        """Source times (n,) UTC [ns] of a sensor at ``rate_hz``, from the start to the end of the run."""
        count = max(0, math.ceil((self.duration_s - offset_s) * rate_hz - 1e-9))
        ticks = np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
        return np.asarray(self.truth.start_ns + round(offset_s * 1e9) + ticks, dtype=np.int64)

    def elapsed_s(self, times_ns: Times) -> Floats:
        """Seconds since the start (n,)."""
        return np.asarray((times_ns - self.truth.start_ns) * 1e-9, dtype=np.float64)

    def blocks(self) -> Iterator[Block]:
        """All magnetometer samples in order, in blocks of at most 8192."""
        scenario = self.truth
        rng = streams.generator(self.seed, Stream.MAGNETOMETER)
        times = self.times_ns(scenario.sensor.rate_hz)
        added = None if self.model is None else AddedPhysics(self.model, scenario.telemetry.channels)
        for first in range(0, len(times), _BLOCK):
            part = times[first : first + _BLOCK]
            noise = rng.standard_normal((len(part), 3)) * np.array(scenario.sensor.noise_nt)
            yield self._block(part, noise, added)

    def arrays(self) -> Block:
        """The whole run as one block."""
        parts = list(self.blocks())
        return Block(*(np.concatenate([getattr(part, name) for part in parts]) for name in Block.__annotations__))

    def _true_eci_nt(self, times_ns: Times) -> Floats:
        """The true field; that of the newest block is kept, since sensor and reference mostly ask for the same."""
        if self._newest_field is None or not np.array_equal(self._newest_field[0], times_ns):
            self._newest_field = times_ns, self.truth.field.true_eci_nt(self.truth.orbit, times_ns)
        return self._newest_field[1]

    def _reference_eci_nt(self, times_ns: Times) -> Floats:
        if not self.truth.field.differs:
            return self._true_eci_nt(times_ns)
        return self.truth.field.reference_eci_nt(self.truth.orbit, times_ns)

    def _added(self, added: AddedPhysics, times_ns: Times) -> tuple[Floats, Floats]:
        """Body field (n, 3) and growth of the magnitude (n,) [nT] of the model's effects."""
        times = added.overlapping(times_ns)
        elapsed_s = self.elapsed_s(times)
        scene = physics.scene_of(
            added.model,
            times,
            self._reference_eci_nt(times),
            self.truth.spin.body_from_eci(elapsed_s),
            self.truth.orbit.position_eci_km(times),
            {channel: self._values(channel, elapsed_s) for channel in self.truth.telemetry.channels},
        )
        return added.on(scene, len(times_ns))

    def _block(self, times_ns: Times, noise_nt: Floats, added: AddedPhysics | None) -> Block:
        scenario, elapsed_s = self.truth, self.elapsed_s(times_ns)
        true_eci = self._true_eci_nt(times_ns)
        attitude = scenario.spin.body_from_eci(elapsed_s)
        ambient = rotate(attitude, true_eci)
        response = self._response(times_ns, ambient, true_eci, scenario.sensor.lag_s)
        field_nt: Floats | float = 0.0
        if added is not None:
            field_nt, growth = self._added(added, times_ns)
            response = response * (1.0 + growth / np.linalg.norm(true_eci, axis=1))[:, None]
        measured = sensor.measured_nt(
            scenario.sensor, scenario.effects, self.environment, elapsed_s, response, noise_nt, field_nt
        )
        bias, D = sensor.errors_at(scenario.sensor, scenario.effects.steps, elapsed_s)
        return Block(times_ns, measured, ambient, true_eci, attitude, bias, D)

    def _response(self, times_ns: Times, ambient: Floats, true_eci: Floats, lag_s: float) -> Floats:
        """Body field (n, 3) [nT] after a sensor's lag."""
        if lag_s == 0.0:
            return ambient
        return sensor.lagged(self._delayed_field(times_ns, true_eci), self.elapsed_s(times_ns), lag_s)

    def beside(self, one: Beside) -> Iterator[tuple[Times, Floats]]:
        """Times (n,) [ns] and measured vectors (n, 3) [nT] of a further magnetometer, in blocks."""
        seed = streams.child(self.seed, Stream.BESIDE).spawn(len(self.truth.beside))[self.truth.beside.index(one)]
        rng = np.random.default_rng(seed)
        times = self.times_ns(one.sensor.rate_hz, one.offset_s)
        for first in range(0, len(times), _BLOCK):
            part = times[first : first + _BLOCK]
            noise = rng.standard_normal((len(part), 3)) * np.array(one.sensor.noise_nt)
            elapsed_s, true_eci = self.elapsed_s(part), self.truth.field.true_eci_nt(self.truth.orbit, part)
            ambient = rotate(self.truth.spin.body_from_eci(elapsed_s), true_eci)
            response = one.own_axes(self._response(part, ambient, true_eci, one.sensor.lag_s))
            magnets = one.magnets_nt(elapsed_s)
            yield part, sensor.measured_nt(one.sensor, Effects(), self.environment, elapsed_s, response, noise, magnets)

    def _delayed_field(self, times_ns: Times, true_eci: Floats) -> sensor.FieldAt:
        """The body field at times near those of a block: the attitude exactly, H along its tangent (0.1 nT in 10 s)."""
        scenario, elapsed_s = self.truth, self.elapsed_s(times_ns)
        second = 10**9
        slope = scenario.field.true_eci_nt(scenario.orbit, times_ns + second) - true_eci

        def field_body_nt(at_s: Floats) -> Floats:
            return rotate(scenario.spin.body_from_eci(at_s), true_eci + slope * (at_s - elapsed_s)[:, None])

        return field_body_nt

    # Messages

    def messages(self) -> Iterator[Message]:
        """Everything the node sends, in the order of sending, link faults included."""
        return (emission.message for emission in self.emissions())

    def emissions(self) -> Iterator[Emission]:
        """``messages`` with the simulated time at which each is sent."""
        return faults.apply(self.clean_emissions(), self.truth.faults, streams.child(self.seed, Stream.FAULTS))

    def clean_emissions(self) -> Iterator[Emission]:
        """The stream before link faults: in order of source time, references before the samples they belong to."""
        own = ((block.times_ns, block.measured_nt) for block in self.blocks())
        others = (self._magnetometer(one.source, self.beside(one)) for one in self.truth.beside)
        magnetometers = [self._magnetometer(OWN_SOURCE, own), *others]
        sources = [self._references(), self._positions(), *self._telemetry(), *magnetometers]
        return heapq.merge(*sources, key=lambda emission: emission.emit_s)

    def _magnetometer(self, source: str, blocks: Iterator[tuple[Times, Floats]]) -> Iterator[Emission]:
        craft, sequence = self.truth.craft, 0
        for times_ns, measured_nt in blocks:
            for time_ns, (x, y, z) in zip(times_ns.tolist(), measured_nt.tolist(), strict=True):
                sample = MagnetometerSample(
                    craft=craft, source=source, sequence=sequence, time_ns=time_ns, field_body_nt=(x, y, z)
                )
                yield Emission(self._emit_s(time_ns), sample)
                sequence += 1

    def _emit_s(self, time_ns: int) -> float:
        return (time_ns - self.truth.start_ns) * 1e-9

    def references(self) -> Iterator[tuple[Times, Floats]]:
        """Times (n,) [ns] and reference vectors (n, 3) [nT] ECI in blocks, with the reference's own noise."""
        plan = self.truth.reference
        rng = streams.generator(self.seed, Stream.REFERENCE)
        times = self.times_ns(plan.rate_hz, plan.offset_s)
        for first in range(0, len(times), _BLOCK):
            part = times[first : first + _BLOCK]
            noise = rng.standard_normal((len(part), 3)) * plan.noise_nt
            yield part, self._reference_eci_nt(part) + noise

    def _references(self) -> Iterator[Emission]:
        craft, form, sequence = self.truth.craft, self.truth.reference.form, 0
        if form is ReferenceForm.NONE:
            return
        for times, field in self.references():
            for time_ns, (x, y, z) in zip(times.tolist(), field.tolist(), strict=True):
                common = {"craft": craft, "source": "ref", "sequence": sequence, "time_ns": time_ns}
                if form is ReferenceForm.MAGNITUDE:
                    sample = ReferenceSample(**common, magnitude_nt=math.sqrt(x * x + y * y + z * z))
                else:
                    sample = ReferenceSample(**common, field_nt=(x, y, z), frame=Frame.ECI)
                yield Emission(self._emit_s(time_ns), sample)
                sequence += 1

    def positions(self) -> tuple[Times, Floats]:
        """Times (n,) [ns] and positions (n, 3) [km] ECI that are sent; empty where the scenario asks for none."""
        plan = self.truth.position
        times = self.times_ns(plan.rate_hz) if plan.rate_hz > 0.0 else np.empty(0, dtype=np.int64)
        noise = streams.generator(self.seed, Stream.POSITION).standard_normal((len(times), 3)) * plan.noise_km
        return times, self.truth.orbit.position_eci_km(times) + noise

    def _positions(self) -> Iterator[Emission]:
        craft = self.truth.craft
        times, places = self.positions()
        for sequence, (time_ns, (x, y, z)) in enumerate(zip(times.tolist(), places.tolist(), strict=True)):
            sample = PositionSample(
                craft=craft,
                source="gps",
                sequence=sequence,
                time_ns=time_ns,
                position_km=(x, y, z),
                frame=Frame.ECI,
            )
            yield Emission(self._emit_s(time_ns), sample)

    def channel(self, channel: Channel) -> tuple[Times, Floats]:
        """Times (n,) [ns] and values (n, k) of a telemetry channel that the scenario sends, noise included."""
        plan = self.truth.telemetry
        times = self.times_ns(plan.rate_hz)
        values = self._values(channel, self.elapsed_s(times))
        noise = dict(zip(plan.channels, plan.noise, strict=True))[channel]
        rng = streams.generator(self.seed, Stream[channel.name])
        return times, values + noise * rng.standard_normal(values.shape)

    def _values(self, channel: Channel, at_s: Floats) -> Floats:
        """Values (n, k) of a telemetry channel at elapsed times (n,) [s], without noise."""
        effects = self.truth.effects
        if channel is Channel.TEMPERATURE:
            values = self.environment.temperature_degc(at_s)[:, None]
        elif channel is Channel.CURRENT:
            sun, lit = self.environment.sun_body(at_s), self.environment.lit(at_s)
            values = np.stack([panel.current_a(sun, lit) for panel in effects.panels], axis=-1)
        elif channel is Channel.TORQUER and effects.torquer is not None:
            values = effects.torquer.commanded_am2(at_s)
        elif channel is Channel.SUN:
            values = self.environment.sun_body(at_s) * (self.environment.lit(at_s) > _SUN_SENSOR_LIT)[:, None]
        else:
            values = self.truth.spin.rate_body_rad_s(at_s)
        return values

    def _telemetry(self) -> list[Iterator[Emission]]:
        return [self._channel(channel) for channel in self.truth.telemetry.channels]

    def _channel(self, channel: Channel) -> Iterator[Emission]:
        craft = self.truth.craft
        times, values = self.channel(channel)
        for sequence, (time_ns, row) in enumerate(zip(times.tolist(), values.tolist(), strict=True)):
            sample = TelemetrySample(
                craft=craft,
                source=channel.value,
                sequence=sequence,
                time_ns=time_ns,
                channel=channel.value,
                unit=UNITS[channel],
                values=tuple(row),
            )
            yield Emission(self._emit_s(time_ns), sample)
