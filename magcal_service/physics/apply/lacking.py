"""Why an effect of ``physics.toml`` was not compensated at a moment, in words that say what to look at."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from enum import StrEnum
from typing import Final

from magcal_service.base.typed_toml import nearest
from magcal_service.physics.apply.empirical import NAME
from magcal_service.physics.apply.forward import MisfitError
from magcal_service.physics.apply.live_drivers import Held
from magcal_service.physics.apply.physics_model import PhysicsModel

_CHANNEL: Final = "channel:"


class Cause(StrEnum):
    """What kept an effect from being compensated."""

    NO_VALUE = "no_value"
    STALE = "stale"
    OTHER_KIND = "other_kind"
    NOT_KNOWN = "not_known"
    MISFIT = "misfit"


def channels_of(driver: str, known: Collection[str] = ()) -> tuple[str, ...]:
    """Names of the channels that a driver names: one, or several together; none where it is no channel.

    ``known``: names that are there, which may have a plus in them.
    """
    if not driver.startswith(_CHANNEL):
        return ()
    name = driver.removeprefix(_CHANNEL)
    return (name,) if name in known else tuple(filter(None, name.split("+")))


def cause_of(error: Exception, driver: str, channels: Mapping[str, Held], now_ns: int) -> Cause:
    """Why an effect by a driver was left out at a moment, of the newest values of the channels then."""
    if isinstance(error, MisfitError):
        return Cause.MISFIT
    names = channels_of(driver, channels)
    if not names:
        return Cause.NOT_KNOWN
    held = [channels.get(name) for name in names]
    if None in held:
        return Cause.NO_VALUE
    return Cause.STALE if any(one is not None and one.is_stale(now_ns) for one in held) else Cause.OTHER_KIND


def in_words(cause: Cause, driver: str, known: Collection[str]) -> str:
    """A cause as a clause.

    Parameters
    ----------
    driver: of the effect.
    known: names of the channels of which something has come.
    """
    names = channels_of(driver, known)
    of = f"channel {' or '.join(names)}"
    match cause:
        case Cause.NO_VALUE:
            absent = [name for name in names if name not in known]
            return no_channel(absent, known, "nothing has come of") if absent else f"{of} had no value yet"
        case Cause.STALE:
            return f"the newest value of {of} was older than it may be"
        case Cause.OTHER_KIND:
            return f"{of} is of another kind than the file says, or has fewer columns"
        case Cause.NOT_KNOWN:
            return "what it follows was not known: it takes positions, times in UTC, or how the craft points"
        case Cause.MISFIT:
            return "its numbers do not fit the samples: what they make is beyond any field or time that can be"


def no_channel(absent: Collection[str], known: Collection[str], says: str) -> str:
    """That there are no channels of some names, and which were probably meant."""
    meant = {name: f" ({nearest(name, known)})" if known else "" for name in absent}
    return ", ".join(f"{says} channel {name}{hint}" for name, hint in meant.items())


def lacking_channels(drivers: Iterable[str], channels: Mapping[str, bool]) -> list[str]:
    """What keeps a recording's channels from driving anything of some drivers, a clause each.

    That it has no channel of a name, with the name that was probably meant, or that its channel has no value at all.

    ``channels``: by name, each with whether it has a value.
    """
    names = list(dict.fromkeys(name for driver in drivers for name in channels_of(driver, channels)))
    absent = [name for name in names if name not in channels]
    said = [no_channel(absent, channels, "the recording has no")] if absent else []
    return [
        *said,
        *(f"channel {name} of the recording has no value in any row" for name in names if not channels.get(name, True)),
    ]


def undriven_lines(name: str, model: PhysicsModel, channels: Mapping[str, bool]) -> list[str]:
    """Which effects and curves of the file of a name cannot be compensated by a recording's channels, a line each.

    Told before any work is done: mostly a channel's name is misspelt, or its cells are empty.

    ``channels``: as of ``lacking_channels``.
    """
    of = [(f"effect[{at}]", term.effect, term.driver) for at, term in enumerate(model.terms)]
    of += [(f"empirical[{at}]", NAME, curve.driver) for at, curve in enumerate(model.empirical)]
    lacking = [(where, effect, driver, lacking_channels([driver], channels)) for where, effect, driver in of]
    return [
        f"{name}: {where}.driver: {driver!r}: {'; '.join(said)}; {effect} is not compensated: describe that channel, "
        "correct its name here, or take the effect out"
        for where, effect, driver, said in lacking
        if said
    ]
