"""The catalogue of what disturbs a magnetometer in orbit: one effect a file of ``effects/``, found by its presence.

A file there that defines ``EFFECT`` (an ``interface.Effect``) is in the catalogue; nothing has to be registered.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from functools import cache

from magcal_service.physics import effects
from magcal_service.physics.acting import Watched
from magcal_service.physics.held import Form, HeldAt
from magcal_service.physics.interface import Effect


@cache
def catalogue() -> tuple[Effect, ...]:
    """Every effect there is, by name."""
    modules = (
        importlib.import_module(f"{effects.__name__}.{entry.name}") for entry in pkgutil.iter_modules(effects.__path__)
    )
    found = [module.EFFECT for module in modules if isinstance(getattr(module, "EFFECT", None), Effect)]
    return tuple(sorted(found, key=lambda effect: effect.name))


def effect_named(name: str) -> Effect:
    """The effect of that name; KeyError where there is none."""
    return _by_name()[name]


@cache
def _by_name() -> dict[str, Effect]:
    return {effect.name: effect for effect in catalogue()}


def held_at(forms: Iterable[Form]) -> tuple[HeldAt, ...]:
    """Where nine errors hold beside some forms, as each one's effect says, once for each driver and value.

    Of a curve without a name, which is in no catalogue, nothing is said.
    """
    known = _by_name()
    found = (known[form.effect].held_at(form) for form in forms if form.effect in known)
    return tuple(dict.fromkeys(one for one in found if one is not None))


@cache
def watched_as(kind: Watched, quantity: str = "") -> tuple[str, ...]:
    """Names of the effects that the watch sees in this way, of a quantity where they follow one."""
    return tuple(effect.name for effect in catalogue() if (kind, quantity) in effect.watched)
