"""Readers of files; what must hold of each result, and sound files to begin with."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Hashable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from magcal_service.base.errors import DecodeError
from magcal_service.config.reader import load_config
from magcal_service.config.settings import CraftConfig
from magcal_service.config.text import craft_as_toml, craft_from_toml
from magcal_service.daemon.checkpoints.store import MISFITS
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.json_form import from_json, schema_name, to_json
from magcal_service.recordings.mcap import CRAFT, STATE, RawMessage, Topic
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.reader import read_described
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.session_arrays import session_recording
from magcal_service.recordings.session_files import recover
from magcal_service.recordings.state_text import state_as_text
from magcal_service.recordings.timestamps import decimal_to_ns, iso8601_to_ns
from magcal_service.wire.codec import encode
from magcal_service.wire.kinds import KINDS, kind_of
from sim_sensor.scenario import resolve
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.fuzz.inputs import ROOT, file_of, flight, folder, one_of_each


def run_json(data: bytes) -> Hashable:
    """The first byte chooses the kind; what is accepted comes back as the same."""
    kind = KINDS[(data[0] if data else 0) % len(KINDS)]
    message = from_json(kind, data[1:])
    assert repr(from_json(kind, to_json(message))) == repr(message)
    return kind.name


def run_times(data: bytes) -> Hashable:
    """A time is nanoseconds or none."""
    text = data.decode(errors="replace")
    values = iso8601_to_ns(text), decimal_to_ns(text, 9)
    assert all(value is None or isinstance(value, int) for value in values)
    return values[0] is None, values[1] is None


def run_descriptor(data: bytes) -> Hashable:
    """A descriptor is accepted with a log's name in it, or refused."""
    descriptor = load_descriptor(file_of("RECORDING.toml", data))
    return type(descriptor.reference), type(descriptor.position), descriptor.time.format, len(descriptor.channels)


def _described(data: bytes, name: str) -> Recording:
    descriptor = load_descriptor(file_of("LOG.toml", DESCRIPTOR.replace(b"log.csv", name.encode())))
    file_of(name, data)
    return read_described(descriptor)


def run_csv(data: bytes) -> Hashable:
    """Every row is used or accounted for; what is used is finite."""
    return _checked(_described(data, "log.csv"))


def run_csv_gz(data: bytes) -> Hashable:
    """The same of a packed log."""
    return _checked(_described(data, "log.csv.gz"))


def _checked(recording: Recording) -> Hashable:
    report = recording.report
    assert report.used == len(recording) <= report.rows
    assert np.isfinite(recording.field_body_nt).all()
    refused = sum(
        entry.count for entry in report.entries if not entry.kept and entry.part in ("row", "time", "magnetometer")
    )
    assert report.refused <= refused
    known = recording.reference.magnitude_nt[np.isfinite(recording.reference.magnitude_nt)]
    assert (known > 0.0).all()
    return frozenset((entry.part, entry.fault) for entry in report.entries)


def run_session(data: bytes) -> Hashable:
    """Arrays of what can be read; recovery keeps every record and makes a sound file."""
    path = file_of("session.mcap", data)
    reader = McapReader(io.BytesIO(data), "input")
    count = sum(1 for _ in reader.messages())
    assert reader.good_bytes <= len(data)
    if count and reader.profile == "magcal":
        recovered = recover(path, folder() / "out.mcap")
        assert recovered.messages == count
        again = McapReader(io.BytesIO((folder() / "out.mcap").read_bytes()), "again")
        assert sum(1 for _ in again.messages()) == count
        assert again.sound
    part = session_recording(path, prefer="a")
    if part.state is not None and part.craft is not None:
        with suppress(*MISFITS):
            Pipeline(part.craft).restore_state(part.state)
    assert part.stream is not None
    assert len(part) <= len(part.stream)
    assert np.isfinite(part.field_body_nt).all()
    return frozenset((entry.part, entry.fault) for entry in part.report.entries), tuple(part.channels)


def run_config(data: bytes) -> Hashable:
    """What is accepted is within its limits and comes back from text as the same."""
    config = load_config(file_of("magcal.toml", data))
    for craft in config.crafts:
        assert craft_from_toml(craft_as_toml(craft), "text") == craft
    return len(config.crafts), config.record is None, config.link.partition(":")[0]


def run_scenario(data: bytes) -> Hashable:
    """A scenario that is accepted can be flown, and what its sensor sends can be sent."""
    scenario = load_scenario(file_of("scenario.toml", data))
    try:
        for message in itertools.islice(Simulation(scenario, 1, 2.0).messages(), 30):
            encode(message)
    except DecodeError as error:  # an error of 1 mT and more saturates no simulated sensor, and is not sent
        if error.reason != "out_of_range":
            raise
    assert all(map(math.isfinite, resolve(scenario, 1).spin.axis_body))
    return scenario.reference.form, len(scenario.faults), scenario.telemetry.channels


DESCRIPTOR = b"""version = 1
[samples]
file = "log.csv"
[time]
column = "t"
format = "iso8601"
[magnetometer]
columns = ["mx", "my", "mz"]
unit = "nT"
[reference]
columns = ["hx", "hy", "hz"]
unit = "nT"
frame = "eci"
[position]
columns = ["x", "y", "z"]
unit = "km"
frame = "eci"
[channels]
temperature = { column = "temp", unit = "degC" }
"""


def descriptors() -> list[bytes]:
    pages = (ROOT / "docs/recording-format.md").read_text().split("```toml\n")[1:]
    session = b'version = 1\n[samples]\nfile = "a.mcap"\ncraft = "a"\n[spin]\naxis = "z"\nrate_rpm = 7.5\n'
    return [DESCRIPTOR, session, *(page.split("```")[0].encode() for page in pages)]


def configs() -> list[bytes]:
    pages = (ROOT / "docs/configuration.md").read_text().split("```toml\n")[1:]
    shipped = [path.read_bytes() for path in sorted((ROOT / "deploy/config").glob("*.toml"))]
    return [*(page.split("```")[0].encode() for page in pages), *shipped, craft_as_toml(CraftConfig("a")).encode()]


def csv_log() -> bytes:
    rows = ["t,mx,my,mz,hx,hy,hz,x,y,z,temp"]
    rows += [f"2025-06-01T00:00:{n:02d}Z,{n}.5,2e4,-3,1.0,2.5e4,{n},7000,0.5,{n},2{n}.25" for n in range(12)]
    return "\n".join([*rows, '"2025-06-01 00:00:30",1,2,3,4,5,6,7,8,9,"10"', ""]).encode()


def sessions() -> list[bytes]:
    files = []
    for messages in (one_of_each(), flight(20), (*flight(5), *(replace(one, craft="b") for one in flight(5)))):
        file = io.BytesIO()
        writer = McapWriter(file, "fuzz")
        writer.add_metadata(CRAFT, {"name": "a", "configuration": craft_as_toml(CraftConfig("a"))})
        writer.add_metadata(STATE, {"craft": "a", "state": state_as_text(Pipeline(CraftConfig("a")).export_state())})
        for number, message in enumerate(messages):
            kind = kind_of(message)
            topic = Topic(message.craft, kind.name, schema_name(kind), b"{}")
            writer.add(RawMessage(topic, message.sequence, 10**18 + number, message.time_ns, to_json(message)))
            if number % 20 == 19:
                writer.end_chunk()
        writer.finish()
        files.append(file.getvalue())
    return files
