"""Colours of pages and figures, by name, as the pages' style has them: blue and orange, which every eye tells apart."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from magcal_service.views import PAGE

_LIGHT, _DARK = (
    MappingProxyType(dict(re.findall(r"--([a-z]+):(#[0-9a-f]+)", block)))
    for block in re.findall(r":root\{([^}]*)\}", (PAGE / "base.css").read_text(encoding="utf-8"))
)
LIGHT: Final[Mapping[str, str]] = _LIGHT
DARK: Final[Mapping[str, str]] = _DARK
"""The same names on a dark ground."""
