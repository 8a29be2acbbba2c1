"""What no log tells is said with how it is stated, and taken up where it is answered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.recordings.describe.describe import describe
from magcal_service.recordings.reader import read_recording

ANSWERS = {
    "samples.craft": "demo",
    "platform.kind": "air",
    "magnetometer.noise_nt": "120",
    "magnetometer.range_nt": "160000",
}


def log(folder: Path, sensors: int = 1) -> Path:
    """A log in a field of 48 uT, of as many magnetometers."""
    draw = np.random.default_rng(5201)
    turned = draw.normal(size=(300, 3 * sensors))
    names = [f"mag{sensor}_{axis}_nT" for sensor in range(sensors) for axis in "xyz"]
    rows = []
    for number, row in enumerate(turned):
        cells = [48000.0 * part / np.linalg.norm(part) for part in np.split(row, sensors)]
        rows.append(",".join(f"{value:.1f}" for value in (float(number), *np.concatenate(cells))))
    path = folder / "log.csv"
    path.write_text("\n".join([",".join(["t_s", *names]), *rows, ""]))
    return path


def test_what_no_log_tells_is_said_with_how_to_state_it(tmp_path: Path) -> None:
    """And no longer, once it is answered."""
    said = describe(log(tmp_path), {"reference": "48 uT"}).said
    (line,) = (one for one in said if one.startswith("no log tells"))
    for key in ANSWERS:
        assert f"(--answer {key}=" in line
    told = describe(log(tmp_path), {"reference": "48 uT", **ANSWERS}).said
    assert not [one for one in told if one.startswith("no log tells")]


@pytest.mark.parametrize("sensors", [1, 2])
def test_what_is_answered_stands_in_the_descriptor(sensors: int, tmp_path: Path) -> None:
    """Of several magnetometers noise and range are those of each."""
    described = describe(log(tmp_path, sensors), {"reference": "48 uT", **ANSWERS})
    assert described.text is not None
    path = tmp_path / "RECORDING.toml"
    path.write_text(described.text)
    found = read_recording(path).descriptor
    assert (found.craft, found.platform.kind) == ("demo", "air")  # type: ignore[union-attr]
    each = (found.magnetometer, *found.beside)
    assert [(one.noise_nt, one.range_nt) for one in each] == [(120.0, 160000.0)] * sensors


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("magnetometer.noise_nt", "much", "a number of nT is accepted"),
        ("magnetometer.range_nt", "5", "range_nt"),
        ("samples.craft", "a b", "the name of a craft"),
        ("platform.kind", "sea", "kind"),
    ],
)
def test_what_cannot_be_is_refused(key: str, value: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefusedError, match=why):
        describe(log(tmp_path), {"reference": "48 uT", key: value})
