"""What goes wrong between sensor and daemon, as transformations of the stream of messages.

Each fault takes emissions in order of their time of sending and yields them so; each draws from a seed of its own.
Sequence numbers are given before any fault, so that a loss shows as a gap.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from magcal_service.base.typed_toml import Table
from magcal_service.base.typed_toml.keys import choice, special
from magcal_service.base.typed_toml.record import Limits, Reading, read_record
from magcal_service.wire.messages import (
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Vector,
)
from sim_sensor.declarations import LONGEST_S

SPIKE_NT = 500_000.0  # per axis: absurd as a field, yet below the 1 mT that the wire refuses


class Emission(NamedTuple):
    """A message and the elapsed simulated time at which the node sends it [s]."""

    emit_s: float
    message: Message


class FaultKind(StrEnum):
    """Every fault of the link, and what it does to the messages it concerns."""

    DROPOUT = "dropout"
    """Each message is lost with ``probability``."""
    DUPLICATE = "duplicate"
    """Each message is sent twice with ``probability``."""
    CORRUPTION = "corruption"
    """Each vector is replaced with ``probability`` by random values up to 0.5 mT per axis."""
    JITTER = "jitter"
    """Time stamps are off by white noise of ``sigma_s``."""
    CLOCK_DRIFT = "clock_drift"
    """Time stamps run fast by ``ppm``."""
    CLOCK_STEP = "clock_step"
    """Time stamps are later by ``step_s`` from ``at_s`` on."""
    OUT_OF_ORDER = "out_of_order"
    """Each message is sent late by up to ``delay_s`` with ``probability``, behind others."""
    STUCK = "stuck"
    """From ``at_s`` for ``for_s`` the vector keeps its last value."""
    GAP = "gap"
    """From ``at_s`` for ``for_s`` nothing is sent."""


class Target(StrEnum):
    """Whose messages a fault concerns."""

    MAGNETOMETER = "magnetometer"
    REFERENCE = "reference"
    POSITION = "position"
    TELEMETRY = "telemetry"
    ALL = "all"


RECORDS: dict[Target, type[Message]] = {
    Target.MAGNETOMETER: MagnetometerSample,
    Target.REFERENCE: ReferenceSample,
    Target.POSITION: PositionSample,
    Target.TELEMETRY: TelemetrySample,
    Target.ALL: Message,
}


def _needed(minimum: float, maximum: float, unit: str) -> Any:
    """A number that is required by the kinds that read it, and unknown to the others."""

    def read(reading: Reading, name: str) -> float:
        if name not in READS[reading.values["kind"]]:
            return 0.0
        return reading.table.number(name, required=True, minimum=minimum, maximum=maximum) or 0.0

    return special(read, 0.0, limits=Limits(minimum, maximum), unit=unit)


@dataclass(frozen=True)
class LinkFault:
    """One fault: its kind, whom it concerns, and the numbers that its kind reads (see ``FaultKind``)."""

    kind: FaultKind = choice(FaultKind)
    target: Target = choice(Target, Target.MAGNETOMETER)
    probability: float = _needed(0.0, 1.0, "")
    sigma_s: float = _needed(0.0, LONGEST_S, "s")
    ppm: float = _needed(-1e5, 1e5, "ppm")
    at_s: float = _needed(0.0, LONGEST_S, "s")
    for_s: float = _needed(0.0, LONGEST_S, "s")
    step_s: float = _needed(-LONGEST_S, LONGEST_S, "s")
    delay_s: float = _needed(0.0, LONGEST_S, "s")

    def concerns(self, message: Message) -> bool:
        """Whether this message is of the target's kind."""
        return isinstance(message, RECORDS[self.target])

    def during(self, emit_s: float) -> bool:
        """Whether ``emit_s`` lies from ``at_s`` for ``for_s``."""
        return self.at_s <= emit_s < self.at_s + self.for_s


READS: dict[FaultKind, tuple[str, ...]] = {
    FaultKind.DROPOUT: ("probability",),
    FaultKind.DUPLICATE: ("probability",),
    FaultKind.CORRUPTION: ("probability",),
    FaultKind.JITTER: ("sigma_s",),
    FaultKind.CLOCK_DRIFT: ("ppm",),
    FaultKind.CLOCK_STEP: ("at_s", "step_s"),
    FaultKind.OUT_OF_ORDER: ("probability", "delay_s"),
    FaultKind.STUCK: ("at_s", "for_s"),
    FaultKind.GAP: ("at_s", "for_s"),
}
"""The numbers that each kind needs; a scenario may give no others."""


def fault_sections(reading: Reading, name: str) -> tuple[LinkFault, ...]:
    """Every ``[[fault]]`` of a scenario, in order."""
    return tuple(_fault(table) for table in reading.table.tables(name))


def _fault(table: Table) -> LinkFault:
    before = len(table.faults)
    kind = table.choice("kind", FaultKind)
    if len(table.faults) > before:
        return LinkFault(kind)  # what else it needs depends on the kind, so one fault is enough
    return read_record(table, LinkFault, {"kind": kind})


def apply(
    emissions: Iterator[Emission], faults: Iterable[LinkFault], seed: np.random.SeedSequence
) -> Iterator[Emission]:
    """The stream after all faults, in their order."""
    faults = tuple(faults)
    for fault, child in zip(faults, seed.spawn(len(faults)), strict=True):
        emissions = _APPLY[fault.kind](emissions, fault, np.random.default_rng(child))
    return emissions


def _later(message: Message, by_s: float) -> Message:
    return replace(message, time_ns=message.time_ns + round(by_s * 1e9))


def _dropout(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emission in emissions:
        if not (fault.concerns(emission.message) and rng.random() < fault.probability):
            yield emission


def _duplicate(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emission in emissions:
        yield emission
        if fault.concerns(emission.message) and rng.random() < fault.probability:
            yield emission


def _corruption(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emission in emissions:
        if fault.concerns(emission.message) and rng.random() < fault.probability:
            x, y, z = rng.uniform(-SPIKE_NT, SPIKE_NT, 3).tolist()
            yield Emission(emission.emit_s, _with_vector(emission.message, (x, y, z)))
        else:
            yield emission


def _with_vector(message: Message, vector: Vector) -> Message:
    if isinstance(message, MagnetometerSample):
        return replace(message, field_body_nt=vector)
    if isinstance(message, ReferenceSample) and message.field_nt is not None:
        return replace(message, field_nt=vector)
    return message


def _vector(message: Message) -> Vector | None:
    if isinstance(message, MagnetometerSample):
        return message.field_body_nt
    return message.field_nt if isinstance(message, ReferenceSample) else None


def _jitter(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emission in emissions:
        if fault.concerns(emission.message):
            yield Emission(emission.emit_s, _later(emission.message, fault.sigma_s * float(rng.standard_normal())))
        else:
            yield emission


def _clock_drift(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emit_s, message in emissions:
        yield Emission(emit_s, _later(message, emit_s * fault.ppm * 1e-6) if fault.concerns(message) else message)


def _clock_step(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emit_s, message in emissions:
        stepped = emit_s >= fault.at_s and fault.concerns(message)
        yield Emission(emit_s, _later(message, fault.step_s) if stepped else message)


def _out_of_order(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    held: list[tuple[float, int, Message]] = []
    order = count()
    for emit_s, message in emissions:
        while held and held[0][0] <= emit_s:
            late_s, _, late = heapq.heappop(held)
            yield Emission(late_s, late)
        if fault.concerns(message) and rng.random() < fault.probability:
            heapq.heappush(held, (emit_s + fault.delay_s * float(rng.random()), next(order), message))
        else:
            yield Emission(emit_s, message)
    for late_s, _, late in sorted(held):
        yield Emission(late_s, late)


def _stuck(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    last: dict[tuple[type[Message], str], Vector] = {}
    for emission in emissions:
        emit_s, message = emission
        vector, key = _vector(message), (type(message), message.source)
        if vector is None or not fault.concerns(message):
            yield emission
        elif fault.during(emit_s):
            yield Emission(emit_s, _with_vector(message, last.setdefault(key, vector)))
        else:
            last[key] = vector
            yield emission


def _gap(emissions: Iterator[Emission], fault: LinkFault, rng: np.random.Generator) -> Iterator[Emission]:
    for emission in emissions:
        if not (fault.during(emission.emit_s) and fault.concerns(emission.message)):
            yield emission


_Fault = Callable[[Iterator[Emission], LinkFault, np.random.Generator], Iterator[Emission]]
_APPLY: dict[FaultKind, _Fault] = {
    FaultKind.DROPOUT: _dropout,
    FaultKind.DUPLICATE: _duplicate,
    FaultKind.CORRUPTION: _corruption,
    FaultKind.JITTER: _jitter,
    FaultKind.CLOCK_DRIFT: _clock_drift,
    FaultKind.CLOCK_STEP: _clock_step,
    FaultKind.OUT_OF_ORDER: _out_of_order,
    FaultKind.STUCK: _stuck,
    FaultKind.GAP: _gap,
}
