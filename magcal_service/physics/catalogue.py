"""The catalogue of what disturbs a magnetometer in orbit: one effect a file of ``effects/``, found by its presence.

A file there that defines ``EFFECT`` (an ``interface.Effect``) is in the catalogue; nothing has to be registered.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from magcal_service.physics import effects
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
    return {effect.name: effect for effect in catalogue()}[name]
