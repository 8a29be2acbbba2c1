"""A physics model as records that declare how they stand in ``physics.toml``.

A model is numbers alone: nine errors, and for each effect the name, driver and form that pick a ``Hypothesis`` of the
catalogue, with the amplitudes by block, the nonlinear numbers and the constants that the form was fitted with.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final

import numpy as np

from magcal_service.base.errors import InputRefusedError
from magcal_service.base.typed_toml import nearest
from magcal_service.base.typed_toml.keys import choice, number, numbers, section, sections, special, text
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.model import Array, d_matrix
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.apply.empirical import MOST_CURVES, Empirical
from magcal_service.physics.apply.named_arrays import named_arrays, named_numbers
from magcal_service.physics.catalogue import catalogue
from magcal_service.wire.messages import Clock, Vector

VERSION: Final = 1
"""Of the format: another one may give known keys another meaning, so it is refused."""

MOST_EFFECTS: Final = 32
"""More than the catalogue has; bounds what is computed for each sample live."""

_DRIVER: Final = re.compile(r"none|channel:[^\s\x00-\x1f]{1,200}|inferred:[a-z_]{1,32}")

_UNIT: Final = 1e-6
"""How far a direction's length may be from 1."""

_LARGEST_NT: Final = 1e6  # 1 mT: more than this is no magnetometer reading

_LARGEST_D: Final = 1e3  # absurd for a scale, and far from where eigenvalues lose their digits

_LEAST_EIGENVALUE: Final = 0.1
"""Of I + D: the model divides by it, and below no real sensor is described."""

_FASTEST_RAD_S: Final = 320.0  # just above the 3000 rpm that a configuration accepts


_A_SIGMA: Final = "numbers of 0 or more are accepted"

_LEVEL: Final = "level_nt"
"""What an effect on the noise calls the level of the whole."""

_ADDED: Final = "added_noise_nt"
"""What an effect calls the noise that it adds to the sensor's own."""


class ModelError(InputRefusedError):
    """A physics file was refused."""


def _effect(reading: Reading, key: str) -> str:
    """The name of an effect of the catalogue; empty where it is refused."""
    table, known = reading.table, {effect.name for effect in catalogue()}
    name = table.text(key, accepted="the name of an effect of the catalogue")
    if name in known:
        return name
    if isinstance(table.content.get(key), str):
        table.refuse(key, name, nearest(name, known))
    return ""


def _check_driver(reading: Reading, key: str, driver: str) -> None:
    if not _DRIVER.fullmatch(driver):
        hint = f"did you mean {meant!r}? " if (meant := _meant_driver(driver)) else ""
        reading.table.refuse(key, driver, f'{hint}"none", "channel:NAME" or "inferred:NAME" is accepted')


def _meant_driver(driver: str) -> str:
    """The driver that one of no kind was probably meant to be; a word alone is taken for a channel's name."""
    kind, sign, name = driver.partition(":")
    close = get_close_matches(kind.strip().lower(), ("none", "channel", "inferred"), n=1)
    if close == ["none"]:
        return "none"
    meant = f"{close[0]}:{name.strip()}" if close else f"channel:{driver.strip()}"
    return meant if _DRIVER.fullmatch(meant) and (close or not sign) else ""


def _blocks(reading: Reading) -> Mapping[str, str] | None:
    """Units by name of the effect's blocks and nonlinear numbers; None where the effect was refused."""
    name: str = reading.values["effect"]
    return next((effect.units for effect in catalogue() if effect.name == name), None)


def _amplitudes(reading: Reading, key: str) -> dict[str, Array]:
    amplitudes = named_arrays(reading.table, key, _blocks(reading))
    if not amplitudes and not reading.table.faults:
        reading.table.lack(key, "required: a table [effect.amplitudes] with at least one block")
    return amplitudes


def _sigma(reading: Reading, key: str) -> dict[str, Array]:
    return named_arrays(reading.table, key, dict.fromkeys(reading.values["amplitudes"], ""))


def _nonlinear(reading: Reading, key: str) -> dict[str, float | Array]:
    found: dict[str, float | Array] = {}
    for name, value in named_arrays(reading.table, key, _blocks(reading)).items():
        if value.ndim > 1:
            reading.table.refuse(f"{key}.{name}", value.tolist(), "one number or a list of them is accepted")
        found[name] = value if value.ndim else float(value)
    return found


def _constants(reading: Reading, key: str) -> dict[str, float]:
    constants = named_numbers(reading.table, key, None)
    effect = next((one for one in catalogue() if one.name == reading.values["effect"]), None)
    outdated = "" if effect is None else effect.outdated(reading.values["variant"], constants)
    if outdated:
        reading.table.refuse(key, sorted(constants), outdated)
    return constants


def _values(reading: Reading, key: str) -> dict[str, Array]:
    return named_arrays(reading.table, key, None)


@dataclass(frozen=True, slots=True, eq=False)
class ModelTerm:
    """One effect of a model.

    Parameters
    ----------
    effect, driver, variant: which hypothesis of the catalogue.
    amplitudes, sigma: by name of the block, in the hypothesis' order; sigma may leave some out.
    nonlinear: by name, in the hypothesis' order; several of one name, such as instants, as a list.
    constants: what the hypothesis was fitted with, such as the temperature that counts as zero.
    """

    effect: str = special(_effect, name="name")
    driver: str = text("none", check=_check_driver, file_only=True)
    variant: str = text("", file_only=True)
    amplitudes: Mapping[str, Array] = special(_amplitudes)
    sigma: Mapping[str, Array] = special(_sigma, {})
    nonlinear: Mapping[str, float | Array] = special(_nonlinear, {})
    constants: Mapping[str, float] = special(_constants, {})

    @property
    def block_names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return tuple(self.amplitudes)


@dataclass(frozen=True, slots=True, eq=False)
class Note:
    """An effect that is no field, such as nutation: stated, and not compensated."""

    effect: str = special(_effect)
    says: str = text("", file_only=True)
    values: Mapping[str, Array] = special(_values, {})


def _check_unit(reading: Reading, key: str, axis: Vector) -> None:
    if abs(math.hypot(*axis) - 1.0) > _UNIT:
        reading.table.refuse(key, list(axis), "a vector of length 1 is accepted")


@dataclass(frozen=True, slots=True)
class ModelSpin:
    """A steady turn: axis (3,) in the body and in ECI, mean rate [rad/s] about it."""

    axis_body: Vector = numbers(3, fallback=(0.0, 0.0, 1.0), check=_check_unit, file_only=True)
    axis_eci: Vector = numbers(3, fallback=(0.0, 0.0, 1.0), check=_check_unit, file_only=True)
    rate_rad_s: float = number(minimum=-_FASTEST_RAD_S, maximum=_FASTEST_RAD_S, unit="rad/s")


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsModel:
    """A whole file.

    Parameters
    ----------
    recording: name of the recording it comes from.
    craft: whose it is; empty where the recording did not say.
    origin_ns, clock: instant from which effects count their time.
    x, sigma: the nine errors (9,) and their 1 sigma, fitted together with the effects.
    noise_nt: white noise, 1 sigma per axis [nT].
    doubts: what speaks against acting on it, as the diagnosis names its reasons; empty where nothing does.
    empirical: curves without a name, beside the effects.
    """

    recording: str
    origin_ns: int
    clock: Clock
    x: Array
    sigma: Array
    noise_nt: float
    terms: tuple[ModelTerm, ...] = ()
    notes: tuple[Note, ...] = ()
    spin: ModelSpin | None = None
    doubts: str = ""
    empirical: tuple[Empirical, ...] = ()
    craft: str = ""

    @property
    def sample_noise_nt(self) -> float:
        """Noise of a sample, 1 sigma per axis [nT]: as a note on it says, of which ``noise_nt`` is the white part."""
        on_noise = {effect.name for effect in catalogue() if effect.acts_on is ActsOn.NOISE}
        levels = [note.values[_LEVEL] for note in self.notes if note.effect in on_noise and _LEVEL in note.values]
        return max([self.noise_nt, *(float(level) for level in levels if level.ndim == 0)])

    @property
    def added_noise_nt(self) -> float:
        """What a note says is added to the sensor's own noise, as by a lattice, 1 sigma per axis [nT]; 0 where none."""
        added = [note.values[_ADDED] for note in self.notes if _ADDED in note.values]
        return max((float(level) for level in added if level.ndim == 0), default=0.0)


def _origin(reading: Reading, key: str) -> int:
    """ns since 1970, or of the clock's zero; fits an int64."""
    value = reading.table.content.get(key)
    reading.table.has(key)
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 1 << 63:
        accepted = "a whole number of nanoseconds is accepted"
        reading.table.refuse_or_lack(key, accepted)
        return 0
    return value


@dataclass(frozen=True, slots=True)
class RecordingSection:
    """``[recording]``: what the model comes from, and the instant from which its effects count their time."""

    name: str = text("", accepted="the recording's name", file_only=True)
    craft: str = text("", accepted="the name of the craft", file_only=True)
    origin_ns: int = special(_origin)
    clock: Clock = choice(Clock)
    doubts: str = text("", accepted="reasons against acting on the model, by name", file_only=True)


def _check_distortion(reading: Reading, key: str, D: tuple[float, ...]) -> None:
    x = np.array([0.0, 0.0, 0.0, *D])
    if not np.abs(D).max() < _LARGEST_D or np.linalg.eigvalsh(np.eye(3) + d_matrix(x))[0] < _LEAST_EIGENVALUE:
        reading.table.refuse(key, list(D), "I + D with eigenvalues above 0.1 is accepted")


@dataclass(frozen=True, slots=True)
class ErrorsSection:
    """``[errors]``: the nine errors, their 1 sigma, and the white noise, 1 sigma per axis [nT]."""

    bias_nt: Vector = numbers(
        3, minimum=-_LARGEST_NT, maximum=_LARGEST_NT, accepted="numbers from -1e6 to 1e6 are accepted", unit="nT"
    )
    D: tuple[float, ...] = numbers(6, check=_check_distortion)
    bias_sigma_nt: Vector = numbers(3, (0.0,) * 3, minimum=0.0, accepted=_A_SIGMA, unit="nT")
    D_sigma: tuple[float, ...] = numbers(6, (0.0,) * 6, minimum=0.0, accepted=_A_SIGMA)
    noise_nt: float = number(0.0, 0.0, _LARGEST_NT, unit="nT")


def _terms(reading: Reading, key: str) -> tuple[ModelTerm, ...]:
    tables = reading.table.tables(key)
    if len(tables) > MOST_EFFECTS:
        reading.table.refuse(key, len(tables), f"at most {MOST_EFFECTS} tables [[effect]] are accepted")
    return tuple(read_record(table, ModelTerm) for table in tables[:MOST_EFFECTS])


def _curves(reading: Reading, key: str) -> tuple[Empirical, ...]:
    tables = reading.table.tables(key)
    if len(tables) > MOST_CURVES:
        reading.table.refuse(key, len(tables), f"at most {MOST_CURVES} tables [[empirical]] are accepted")
    return tuple(read_record(table, Empirical) for table in tables[:MOST_CURVES])


@dataclass(frozen=True, slots=True)
class ModelSections:
    """The sections of a file as they stand in it."""

    recording: RecordingSection = section(RecordingSection)
    errors: ErrorsSection = section(ErrorsSection)
    terms: tuple[ModelTerm, ...] = special(_terms, (), name="effect")
    empirical: tuple[Empirical, ...] = special(_curves, ())
    notes: tuple[Note, ...] = sections(Note, name="note")
    spin: ModelSpin | None = section(ModelSpin, None)

    def model(self) -> PhysicsModel:
        """The model they make."""
        errors = self.errors
        return PhysicsModel(
            recording=self.recording.name,
            origin_ns=self.recording.origin_ns,
            clock=self.recording.clock,
            x=np.array([*errors.bias_nt, *errors.D]),
            sigma=np.array([*errors.bias_sigma_nt, *errors.D_sigma]),
            noise_nt=errors.noise_nt,
            terms=self.terms,
            notes=self.notes,
            spin=self.spin,
            doubts=self.recording.doubts,
            empirical=self.empirical,
            craft=self.recording.craft,
        )
