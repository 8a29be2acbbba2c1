"""What an effect of the catalogue is: a named piece of physics with drivers, columns, parameters and rivals.

Every effect is linear in its amplitudes once its few nonlinear numbers (a lag, a change time, a frequency) are held:

    B = (I + D)^-1 (A H + b + d + eps),   d = sum_k c_k g_k(t; theta)        additive body field, corrected frame
    |A H| = |H_ref| + sum_k c_k m_k(t; theta)                                a wrong reference

so a hypothesis provides columns g_k (body field [nT per unit of c_k]) or m_k (magnitude [nT per unit]), and these
columns are the derivatives of the residual: u'g for a body field, m for a magnitude (u: the field's direction in the
body).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Direct, Term, Watched
from magcal_service.physics.columns import Columns
from magcal_service.physics.held import Form, HeldAt
from magcal_service.physics.saying import Said, filled
from magcal_service.physics.segments import Sums

if TYPE_CHECKING:
    from magcal_service.physics.scene.scene import Scene
    from magcal_service.physics.scene.view import View


UNLISTED: Final = "unknown"
"""What stands among the rivals of a name for causes that are in no catalogue."""

START: Final = "start_"
"""Begins the name of a block that is the state a recording begins in."""

_NEARLY: Final = 1.5
"""Times the quickest that is tried, which a change over a while has to take: what is found there would be quicker."""


@dataclass(frozen=True, slots=True)
class Block:
    """A named parameter made of consecutive amplitudes: name, unit and shape as the results give it.

    Parameters
    ----------
    most: absolute value that one of them has at most by its physics, in the unit; what goes beyond is no such effect.
    least, highest: values that each of them has at least, and at the most, by its physics.
    labels: names along each dimension, where they are not the axes.
    completes: whether it only completes what another block of its form says: alone it is no evidence for the name.
    each: name of the block that has a number for each axis, in another form, where this one stands for all of them.
    """

    name: str
    unit: str
    shape: tuple[int, ...] = (3,)
    most: float = math.inf
    least: float = -math.inf
    highest: float = math.inf
    labels: tuple[tuple[str, ...], ...] = ()
    completes: bool = False
    each: str = ""

    @property
    def size(self) -> int:
        """How many amplitudes it takes."""
        return math.prod(self.shape)

    def takes(self, shape: tuple[int, ...]) -> bool:
        """Whether numbers of a shape are those of the block: the only row of a matrix may stand there as it is.

        One circuit that others go along with is a row by itself in its recording, and a circuit where they do not.
        """
        return _rows(shape) == _rows(self.shape)

    @property
    def is_start(self) -> bool:
        """Whether it is the state that a recording begins in, which decays, so that only its first part tells it."""
        return self.name.startswith(START)


@dataclass(frozen=True, slots=True, eq=False)
class Nonlinear:
    """A number the columns depend on; several of one name are one list, in the order of the columns' numbers.

    Parameters
    ----------
    grid: values that are tried first (m,); empty where ``role`` says that the residual's own lines are tried.
    spans: whether the grid spans what its physics allows, whatever the recording.
    role: ``"frequency"`` or ``"period"`` of a line of the residual, ``"instant"`` of a change, ``"edge"`` of one that
        takes a while, ``"loose"`` while a refit moves it, ``"held"`` once it has been searched (the columns jump with
        it), or ``""``.
    """

    name: str
    unit: str
    grid: Array
    role: str = ""
    spans: bool = False


def _rows(shape: tuple[int, ...]) -> tuple[int, ...]:
    """A shape without dimensions of one before the others."""
    return _rows(shape[1:]) if shape[:1] == (1,) else shape


def by_name(numbers: Sequence[Nonlinear], values: Sequence[float] | Array) -> dict[str, float | Array]:
    """Values (m,) of nonlinear numbers by their names: those of one name, such as instants, as an array."""
    found: dict[str, list[float]] = {}
    for number, value in zip(numbers, values, strict=True):
        found.setdefault(number.name, []).append(float(value))
    return {name: each[0] if len(each) == 1 else np.array(each) for name, each in found.items()}


WHOLE: Final = 0.25  # a whole shift has the amplitude 1; a fit may be so far off, a first look twice as far
_FEWEST_SEEN: Final = 4  # samples; choice: fewer show no course of a change

Proposals = Callable[[Sums, Sequence[Array]], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One way an effect may act on one recording: a driver, a form, and its columns.

    Parameters
    ----------
    effect: name in the catalogue.
    driver: ``channel:NAME``, ``inferred:NAME`` or ``none``.
    variant: which of the effect's forms; "" for the plain one.
    columns: from the nonlinear numbers (m,) to the columns.
    blocks: the amplitudes by name, in the order of the columns.
    nonlinear: what ``columns`` takes; none for most.
    constants: numbers that belong to the form and are no parameters, such as the temperature that counts as zero.
    odds: natural logarithm of the prior odds against the plain form.
    largest_nt: rms that this form may have at most [nT], where that is less than the effect's.
    least_nt: rms that this form has at least [nT], whatever its numbers: a small residual rules it out.
    is_free: whether no driver holds its shape, so that it can follow anything: it has to beat families without a name.
    by_samples: whether it acts by how the samples follow one another, as noise with a memory does.
    is_whole: whether its one amplitude is 1 by its physics: a shift that takes part of a shifted field is none.
    proposals: from sums over the residual, and the grids (m) that are tried for it, to nonlinear numbers (q, m) worth
        trying; None: the grids' combinations are.
    refines: label of the form that it adds a number to: tried only where that comes near the best; empty: always.
    in_place: whether it only takes the place of a form that was found, as it does better there; never one effect more.
    at_once: effect of the same change at an instant, for one that takes a while.
    as_well: other effects that act exactly so, and are met as often: the field alone never tells them apart.
    imitated_by: what in no catalogue acts exactly so, in words; empty: nothing that is known.
    needs_vectors: whether only whole vectors show it, beside a recorded attitude.
    inexact: of its evidence, what its form leaves for others to take, as where its course is guessed.
    if_completed: other effects that it may as well be where only blocks that complete its form stand out.
    if_along: other effects that a jump may as well be where a record jumps along with it.
    if_none: effects that it may as well be where sums of amplitudes, by rows (c, k) of weights, are not seen.
    samples_in: from its nonlinear numbers (m,) to how many samples see a change over a while come about; None: it is
        none.
    moves_s: from its amplitudes (k,) to how far along the recording's course it moves the reference [s], one number or
        one a sample (n,): ``Scene.moved_s`` of the next expansion.  None: it does not.
    """

    effect: str
    driver: str
    columns: Callable[[Array], Columns]
    blocks: tuple[Block, ...]
    variant: str = ""
    nonlinear: tuple[Nonlinear, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    odds: float = 0.0
    largest_nt: float = math.inf
    least_nt: float = 0.0
    is_free: bool = False
    by_samples: bool = False
    is_whole: bool = False
    proposals: Proposals | None = None
    refines: str = ""
    in_place: bool = False
    at_once: str = ""
    as_well: tuple[str, ...] = ()
    imitated_by: str = ""
    needs_vectors: bool = False
    inexact: float = 0.0
    if_completed: tuple[str, ...] = ()
    if_along: tuple[str, ...] = ()
    if_none: tuple[tuple[str, Array], ...] = ()
    samples_in: Callable[[Array], int] | None = None
    moves_s: Callable[[Array], Array | float] | None = None

    @property
    def label(self) -> str:
        """Effect, form and driver in one text, unique in a recording."""
        form = f"{self.effect}[{self.variant}]" if self.variant else self.effect
        return form if self.driver == "none" else f"{form} by {self.driver}"

    @property
    def exactly_alike(self) -> tuple[str, ...]:
        """``as_well``, and ``UNLISTED`` where something in no catalogue acts so."""
        return (*self.as_well, UNLISTED) if self.imitated_by else self.as_well

    @property
    def block_names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return tuple(block.name for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of amplitudes."""
        return sum(block.size for block in self.blocks)

    @property
    def is_inferred(self) -> bool:
        """Whether its driver was computed, not recorded: its course is not exactly true."""
        return self.driver.startswith("inferred")

    def loosened(self) -> Hypothesis:
        """The same with nonlinear numbers that a refit moves, whatever their role."""
        return replace(self, nonlinear=loose(self.nonlinear))

    def holding(self, *held: int) -> Hypothesis:
        """The same with some nonlinear numbers, by their indices, that a refit leaves where they are."""
        numbers = (replace(one, role="held") if index in held else one for index, one in enumerate(self.nonlinear))
        return replace(self, nonlinear=tuple(numbers))

    def anew(self, theta: Array) -> Array:
        """Nonlinear numbers (m,) of this form as it was made before; one that has one value only now takes it."""
        numbers = zip(self.nonlinear, theta, strict=True)
        return np.array([n.grid[0] if n.role == "held" and len(n.grid) == 1 else value for n, value in numbers])

    def is_quickest(self, theta: Array) -> bool:
        """Whether, with numbers (m,), it is a change over a while as quick as any that is tried: that is a jump.

        So is one that hardly a sample sees come about, as between the last before a gap and the first after it.
        """
        if self.samples_in is not None and self.samples_in(theta) < _FEWEST_SEEN:
            return True
        numbers = zip(self.nonlinear, theta, strict=True)
        return self.in_place and any(not n.role and value <= _NEARLY * n.grid.min() for n, value in numbers)


def loose(numbers: Sequence[Nonlinear]) -> tuple[Nonlinear, ...]:
    """Nonlinear numbers that a refit moves, whatever their role."""
    return tuple(replace(number, role="loose") for number in numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """A parameter as found.

    Parameters
    ----------
    value, sigma: of one shape; sigma NaN where none is claimed.
    unit: of both.
    labels: names along each dimension, where they are not the axes.
    bounds: what it lies between by its physics, or was searched between; None where there is no such limit.
    """

    value: Array
    sigma: Array
    unit: str
    labels: tuple[tuple[str, ...], ...] = ()
    bounds: tuple[float, float] | None = None


def value_of(value: float | Sequence[float] | Array, sigma: float | Sequence[float] | Array, unit: str) -> Value:
    """A ``Value`` from plain numbers."""
    return Value(np.asarray(value, dtype=np.float64), np.asarray(sigma, dtype=np.float64), unit)


Values = Mapping[str, Value]


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """An effect that shows in the samples, the attitude or the noise, rather than as a field.

    Parameters
    ----------
    parameters: what was found.
    nats: evidence for it over its absence.
    share: of the mismatch in the residual that it touches, 0 to 1.
    spoiled: (n,) rows that no fit should use, or None.
    time_s: from and to, where it acts for a part of the recording only.
    driver: as of a hypothesis.
    rivals: what it may be instead, each with the least probability that is left to it, most probable first.
    off_nats: evidence expected of as long a recording with it switched off, for it or for a rival, whichever is true
        [nats]; 0 where that is not worked out.
    """

    parameters: Values
    nats: float
    share: float
    spoiled: NDArray[np.bool_] | None = None
    time_s: tuple[float, float] | None = None
    driver: str = "none"
    rivals: tuple[tuple[str, float], ...] = ()
    off_nats: float = 0.0

    @property
    def doubt(self) -> float:
        """Least probability that is left to something else."""
        return sum(probability for _, probability in self.rivals)


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """An entry of the catalogue.

    Parameters
    ----------
    name: as in every result.
    acts_on: what it disturbs.
    title, equation: what it is, in a few words; what acts on the field, in the letters of ``interface``.
    units: unit of each parameter it may report, by name.
    prior, valid: usual size of the disturbance [nT], from and to; where the form holds.
    confused_with: effects with similar signatures.
    separated_by: the observation that distinguishes them; ``or_record``: quantities whose record does so as well.
    source: where the form comes from.
    says: sentences of cause and size, with ``{driver}`` and properties of parameters (``saying.Said``) in braces; the
        first whose parameters are all there is used.
    record_next: what to record otherwise of a driver that was recorded, as requests, with ``{channel}`` and properties
        of parameters in braces; the first whose parameters are all there is used.
    hypotheses: every way it may act as a field on a scene; empty where the recording lacks what it needs.
    find: detects it in samples, attitude or noise, or in when a field comes and goes; None for one that acts as a field
        of a known course only.
    derived: further parameters computed from those that were fitted.
    absorbed: what of it the nine errors absorb; empty where nothing.
    not_live: drivers and forms that no single moment determines, so that they are not compensated live.
    bends: it acts on the field as it would be without it: live, on what a first look at it leaves.
    needs_rate: live, it needs the craft's rate.
    in_orbit_only: it does not occur anywhere else.
    switched: what one switches off to make it go away, with its article; empty where nobody can.
    of_one_recording: its strength is another one every day, or its course begins with the first sample.
    two_levels: it may go on and off at no regular times, by what is often not recorded.
    is_line: it is one line of a spectrum, of which several together repeat in any shape.
    watched: what the watch sees of it, and the quantity that it follows where there is one.
    direct: its direct form where a term has one, for the live path; None: evaluated on a scene.
    held_at: where a form adds nothing, so that nine errors fitted beside it are those there; None where there is no
        such value of a driver.
    live_as: what is subtracted live in place of a form, which no single moment determines, in words; empty where it is
        the form itself.
    outdated: why a file's form with these constants is one of before, that is computed otherwise today; empty where it
        is not.
    """

    name: str
    acts_on: ActsOn
    title: str
    equation: str
    units: Mapping[str, str]
    prior: tuple[float, float]
    valid: str
    confused_with: tuple[str, ...]
    separated_by: str
    source: str
    says: tuple[str, ...]
    or_record: tuple[tuple[str, str], ...] = ()
    record_next: tuple[str, ...] = ()
    hypotheses: Callable[[Scene], Sequence[Hypothesis]] = lambda _: ()
    find: Callable[[View], Finding | None] | None = None
    derived: Callable[[Values], Values] = lambda _: {}
    absorbed: str = ""
    not_live: tuple[str, ...] = ()
    bends: bool = False
    needs_rate: bool = False
    in_orbit_only: bool = False
    switched: str = ""
    of_one_recording: bool = False
    two_levels: bool = False
    is_line: bool = False
    watched: tuple[tuple[Watched, str], ...] = ()
    direct: Callable[[Term], Direct | None] = lambda _: None
    held_at: Callable[[Form], HeldAt | None] = lambda _: None
    live_as: Callable[[str], str] = lambda _form: ""
    outdated: Callable[[str, Mapping[str, float]], str] = lambda _form, _constants: ""

    def sentence(self, parameters: Values, driver: str, others: Sequence[str] = ()) -> str:
        """What was found, in one sentence with its numbers.

        Parameters
        ----------
        driver: as of a hypothesis; ``others``: those that drive it as well as can be told.
        """
        kind, _, name = driver.partition(":")
        drives = f"the recorded {name}" if kind == "channel" else f"the inferred {name.replace('_', ' ')}"
        if others:
            drives += f" (or {', '.join(other.partition(':')[2] for other in others)})"
        return filled(self.says, _said(parameters), {"driver": drives}) or f"{self.title[0].upper()}{self.title[1:]}."

    def next_record(self, parameters: Values, driver: str) -> str:
        """What to record otherwise of a recorded driver, as a request with its numbers; empty where nothing."""
        kind, _, name = driver.partition(":")
        return filled(self.record_next, _said(parameters), {"channel": f"channel {name}"}) if kind == "channel" else ""

    def separation(self, recorded: Collection[str]) -> str:
        """What distinguishes it from its rivals, beside what is recorded: channels of some quantities."""
        return "; or ".join([self.separated_by, *(what for of, what in self.or_record if of not in recorded)])


def _said(parameters: Values) -> dict[str, Said]:
    return {name: Said(v.value, v.sigma, v.unit, v.labels, v.bounds) for name, v in parameters.items()}
