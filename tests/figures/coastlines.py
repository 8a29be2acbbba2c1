"""The coastlines of the report's map, made once from Natural Earth.

Natural Earth's land at 1:110 million is in the public domain (naturalearthdata.com, terms of use).  The npm package
``world-atlas`` carries it as TopoJSON:

    npm pack world-atlas@2.0.2 && tar -xzf world-atlas-2.0.2.tgz package/land-110m.json
    python -m tests.figures.coastlines package/land-110m.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

TARGET: Final = Path("magcal_service/diagnosis/report/coastlines.json")

SOURCE: Final = (
    "Natural Earth 1:110m land (public domain), from world-atlas 2.0.2 by tests/figures/coastlines.py; "
    "each line is longitude, latitude, longitude, latitude, ... in tenths of a degree"
)

_TOLERANCE_DEG: Final = 0.4
"""How far a line may lie from the coast; choice: a pixel of a map that is 460 pixels wide is 0.8 deg."""

_SMALLEST_DEG: Final = 1.0
"""Islands smaller than this are left out: they are a dot on the map."""

Points = NDArray[np.float64]


def arcs(topology: dict[str, Any]) -> list[Points]:
    """Lines (n, 2) of longitude and latitude [deg] of a TopoJSON file, whose arcs are sums of quantised steps."""
    scale, shift = (np.array(topology["transform"][key]) for key in ("scale", "translate"))
    return [np.cumsum(np.array(arc), axis=0) * scale + shift for arc in topology["arcs"]]


def simplified(points: Points, tolerance: float) -> Points:
    """A line with the points that it needs to stay within a tolerance (Douglas & Peucker 1973)."""
    first, last = points[0], points[-1]
    along = last - first
    length = float(np.hypot(*along))
    offset = points - first
    if length > 0.0:
        distance = np.abs(offset[:, 0] * along[1] - offset[:, 1] * along[0]) / length
    else:
        distance = np.hypot(offset[:, 0], offset[:, 1])
    worst = int(np.argmax(distance))
    if distance[worst] <= tolerance:
        return np.stack([first, last])
    return np.concatenate([simplified(points[: worst + 1], tolerance)[:-1], simplified(points[worst:], tolerance)])


def without_frame(points: Points) -> list[Points]:
    """The parts of a line that are coast: land ends at the map's edge, at 180 deg and at the pole, without one."""
    inside = (np.abs(points[:, 0]) < 179.9) & (points[:, 1] > -89.9)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return [points[begin:end] for begin, end in edges.reshape(-1, 2) if end - begin > 1]


def coastlines(topology: dict[str, Any]) -> list[list[int]]:
    """Flat lines of tenths of a degree."""
    parts = [part for arc in arcs(topology) for part in without_frame(arc)]
    large = [part for part in parts if np.ptp(part, axis=0).max() >= _SMALLEST_DEG]
    return [np.rint(10.0 * simplified(part, _TOLERANCE_DEG)).astype(int).ravel().tolist() for part in large]


def main() -> None:
    """Write the package's file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("topology", type=Path, help="land-110m.json of world-atlas")
    lines = coastlines(json.loads(parser.parse_args().topology.read_text(encoding="utf-8")))
    rows = ",\n".join(json.dumps(line, separators=(",", ":")) for line in lines)
    TARGET.write_text(f'{{"source": {json.dumps(SOURCE)}, "lines": [\n{rows}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
