"""What every JSON result begins with: the schema it keeps, the equation of its nine errors, their units."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any, Final

EQUATION: Final = "w = (I + D) B - b"
"""Equation (5) of the method: measured B to calibrated w, both in the sensor's own axes."""

CALIBRATION: Final = "magcal-calibration-1"
DIAGNOSIS: Final = "magcal-diagnosis-1"
JOINT: Final = "magcal-joint-diagnosis-1"
SCHEMAS: Final = (CALIBRATION, DIAGNOSIS, JOINT)


def head(schema: str) -> dict[str, Any]:
    """The first keys of a result that keeps ``schema``, one of ``SCHEMAS``."""
    units = {"B": "nT", "w": "nT", "b": "nT", "D": "1"}
    return {"schema": schema, "equation": EQUATION, "units": units, "frame": "sensor axes"}


def schema_text(name: str) -> str:
    """The JSON Schema (draft 2020-12) of a result, as it is shipped."""
    return (resources.files("magcal_service.offline") / "schemas" / f"{name}.json").read_text(encoding="utf-8")


def schema_of(content: dict[str, Any]) -> str:
    """The name of the schema that a result says it keeps; empty where it says none that is known."""
    name = content.get("schema")
    return name if name in SCHEMAS else ""


def schema(name: str) -> dict[str, Any]:
    """``schema_text`` as data."""
    found: dict[str, Any] = json.loads(schema_text(name))
    return found
