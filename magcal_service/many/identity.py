"""What makes two pieces the same: the function and its argument, the content of its files, and the code."""

from __future__ import annotations

import dataclasses
import hashlib
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, Final

import numpy as np

from magcal_service.version import __version__

_ABSENT: Final = "absent"
_SCRIPT: Final = "__main__"
_SOURCES: Final = (".py", ".toml", ".html")
"""Files of a package that its results depend on."""


def key_of(function: Callable[[Any], Any], argument: object, inputs: tuple[tuple[Path, str], ...]) -> str:
    """The digest under which the result of a piece is kept.

    Raises ``TypeError`` for an argument that has no fingerprint.
    """
    contents = tuple(content for _, content in inputs)
    return fingerprint((code_of(function), function, argument, contents))


def fingerprint(value: object) -> str:
    """A digest of a value that is the same in every process; equal values of one type have the same.

    Parameters
    ----------
    value: of dataclasses, enums, numbers, text, paths, arrays, seeds, functions, and collections of these.

    Raises ``TypeError`` for anything else.
    """
    digest = hashlib.sha256()
    for part in _told(value):
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def _told(value: object) -> Iterator[bytes]:
    """A value as tagged parts, each with its length before it, so that no two values read the same."""
    yield type(value).__qualname__.encode()
    match value:
        case None:
            return
        case Enum():
            yield value.name.encode()
        case bool() | int() | str() | float():
            yield repr(value).encode("utf-8", "surrogatepass")
        case bytes():
            yield value
        case PurePath():
            yield str(value).encode("utf-8", "surrogateescape")
        case np.ndarray() | np.generic():
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise TypeError("an array of objects has no fingerprint")
            yield f"{array.dtype.str} {array.shape}".encode()
            yield array.tobytes()
        case np.random.SeedSequence():
            yield from _told((value.entropy, tuple(value.spawn_key), value.pool_size))
        case partial():
            yield from _told((value.func, value.args, value.keywords))
        case FunctionType() | type():
            yield f"{_home(value)}:{value.__qualname__}".encode()
        case tuple() | list():
            yield str(len(value)).encode()
            for each in value:
                yield from _told(each)
        case set() | frozenset():
            yield from sorted(fingerprint(each).encode() for each in value)
        case Mapping():
            yield from sorted(fingerprint((key, each)).encode() for key, each in value.items())
        case _ if dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                yield field.name.encode()
                yield from _told(getattr(value, field.name))
        case _:
            raise TypeError(f"{type(value).__qualname__} has no fingerprint")


def content_of(path: Path) -> str:
    """The digest of a file's content; a word of its own where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return _ABSENT


def code_of(function: Callable[[Any], Any]) -> str:
    """The digest of the code that a function's result depends on.

    Sources of this package and of the one that the function is from, their version, Python's and numpy's.
    """
    while isinstance(function, partial):
        function = function.func
    return _code(_home(function))


def _home(function: Any) -> str:
    """The module of a function or class, by its own name where it runs as the main one; of a script ``_SCRIPT``."""
    spec = getattr(sys.modules.get(function.__module__), "__spec__", None)
    if spec is not None:
        return str(spec.name)
    return _SCRIPT if function.__module__ in (_SCRIPT, "__mp_main__") else str(function.__module__)


@cache
def _code(module: str) -> str:
    digest = hashlib.sha256(f"{__version__} {platform.python_version()} {np.__version__}".encode())
    if module == _SCRIPT:
        digest.update(Path(sys.modules[_SCRIPT].__file__ or "").read_bytes())
        module = __name__
    for package in sorted({__name__.partition(".")[0], module.partition(".")[0]}):
        spec = find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(folder).rglob("*")):
                if path.suffix in _SOURCES:
                    digest.update(f"{package}/{path.relative_to(folder).as_posix()}\0".encode())
                    digest.update(path.read_bytes())
    return digest.hexdigest()
