"""What every estimator offers, so that the pipeline and the verdict need not know which it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from magcal_service.config.settings import CraftConfig
from magcal_service.model import Array
from magcal_service.ticks.assembler import Tick


class Phase(StrEnum):
    """Where an estimator is in its life: collecting for a start, or running."""

    STARTING = "starting"
    RUNNING = "running"


class StartGate(StrEnum):
    """Why a batch solution was not accepted."""

    NOT_POSITIVE = "not_positive"
    COLLAPSED = "collapsed"
    POOR_COVERAGE = "poor_coverage"
    NO_CONVERGENCE = "no_convergence"
    BAD_FIT = "bad_fit"


@dataclass(frozen=True, slots=True)
class TickOutcome:
    """What one tick did to the estimate.

    Parameters
    ----------
    phase: the estimator's phase after the tick.
    residual_nt: scalar residuals e = |w| - |H| of the tick's samples, before they were used (n,) [nT].
    used, rejected: samples that entered the estimate or the start, and samples stopped by the gate.
    squared_innovation, degrees: normalised innovation squared of the scalar update and its expectation (0: no update).
    spin_squared_innovation: the same for a spin window that ended in this tick (expectation 2), or None.
    spin_rejected: the spin window was stopped by the gate.
    """

    phase: Phase
    residual_nt: Array
    used: int
    rejected: int = 0
    squared_innovation: float = 0.0
    degrees: int = 0
    spin_squared_innovation: float | None = None
    spin_rejected: bool = False

    def with_spin(self, squared_innovation: float, *, rejected: bool) -> TickOutcome:
        """The same outcome with what a spin window did."""
        return replace(self, spin_squared_innovation=squared_innovation, spin_rejected=rejected)


@dataclass(frozen=True, slots=True)
class StateEstimate:
    """The estimate as it stands.

    Parameters
    ----------
    x, covariance: state (9,) and covariance (9, 9) in the order of ``model.STATE_NAMES`` [nT, -].
    phase: whether a start has been made (before that, x and covariance are the prior's).
    noise_nt: sensor noise that the covariance assumes [nT], 0 while unknown.
    samples, rejected: magnetometer samples used and stopped so far.
    restarts: times the estimator lost consistency and restarted.
    waiting_for: the gate that stopped the last attempt at a start, None where none did.
    spin_given_up: the spin windows contradicted the scalar measurement and are no longer used.
    departure: what makes it another than that of least squares on the scalar residuals of all ticks since its start,
        weighted alike, in a word or two; empty where nothing does.
    followed: jumps of the errors that it has found and followed.
    """

    x: Array
    covariance: Array
    phase: Phase
    noise_nt: float
    samples: int
    rejected: int
    restarts: int
    waiting_for: StartGate | None
    spin_given_up: bool
    departure: str = "its method"
    followed: int = 0

    @property
    def is_least_squares(self) -> bool:
        """Whether what a disturbance does to it follows from its covariance (``trust.protector``)."""
        return not self.departure


class InformationSet(StrEnum):
    """What is known beside the measured vectors (``studies.bounds`` has what each is worth)."""

    SCALAR = "scalar"
    SCALAR_SPIN = "scalar_spin"
    VECTOR_SPIN = "vector_spin"
    VECTOR_ATTITUDE = "vector_attitude"


class Estimator(Protocol):
    """A calibration method in real time: ticks in, an estimate at any moment; no clock, file or socket inside."""

    @property
    def name(self) -> str:
        """The method's name in configurations and messages."""

    def reset(self) -> None:
        """Back to the prior, before any sample."""

    def handle(self, tick: Tick) -> TickOutcome:
        """Take one tick, in order of time."""

    def estimate(self) -> StateEstimate:
        """The estimate after the last tick."""

    def export_state(self) -> dict[str, Any]:
        """The whole state as plain data (``snapshot.Stateful``)."""

    def restore_state(self, saved: object, where: str = "state", given: Mapping[Any, Any] | None = None) -> None:
        """Restore an exported state; ``SnapshotError`` where it does not fit."""


@runtime_checkable
class GoesOn(Protocol):
    """An estimator that can go on from nine errors that are known (``Method.takes_prior``)."""

    def begin_with(self, x: Array, covariance: Array, noise_nt: float) -> None:
        """Run from now on, from a state (9,) and its covariance (9, 9) [nT, -]."""


@dataclass(frozen=True, slots=True)
class Method:
    """An entry of the registry.

    Parameters
    ----------
    name: as in configurations and messages; its file is named like it, with ``_`` for ``-``.
    summary: one line about it.
    build: the class of its estimators, which takes a craft's configuration.
    needs: quantity (``units.CHANNEL_UNITS``) of a telemetry channel of three values without which the method learns
        nothing; empty where it needs none.
    has_process_noise: whether the random walk of the settings is used, so that the ``process_noise`` command applies.
    estimates_matrix: whether it estimates D; without, D is zero and its sigma stays the prior's.
    takes_wide_prior: whether it finds errors of tens of percent of the field from a prior as wide; without, the prior
        has to be one that the tangent at zero still fits.
    takes_prior: whether it can go on from nine errors that are known (``GoesOn``).
    bound: the information set whose Cramer-Rao bound its results are held against.
    """

    name: str
    summary: str
    build: Callable[[CraftConfig], Estimator]
    needs: str = ""
    has_process_noise: bool = True
    estimates_matrix: bool = True
    takes_wide_prior: bool = True
    takes_prior: bool = False
    bound: InformationSet = InformationSet.SCALAR

    def missing(self) -> tuple[str, ...]:
        """Members of ``Estimator`` that ``build`` does not have."""
        members = (name for name in vars(Estimator) if not name.startswith("_"))
        return tuple(name for name in members if not hasattr(self.build, name))
