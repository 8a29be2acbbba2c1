"""Effects of ``physics.toml`` subtracted from the samples of a replay: from how many, and why not from the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from magcal_service.daemon.compensating import CompensatingCraft
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.empirical import NAME, OUTSIDE
from magcal_service.physics.apply.lacking import Cause, in_words, lacking_channels
from magcal_service.physics.apply.physics_model import PhysicsModel
from magcal_service.physics.catalogue import effect_named

_NO_CAUSE: Final = "its driver was missing or older than it may be, or its numbers do not fit the samples"
"""Where nobody knows more of it."""


class Fate(StrEnum):
    """What was done with an effect in one sample."""

    COMPENSATED = "compensated"
    NO_DRIVER = "no_driver"
    DRIVER_OUTSIDE = "driver_outside"
    START_UNKNOWN = "start_unknown"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class EffectAccount:
    """One effect of ``physics.toml`` in a replay.

    Parameters
    ----------
    effect, drivers: which, and what it follows in the file.
    samples: of the craft that were answered, by what was done with the effect in them.
    why: why it was not compensated in some, in words; empty where it was in all.
    instead: what was subtracted in place of its form, which no single moment determines; empty where it was the form.
    """

    effect: str
    drivers: tuple[str, ...]
    samples: Mapping[str, int]
    why: str
    instead: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain data; every fate that occurred with its samples."""
        return {
            "effect": self.effect,
            "drivers": list(self.drivers),
            "samples": dict(self.samples),
            "why": self.why,
            "instead": self.instead,
        }

    def __str__(self) -> str:
        count = sum(self.samples.values())
        driven = "" if self.drivers == ("none",) else f" ({', '.join(self.drivers)})"
        done = self.samples.get(Fate.COMPENSATED, 0)
        says = f"{self.effect}{driven}: compensated in {done} of {count} samples"
        says += f", by {self.instead}" if self.instead and done else ""
        return says + (f"; {self.why}" if self.why else "")


@dataclass(eq=False)
class Tally:
    """Counts of what was done with the effects, sample by sample.

    Parameters
    ----------
    states: samples for which compensation as a whole did not work, by why.
    missing: samples in which one effect was left out alone, by its name.
    causes: the same by name, cause and driver, where a cause is known.
    samples: how many there were.
    """

    states: Counter[Fate] = field(default_factory=Counter)
    missing: Counter[str] = field(default_factory=Counter)
    causes: Counter[tuple[str, Cause, str]] = field(default_factory=Counter)
    samples: int = 0

    def sample(self, craft: CompensatingCraft) -> None:
        """Take the sample that a craft has just corrected, or left as it is."""
        if craft.compensation is None:
            self.samples += 1
        elif craft.stopped or craft.settling is not None:
            self.samples += 1
            self.states[Fate.STOPPED if craft.stopped else Fate.START_UNKNOWN] += 1
        else:
            self.corrected(craft.compensation.missing, craft.compensation.causes)

    def corrected(self, missing: Iterable[str], causes: Mapping[str, tuple[Cause, str]]) -> None:
        """Take a sample that was corrected for all effects but those of some names, each with why where it is known."""
        self.samples += 1
        names = set(missing)
        self.missing.update(names - ({OUTSIDE} if NAME in names else set()))
        self.causes.update((name, *cause) for name, cause in causes.items())

    def is_ever(self, effect: str) -> bool:
        """Whether an effect was subtracted from any sample that was corrected."""
        return self.missing[effect] < self.samples - sum(self.states.values())

    def accounts(self, model: PhysicsModel, channels: Mapping[str, bool], stopped: str) -> tuple[EffectAccount, ...]:
        """One account for each effect of a model that is compensated, and one for its curves without a name.

        Parameters
        ----------
        channels: of the recording by name, each with whether it has a value.
        stopped: why compensation was stopped; empty where it was not.
        """
        drivers: dict[str, list[str]] = {}
        for term in model.terms:
            drivers.setdefault(term.effect, []).append(term.driver)
        for curve in model.empirical:
            drivers.setdefault(NAME, []).append(curve.driver)
        return tuple(self._account(effect, tuple(of), channels, stopped, model) for effect, of in drivers.items())

    def _account(
        self, effect: str, drivers: tuple[str, ...], channels: Mapping[str, bool], stopped: str, model: PhysicsModel
    ) -> EffectAccount:
        beyond = self.missing[OUTSIDE] if effect == NAME else 0
        counts = {Fate.NO_DRIVER: self.missing[effect], Fate.DRIVER_OUTSIDE: beyond}
        counts |= {fate: self.states[fate] for fate in (Fate.START_UNKNOWN, Fate.STOPPED)}
        why = [
            *self._missing_driver(effect, drivers, channels, model),
            (beyond, "a driver was beyond the range of its curve"),
            (counts[Fate.START_UNKNOWN], "before the temperature at the start was known"),
            (counts[Fate.STOPPED], f"after compensation was stopped: {stopped}"),
        ]
        says = [f"not in {count}: {said}" for count, said in why if count]
        done = self.samples - sum(counts.values())
        samples = {str(fate): count for fate, count in {Fate.COMPENSATED: done, **counts}.items() if count}
        forms = [term.variant for term in model.terms if term.effect == effect]
        instead = dict.fromkeys(effect_named(effect).live_as(form) for form in forms)
        return EffectAccount(effect, drivers, samples, "; ".join(says), " and ".join(filter(None, instead)))

    def _missing_driver(
        self, effect: str, drivers: tuple[str, ...], channels: Mapping[str, bool], model: PhysicsModel
    ) -> list[tuple[int, str]]:
        """In how many samples an effect's driver did not do, and why: what holds for all of them, else each cause."""
        count = self.missing[effect]
        forms = {part for term in model.terms if term.effect == effect for part in (term.driver, term.variant)}
        if forms and forms & set(effect_named(effect).not_live):
            return [(count, "this form cannot be followed live")]
        if forms and effect_named(effect).needs_rate and model.spin is None:
            return [(count, "it needs to know how the craft turns: a gyro's channel, or [spin] in the file")]
        lacking = lacking_channels(drivers, channels)
        if lacking:
            return [(count, "; ".join(lacking))]
        found = [(times, in_words(cause, of, channels)) for (one, cause, of), times in self._of(effect)]
        rest = count - sum(times for times, _ in found)
        return [*found, (max(0, rest), _NO_CAUSE)]

    def _of(self, effect: str) -> list[tuple[tuple[str, Cause, str], int]]:
        return [(key, times) for key, times in self.causes.items() if key[0] == effect]


def compensation_lines(accounts: Iterable[EffectAccount], model: PhysicsModel, name: str) -> list[str]:
    """What ``magcal replay`` prints of the file of a name: why not to act on it, an effect a line, and what it only
    states."""
    return [f"{name}: {one}" for one in (*doubts_of(model.doubts), *account_lines(accounts, model))]


def account_lines(accounts: Iterable[EffectAccount], model: PhysicsModel) -> list[str]:
    """What was done with each effect, a line each, and what the file only states."""
    lines = list(map(str, accounts))
    noted = ", ".join(note.effect for note in model.notes)
    return [*lines, f"stated, and no field that is compensated: {noted}"] if noted else lines
