"""What every page of a diagnosis has: a frame with the style, where it comes from, how it is made of a template."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.base.errors import ExtraMissingError
from magcal_service.base.version import __version__
from magcal_service.views import PAGE


@dataclass(frozen=True, slots=True)
class Origin:
    """What a report says of how it came about.

    Parameters
    ----------
    recording: what was diagnosed, as it was given.
    command: the command line.
    files: (name, SHA-256) of every file that was read.
    simulation: name of the scenario compared with; empty for the forward model as calibrated.
    onward: what to do with the result, a command or a line of a configuration each; none where it is not to be trusted.
    """

    recording: str
    command: str
    files: tuple[tuple[str, str], ...]
    simulation: str = ""
    onward: tuple[str, ...] = ()


def check_packages() -> None:
    """Raise ``ExtraMissingError`` where a report could not be made, before the work rather than after it."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "jinja2", "diagnosis", "the report of a diagnosis") from None


def rendered(template: Path, origin: Origin, words: Iterable[Callable[..., str]] = (), **shown: Any) -> str:
    """A page as HTML.

    Parameters
    ----------
    template: extends ``frame.html``.
    origin: where it comes from.
    words: filters of the template, by their names.
    shown: what it shows.

    Raises ``ExtraMissingError`` without jinja2 or matplotlib.
    """
    check_packages()
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader([template.parent, Path(__file__).parent, PAGE])  # its style is the live page's
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters |= {word.__name__: word for word in words}
    own = {"version": __version__, "python": platform.python_version(), "numpy": np.__version__}
    return environment.get_template(template.name).render(origin=origin, **own, **shown)
