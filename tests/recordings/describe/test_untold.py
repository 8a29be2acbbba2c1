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
        ("magnetometer.noise_nt", "nan", "a number of nT is accepted, from 0.001 to 1e"),
        ("magnetometer.range_nt", "5", "magnetometer.range_nt: '5' is refused; a number of nT is accepted, from "),
        ("samples.craft", "a b", "the name of a craft"),
        ("platform.kind", "space", "'space' is refused; did you mean 'orbit'. known: air, bench, ground, orbit"),
        ("platform.kind", "Drone", "'Drone' is refused; did you mean 'air'"),
        ("platform.kind", "grnd", "'grnd' is refused; did you mean 'ground'"),
        ("platform.kind", "xyz", "'xyz' is refused; known: air, bench, ground, orbit"),
    ],
)
def test_what_cannot_be_is_refused(key: str, value: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefusedError, match=why):
        describe(log(tmp_path), {"reference": "48 uT", key: value})


@pytest.mark.parametrize(("key", "value"), [("platform.kind", "space"), ("magnetometer.noise_nt", "-3")])
def test_it_is_refused_before_the_rest_is_answered(key: str, value: str, tmp_path: Path) -> None:
    """Here the reference is still open: it was taken up, and refused only once that was answered."""
    assert describe(log(tmp_path), {}).needed
    with pytest.raises(InputRefusedError, match=f"--answer {key}"):
        describe(log(tmp_path), {key: value})


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (
            {"channels.temprature.unit": "degC"},
            "'temprature' is refused; did you mean 'temperature'. known: ",
        ),
        (
            {"channels.wheel.unit": "rpm"},
            "'wheel' is refused; known: .*temperature.*name its columns",
        ),
        ({"channels.temperature.unt": "degC"}, "channels.NAME.KEY is accepted; of KEY, did you mean 'unit'"),
        ({"channels.attitude.order": "wxyz"}, "no four columns are called a quaternion and have length 1; name them"),
        ({"samples.delimiter": "semi"}, "did you mean 'semicolon'. known: comma, pipe, semicolon, tab, whitespace"),
    ],
)
def test_an_answer_about_what_is_not_there_names_what_is(answer: dict[str, str], why: str, tmp_path: Path) -> None:
    path = log(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([f"{lines[0]},temperature", *(f"{line},21.5" for line in lines[1:]), ""]))
    with pytest.raises(InputRefusedError, match=why):
        describe(path, {"reference": "48 uT", **answer})
