"""Where the space station was in 2022: what its magnetometer says against element sets that the diagnosis has not seen.

python -m tests.benchmarks.bench_station [--data ../shared/data]

The positions of the recording were logged on board.  The diagnosis says how far the field is from that of these places;
the element sets (``iss-tle.txt``) say where the station was.  Then the field at the element sets' places is the
reference, nine errors are fitted, and nothing else.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from sgp4.api import Satrec

from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.diagnosis.prepare import baseline_start
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.result import entries, held_out_rms
from magcal_service.diagnosis.solution import solve
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.scene_of import cleaned, scene_of

DATA = Path(__file__).parents[2] / ".." / "shared" / "data"
UNIX_EPOCH_JD = 2440587.5
LAGS_S = np.arange(-900.0, 901.0, 2.0)


class Elements:
    """Element sets of one craft; the nearest in time counts."""

    def __init__(self, path: Path) -> None:
        lines = [line.rstrip() for line in path.read_text().splitlines() if line.strip()]
        self.sets = [Satrec.twoline2rv(one, two) for one, two in zip(lines[::2], lines[1::2], strict=True)]
        self.epochs = np.array([each.jdsatepoch + each.jdsatepochF for each in self.sets])

    def ecef_km(self, unix_s: Array) -> Array:
        """Places (n, 3) at times (n,) of UTC."""
        days = unix_s / 86400.0 + UNIX_EPOCH_JD
        nearest = self.sets[int(np.argmin(np.abs(self.epochs - days.mean())))]
        whole = np.floor(days)
        _, places, _ = nearest.sgp4_array(whole, days - whole)
        return geomagnetic.ecef_from_eci(np.rint(unix_s * 1e9).astype(np.int64), places)


def lag_s(elements: Elements, unix_s: float, logged_ecef_km: Array) -> float:
    """By how much a logged place is behind: the station was next to it so many seconds before."""
    places = elements.ecef_km(unix_s - LAGS_S)
    places /= np.linalg.norm(places, axis=1)[:, None]
    return float(LAGS_S[int(np.argmax(places @ logged_ecef_km))])


def main() -> None:
    """Print what was found, what the element sets say, and what their places leave."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    recording = read_recording(options.data / "iss-2022-ir" / "recording.toml")
    diagnosis = diagnose(recording)
    print(f"verdict {diagnosis.verdict}, reasons {diagnosis.reasons}, held-out rms [nT] {held_out_rms(diagnosis)}")
    for entry in entries(diagnosis):
        numbers = {
            name: f"{value.value:.4g} +- {value.sigma:.2g}"
            for name, value in entry.parameters.items()
            if value.value.ndim == 0
        }
        print(f"  {entry.effect} {entry.variant}: {numbers}")
    scene = diagnosis.prepared.problem.scene
    assert scene.position_ecef_km is not None
    elements, unix_s = Elements(options.data / "iss-tle.txt"), scene.time_ns * 1e-9
    for row in np.linspace(0, len(scene) - 1, 5).astype(int).tolist():
        lag = lag_s(elements, float(unix_s[row]), scene.position_ecef_km[row])
        print(f"  element sets, {scene.time_s[row] / 3600.0:.1f} h: the logged place is {lag:.0f} s behind")
    true = scene_of(diagnosis.prepared.recording)
    magnitude = np.linalg.norm(geomagnetic.igrf_ecef_nt(true.time_ns, elements.ecef_km(unix_s)), axis=1)
    true = replace(true, magnitude_nt=magnitude, reference_eci_nt=None)
    x = baseline_start(true, None)
    fit = solve(Problem(cleaned(true, x), diagnosis.prepared.problem.noise_nt), x)
    print(f"nine errors against the field at the element sets' places: held-out rms {fit.held_out_rms_nt:.0f} nT")


if __name__ == "__main__":
    main()
