"""A table: name, value, 1 sigma, unit."""

from __future__ import annotations

from magcal_service.offline.exports.form import Exported, Form, Wanted, about, numbers
from magcal_service.offline.given import Given


def _make(given: Given, _wanted: Wanted) -> Exported:
    lines = [f"# {line}" for line in about(given)]
    lines += ["name,value,sigma,unit", *(f"{name},{x!r},{s!r},{unit}" for name, x, s, unit in numbers(given))]
    return Exported("\n".join(lines) + "\n")


PLAIN_CSV = Form("csv", "name, value, 1 sigma and unit of each of the nine", _make)
