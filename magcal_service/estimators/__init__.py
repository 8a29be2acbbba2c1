"""The estimators, one method a file, found by its presence.

A file of this package that defines ``METHOD`` (an ``interface.Method``) is a method; nothing has to be registered.
One that is no ``interface.Estimator``, or is named otherwise than its file, is refused before it is run.
Method ``two-step`` is in ``two_step.py``: one that is asked for by name is imported without the others.
Imports ticks, config and the ground; no clock, no I/O.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from magcal_service.base.errors import ConfigError, Fault, MagcalError
from magcal_service.base.typed_toml import nearest
from magcal_service.estimators.interface import Method


@cache
def methods() -> tuple[Method, ...]:
    """Every method there is, by name; MagcalError where a file's ``METHOD`` cannot be run."""
    found = [_method_in(entry.name) for entry in pkgutil.iter_modules(__path__)]
    return tuple(sorted((method for method in found if method is not None), key=lambda method: method.name))


def _method_in(file: str) -> Method | None:
    method = getattr(importlib.import_module(f"{__name__}.{file}"), "METHOD", None)
    if not isinstance(method, Method):
        return None
    if method.name.replace("-", "_") != file:
        raise MagcalError(f"method {method.name}: its file is named {file}.py, not as the method, with _ for -")
    if method.missing():
        missing = ", ".join(method.missing())
        raise MagcalError(f"method {method.name}: {missing} is missing (estimators/interface.py)")
    return method


def find_method(name: str) -> Method:
    """The method of that name; ConfigError with the nearest where there is none, MagcalError if it can't be run."""
    file = name.replace("-", "_")
    if file in {entry.name for entry in pkgutil.iter_modules(__path__)}:
        method = _method_in(file)
        if method is not None and method.name == name:
            return method
    raise ConfigError([Fault("method", name, nearest(name, (method.name for method in methods())))])
