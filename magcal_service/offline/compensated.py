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
from magcal_service.physics.apply.physics_model import PhysicsModel
from magcal_service.physics.catalogue import effect_named

_CHANNEL: Final = "channel:"


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
    samples: how many there were.
    """

    states: Counter[Fate] = field(default_factory=Counter)
    missing: Counter[str] = field(default_factory=Counter)
    samples: int = 0

    def sample(self, craft: CompensatingCraft) -> None:
        """Take the sample that a craft has just corrected, or left as it is."""
        if craft.compensation is None:
            self.samples += 1
        elif craft.stopped or craft.settling is not None:
            self.samples += 1
            self.states[Fate.STOPPED if craft.stopped else Fate.START_UNKNOWN] += 1
        else:
            self.corrected(craft.compensation.missing)

    def corrected(self, missing: Iterable[str]) -> None:
        """Take a sample that was corrected for all effects but those of some names."""
        self.samples += 1
        names = set(missing)
        self.missing.update(names - ({OUTSIDE} if NAME in names else set()))

    def is_ever(self, effect: str) -> bool:
        """Whether an effect was subtracted from any sample that was corrected."""
        return self.missing[effect] < self.samples - sum(self.states.values())

    def accounts(self, model: PhysicsModel, channels: Iterable[str], stopped: str) -> tuple[EffectAccount, ...]:
        """One account for each effect of a model that is compensated, and one for its curves without a name.

        Parameters
        ----------
        channels: that the recording has.
        stopped: why compensation was stopped; empty where it was not.
        """
        known = set(channels)
        drivers: dict[str, list[str]] = {}
        for term in model.terms:
            drivers.setdefault(term.effect, []).append(term.driver)
        for curve in model.empirical:
            drivers.setdefault(NAME, []).append(curve.driver)
        return tuple(self._account(effect, tuple(of), known, stopped, model) for effect, of in drivers.items())

    def _account(
        self, effect: str, drivers: tuple[str, ...], channels: set[str], stopped: str, model: PhysicsModel
    ) -> EffectAccount:
        beyond = self.missing[OUTSIDE] if effect == NAME else 0
        counts = {Fate.NO_DRIVER: self.missing[effect], Fate.DRIVER_OUTSIDE: beyond}
        counts |= {fate: self.states[fate] for fate in (Fate.START_UNKNOWN, Fate.STOPPED)}
        why = {
            Fate.NO_DRIVER: self._missing_driver(effect, drivers, channels, model),
            Fate.DRIVER_OUTSIDE: "a driver was beyond the range of its curve",
            Fate.START_UNKNOWN: "before the temperature at the start was known",
            Fate.STOPPED: f"after compensation was stopped: {stopped}",
        }
        says = [f"not in {count}: {why[fate]}" for fate, count in counts.items() if count]
        done = self.samples - sum(counts.values())
        samples = {str(fate): count for fate, count in {Fate.COMPENSATED: done, **counts}.items() if count}
        forms = [term.variant for term in model.terms if term.effect == effect]
        instead = dict.fromkeys(effect_named(effect).live_as(form) for form in forms)
        return EffectAccount(effect, drivers, samples, "; ".join(says), " and ".join(filter(None, instead)))

    @staticmethod
    def _missing_driver(effect: str, drivers: tuple[str, ...], channels: set[str], model: PhysicsModel) -> str:
        """The likeliest reason for which an effect's driver does not do."""
        forms = {part for term in model.terms if term.effect == effect for part in (term.driver, term.variant)}
        if forms and forms & set(effect_named(effect).not_live):
            return "this form cannot be followed live"
        if forms and effect_named(effect).needs_rate and model.spin is None:
            return "it needs to know how the craft turns: a gyro's channel, or [spin] in the file"
        absent = [one.removeprefix(_CHANNEL) for one in drivers if one.startswith(_CHANNEL)]
        absent = [name for name in absent if name not in channels]
        if absent:
            return f"the recording has no channel {', '.join(absent)}"
        return "its driver was missing or older than it may be, or its numbers do not fit the samples"


def compensation_lines(accounts: Iterable[EffectAccount], model: PhysicsModel) -> list[str]:
    """What ``magcal replay`` prints: why not to act on the file, an effect a line, and what it only states."""
    return [f"physics.toml: {one}" for one in (*doubts_of(model.doubts), *account_lines(accounts, model))]


def account_lines(accounts: Iterable[EffectAccount], model: PhysicsModel) -> list[str]:
    """What was done with each effect, a line each, and what the file only states."""
    lines = list(map(str, accounts))
    noted = ", ".join(note.effect for note in model.notes)
    return [*lines, f"stated, and no field that is compensated: {noted}"] if noted else lines
