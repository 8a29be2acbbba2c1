from pathlib import Path

import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.channels import Axes, QuaternionOrder
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.specs import (
    CartesianPosition,
    ConstantReference,
    Descriptor,
    GeodeticPosition,
    MagnitudeReference,
    ModelReference,
    VectorReference,
)
from magcal_service.wire.messages import Clock, Frame
from tests.recordings.recording_logs import MAGNETOMETER, REFERENCE, TIME, descriptor

GEODETIC = '[position]\ncolumns = ["lat", "lon"]\naltitude_km = 450.0\n'
IGRF = '[reference]\nmodel = "igrf"\n'
ELAPSED = '[time]\ncolumn = "time"\nformat = "elapsed_s"\n'


def load(folder: Path, text: str) -> Descriptor:
    path = folder / "log.toml"
    path.write_text(text)
    return load_descriptor(path)


def faults(folder: Path, text: str) -> list[str]:
    with pytest.raises(RecordingError) as refused:
        load(folder, text)
    return str(refused.value).split("\n")


@pytest.mark.parametrize(
    ("reference", "kind"),
    [
        (REFERENCE, VectorReference),
        (REFERENCE.replace("eci", "ned"), VectorReference),
        (REFERENCE.replace("eci", "ecef"), VectorReference),
        ('[reference]\nmagnitude = "f"\nunit = "nT"\n', MagnitudeReference),
        ('[reference]\nconstant = 43.2\nunit = "uT"\n', ConstantReference),
        (IGRF, ModelReference),
    ],
)
def test_each_form_of_the_reference_is_accepted(tmp_path: Path, reference: str, kind: type) -> None:
    assert isinstance(load(tmp_path, descriptor(GEODETIC, reference=reference)).reference, kind)


def test_a_constant_is_converted_to_nanotesla(tmp_path: Path) -> None:
    loaded = load(tmp_path, descriptor(reference='[reference]\nconstant = 43.2\nunit = "uT"\n'))
    assert loaded.reference == ConstantReference(pytest.approx(43200.0))


@pytest.mark.parametrize(
    ("position", "kind"),
    [
        (GEODETIC, GeodeticPosition),
        ('[position]\ncolumns = ["lat", "lon"]\naltitude = {column = "alt", unit = "m"}\n', GeodeticPosition),
        ('[position]\ncolumns = ["lat", "lon"]\nradius = {column = "r", unit = "m"}\n', GeodeticPosition),
        ('[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "eci"\n', CartesianPosition),
        ('[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "ecef"\n', CartesianPosition),
    ],
)
def test_each_form_of_the_position_is_accepted(tmp_path: Path, position: str, kind: type) -> None:
    assert isinstance(load(tmp_path, descriptor(position)).position, kind)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ('"x"', (1.0, 0.0, 0.0)),
        ('"y"', (0.0, 1.0, 0.0)),
        ('"z"', (0.0, 0.0, 1.0)),
        ("[0, -3, 4]", (0.0, -0.6, 0.8)),
    ],
)
def test_a_spin_axis_is_a_unit_vector(tmp_path: Path, axis: str, expected: tuple[float, ...]) -> None:
    spin = load(tmp_path, descriptor(f"[spin]\naxis = {axis}\nrate_rpm = -7.5\n")).spin
    assert spin is not None
    assert spin.axis == pytest.approx(expected)


def test_a_spin_rate_is_given_in_radians_per_second(tmp_path: Path) -> None:
    spin = load(tmp_path, descriptor('[spin]\naxis = "z"\nrate_rpm = -7.5\n')).spin
    assert spin is not None
    assert spin.rate_rad_s == pytest.approx(-0.7853981634)


@pytest.mark.parametrize(
    "start", ['"2025-06-01T00:00:00Z"', "2025-06-01T00:00:00Z", "2025-06-01T02:00:00+02:00", '"2025-06-01 00:00:00"']
)
def test_elapsed_time_with_a_start_is_utc(tmp_path: Path, start: str) -> None:
    time = load(tmp_path, descriptor(time=f"{ELAPSED}start = {start}\n")).time
    assert (time.clock, time.start_ns) == (Clock.UTC, 1_748_736_000_000_000_000)


def test_elapsed_time_without_a_start_stays_elapsed(tmp_path: Path) -> None:
    assert load(tmp_path, descriptor(time=ELAPSED)).time.clock is Clock.ELAPSED


def test_an_attitude_keeps_its_order_and_axes(tmp_path: Path) -> None:
    line = 'attitude = { columns = ["q0", "q1", "q2", "q3"], order = "wxyz", from = "body", to = "enu" }'
    (channel,) = load(tmp_path, descriptor(f"[channels]\n{line}\n")).channels
    wanted = (QuaternionOrder.WXYZ, Axes.BODY, Axes.ENU, "attitude")
    assert (channel.order, channel.from_axes, channel.to_axes, channel.quantity) == wanted


def test_a_channel_of_any_name_travels_under_the_wires_alphabet(tmp_path: Path) -> None:
    (channel,) = load(tmp_path, descriptor('[channels]\n"array 1.b" = { column = "temp", unit = "mA" }\n')).channels
    assert (channel.name, channel.wire_name, channel.quantity) == ("array 1.b", "array_1_b", "current")


def test_a_vector_reference_keeps_its_frame(tmp_path: Path) -> None:
    reference = load(tmp_path, descriptor()).reference
    assert isinstance(reference, VectorReference)
    assert reference.frame is Frame.ECI


def channel(inner: str) -> str:
    return f"[channels]\nthing = {{ {inner} }}\n"


MCAP = 'version = 1\n[samples]\nfile = "log.mcap"\n'
REFUSED = {
    "unknown section": (descriptor("[magnetometers]\n"), "magnetometers", "did you mean 'magnetometer'"),
    "unknown key": (descriptor(time=TIME + 'colum = "t"\n'), "time.colum", "did you mean 'column'"),
    "no version": (descriptor().replace("version = 1", ""), "version", "version = 1"),
    "other version": (descriptor().replace("version = 1", "version = 2"), "version", "from 1 to 1"),
    "version a text": (descriptor().replace("version = 1", 'version = "1"'), "version", "whole number"),
    "no time": (descriptor(time=""), "time", "a table [time]"),
    "no magnetometer": (descriptor(magnetometer=""), "magnetometer", "a table [magnetometer]"),
    "mcap with sections": (MCAP + '[time]\ncolumn = "t"\n', "time", "brings its own"),
    "mcap with a reference": (MCAP + "[reference]\n", "reference", "brings its own"),
    "mcap with a position": (MCAP + "[position]\n", "position", "brings its own"),
    "mcap with channels": (MCAP + "[channels]\n", "channels", "brings its own"),
    "mcap of a craft without a name": (MCAP + 'craft = "a b"\n', "samples.craft", "name of a craft"),
    "rows of a craft without a name": (
        descriptor().replace("[time]", 'craft = "a b"\n[time]', 1),
        "samples.craft",
        "1 to 32 of A-Z",
    ),
    "an axis twice": (
        descriptor(magnetometer='[magnetometer]\ncolumns = ["a", "b", "a"]\nunit = "nT"\n'),
        "magnetometer.columns",
        "three different columns",
    ),
    "a sensor that is its own reference": (
        descriptor(
            magnetometer='[magnetometer]\ncolumns = ["a", "b", "c"]\nunit = "nT"\n',
            reference='[reference]\ncolumns = ["c", "e", "f"]\nunit = "nT"\nframe = "eci"\n',
        ),
        "reference.columns",
        "none of the magnetometer's own",
    ),
    "an axis that is its own reference": (
        descriptor(
            magnetometer='[magnetometer]\ncolumns = ["a", "b", "c"]\nunit = "nT"\n',
            reference='[reference]\nmagnitude = "b"\nunit = "nT"\n',
        ),
        "reference.magnitude",
        "none of the magnetometer's own",
    ),
    "mcap with a delimiter": (MCAP + 'delimiter = ","\n', "samples.delimiter", "unknown key"),
    "mcap with a unit": (MCAP + '[magnetometer]\nunit = "nT"\n', "magnetometer.unit", "known: noise_nt"),
    "other file": (descriptor(file="log.xls"), "samples.file", ".csv, .txt and the like"),
    "delimiter": (descriptor().replace("[time]", 'delimiter = "/"\n[time]'), "samples.delimiter", "accepted"),
    "time format": (descriptor(time=TIME.replace("unix_s", "unix")), "time.format", "did you mean 'unix_s'"),
    "start without elapsed": (descriptor(time=TIME + 'start = "2025-06-01T00:00:00Z"\n'), "time.start", "elapsed_s"),
    "start beside another format": (
        descriptor(time=ELAPSED.replace("elapsed_s", "iso8601") + 'start = "2025-06-01T00:00:00Z"\n'),
        "time.start",
        "elapsed_s",
    ),
    "start no instant": (descriptor(time=ELAPSED + 'start = "June"\n'), "time.start", "ISO 8601"),
    "start a number": (descriptor(time=ELAPSED + "start = 3\n"), "time.start", "ISO 8601"),
    "two columns": (descriptor(magnetometer=MAGNETOMETER.replace(', "mz"', "")), "magnetometer.columns", "3 strings"),
    "field unit": (
        descriptor(magnetometer=MAGNETOMETER.replace("uT", "uTs")),
        "magnetometer.unit",
        "did you mean 'uT'",
    ),
    "noise zero": (descriptor(magnetometer=MAGNETOMETER + "noise_nt = 0\n"), "magnetometer.noise_nt", "from 0.001"),
    "noise nan": (descriptor(magnetometer=MAGNETOMETER + "noise_nt = nan\n"), "magnetometer.noise_nt", "finite"),
    "range zero": (
        descriptor(magnetometer=MAGNETOMETER + "range_nt = 0\n"),
        "magnetometer.range_nt",
        "from 1000",
    ),
    "range in uT": (descriptor(magnetometer=MAGNETOMETER + "range_nt = 50\n"), "magnetometer.range_nt", "from 1000"),
    "range a text": (descriptor(magnetometer=MAGNETOMETER + 'range_nt = "8 G"\n'), "magnetometer.range_nt", "number"),
    "range elsewhere": (descriptor("[sensor]\nrange_nt = 5e4\n"), "sensor", "unknown"),
    "two references": (descriptor(reference=REFERENCE + 'magnitude = "f"\n'), "reference", "exactly one of"),
    "empty reference": (descriptor(reference="[reference]\n"), "reference", "no form of a reference is there; exactly"),
    "no reference": (
        descriptor(reference=""),
        "reference",
        'a table [reference] is required, with one of: model = "igrf"',
    ),
    "reference a text": (
        descriptor(reference="").replace("[samples]", 'reference = "igrf"\n[samples]'),
        "reference",
        "table",
    ),
    "reference a list": (
        descriptor(reference=IGRF.replace("[reference]", "[[reference]]")),
        "reference",
        "columns = [",
    ),
    "reference by vector": (
        descriptor(reference=REFERENCE.replace("columns", "vector")),
        "reference",
        "('vector': did you mean 'columns'?)",
    ),
    "reference by column": (
        descriptor(reference='[reference]\nunit = "nT"\ncolumn = "f"\n'),
        "reference",
        "('column': did you mean 'columns'?)",
    ),
    "reference by igrf": (descriptor(reference="[reference]\nigrf = true\n"), "reference", "did you mean 'model'?"),
    "magnitude a number": (
        descriptor(reference='[reference]\nmagnitude = 48.2\nunit = "uT"\n'),
        "reference.magnitude",
        "of one magnitude for all rows: constant",
    ),
    "constant with its unit": (
        descriptor(reference='[reference]\nconstant = "48.2 uT"\nunit = "uT"\n'),
        "reference.constant",
        'its unit beside it: unit = "uT"',
    ),
    "no frame": (descriptor(reference=REFERENCE.replace('frame = "eci"\n', "")), "reference.frame", "eci, ecef, ned"),
    "body frame": (descriptor(reference=REFERENCE.replace("eci", "teme")), "reference.frame", "known: ecef, eci, ned"),
    "frame of a magnitude": (
        descriptor(reference='[reference]\nmagnitude = "f"\nunit = "nT"\nframe = "eci"\n'),
        "reference.frame",
        "unknown key",
    ),
    "magnitude no unit": (descriptor(reference='[reference]\nmagnitude = "f"\n'), "reference.unit", "nT, uT"),
    "constant no unit": (descriptor(reference="[reference]\nconstant = 49.0\n"), "reference.unit", "nT, uT"),
    "constant zero": (
        descriptor(reference='[reference]\nconstant = 0\nunit = "nT"\n'),
        "reference.constant",
        "above 0",
    ),
    "constant huge": (descriptor(reference='[reference]\nconstant = 2\nunit = "T"\n'), "reference.constant", "1 mT"),
    "constant a text": (
        descriptor(reference='[reference]\nconstant = "a"\nunit = "T"\n'),
        "reference.constant",
        "number",
    ),
    "model": (descriptor(GEODETIC, reference='[reference]\nmodel = "wmm"\n'), "reference.model", "known: igrf"),
    "igrf nowhere": (descriptor(reference=IGRF), "position", 'required with model = "igrf"'),
    "igrf at no time": (descriptor(GEODETIC, time=ELAPSED, reference=IGRF), "time.start", "elapsed_s"),
    "no altitude": (descriptor('[position]\ncolumns = ["lat", "lon"]\n'), "position.altitude", "exactly one of"),
    "two altitudes": (
        descriptor(GEODETIC + 'altitude = {column = "alt", unit = "km"}\n'),
        "position.altitude",
        "exactly one of",
    ),
    "altitude and radius": (
        descriptor(GEODETIC + 'radius = {column = "r", unit = "km"}\n'),
        "position.altitude",
        "exactly one of",
    ),
    "altitude unit": (
        descriptor('[position]\ncolumns = ["lat", "lon"]\naltitude = {column = "alt", unit = "miles"}\n'),
        "position.altitude.unit",
        "km, m",
    ),
    "four positions": (descriptor('[position]\ncolumns = ["a", "b", "c", "d"]\n'), "position.columns", "two columns"),
    "position no columns": (descriptor("[position]\n"), "position.columns", "array of strings"),
    "position ned": (
        descriptor('[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "ned"\n'),
        "position.frame",
        "known: ecef, eci",
    ),
    "axis letter": (descriptor('[spin]\naxis = "w"\n'), "spin.axis", "known: x, y, z"),
    "axis zero": (descriptor("[spin]\naxis = [0, 0, 0]\n"), "spin.axis", "not zero"),
    "axis of two": (descriptor("[spin]\naxis = [1, 0]\n"), "spin.axis", "3 finite numbers"),
    "no axis": (descriptor("[spin]\nrate_rpm = 3\n"), "spin.axis", "one of x, y, z"),
    "rate": (descriptor('[spin]\naxis = "x"\nrate_rpm = 1e9\n'), "spin.rate_rpm", "-6000 to 6000"),
    "channel unit": (
        descriptor(channel('column = "temp", unit = "degCC"')),
        "channels.thing.unit",
        "did you mean 'degC'",
    ),
    "channel key": (descriptor(channel('column = "temp", units = "K"')), "channels.thing.units", "did you mean 'unit'"),
    "channel no column": (descriptor(channel('unit = "K"')), "channels.thing.columns", "exactly one of"),
    "channel both": (descriptor(channel('column = "a", columns = ["b"]')), "channels.thing.columns", "exactly one of"),
    "channel empty": (descriptor(channel("columns = []")), "channels.thing.columns", "1 to 16"),
    "channel wide": (descriptor(channel(f"columns = {['c'] * 17}")), "channels.thing.columns", "1 to 16"),
    "channel no table": (descriptor("[channels]\nthing = 3\n"), "channels.thing", "a table"),
    "channel frame": (
        descriptor(channel('column = "a", frame = "bdy"')),
        "channels.thing.frame",
        "did you mean 'body'",
    ),
    "attitude of three": (
        descriptor(channel('columns = ["a", "b", "c"], order = "wxyz", from = "eci", to = "body"')),
        "channels.thing.columns",
        "4 columns",
    ),
    "attitude nowhere": (
        descriptor(channel('columns = ["a", "b", "c", "d"], order = "wxyz", from = "eci"')),
        "channels.thing.to",
        "needs order, from and to",
    ),
    "attitude in place": (
        descriptor(channel('columns = ["a", "b", "c", "d"], order = "wxyz", from = "body", to = "body"')),
        "channels.thing.to",
        "from one set of axes to another",
    ),
    "order": (
        descriptor(channel('columns = ["a", "b", "c", "d"], order = "zyxw", from = "body", to = "eci"')),
        "channels.thing.order",
        "wxyz",
    ),
    "long name": (descriptor(f'[channels]\n{"a" * 33} = {{ column = "b" }}\n'), "channels." + "a" * 33, "1 to 32"),
    "same on the wire": (
        descriptor('[channels]\n"a b" = { column = "b" }\na_b = { column = "c" }\n'),
        "channels.a_b",
        "differs from 'a b'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_each_fault_is_one_line_with_file_field_and_remedy(tmp_path: Path, case: str) -> None:
    text, field, accepted = REFUSED[case]
    (line,) = faults(tmp_path, text)
    assert line.startswith(f"log.toml: {field}: ")
    assert accepted in line


def test_all_faults_are_named_at_once(tmp_path: Path) -> None:
    text = descriptor(time=TIME.replace("unix_s", "unix"), magnetometer=MAGNETOMETER.replace("uT", "tesla"))
    assert len(faults(tmp_path, text.replace('"eci"', '"moon"'))) == 3


def test_a_missing_descriptor_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"absent\.toml: there is no such file"):
        load_descriptor(tmp_path / "absent.toml")


def test_what_is_no_toml_is_refused(tmp_path: Path) -> None:
    assert "valid TOML" in faults(tmp_path, "version = = 1")[0]
