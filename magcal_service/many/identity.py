"""What makes two pieces the same: the function and its argument, the content of its files, and the code."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Callable
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.base.version import __version__
from magcal_service.many.plain import home_of, pack

_ABSENT: Final = "absent"
_SCRIPT: Final = "__main__"
_SOURCES: Final = (".py", ".toml", ".html")
"""Files of a package that its results depend on."""


def key_of(function: Callable[[Any], Any], argument: object, inputs: tuple[tuple[Path, str], ...]) -> str:
    """The digest under which the result of a piece is kept.

    Raises ``TypeError`` for an argument that is not plain data.
    """
    contents = tuple(content for _, content in inputs)
    return hashlib.sha256(pack((code_of(function), function, argument, contents))).hexdigest()


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
    return _code(home_of(function))


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
