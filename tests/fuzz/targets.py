"""What is fuzzed: every reader of bytes from outside, with inputs to begin with and what must hold of the result.

A target's ``run`` returns, or raises one of the errors that its reader is documented to raise.  Anything else is a
crash: another exception, a broken promise about the result (``AssertionError``), a hang, memory without bound.
"""

from __future__ import annotations

import gzip
import io
import itertools
import math
import re
import tempfile
import zlib
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from magcal_service.checkpoints import MISFITS, Checkpoints
from magcal_service.config import CraftConfig, FilterConfig, SensorConfig, SpinConfig, StateConfig, load_config
from magcal_service.config_text import craft_as_toml, craft_from_toml
from magcal_service.errors import ConfigError, DecodeError, LinkAddressError, MagcalError, RecordingError
from magcal_service.links.address import parse_address
from magcal_service.links.counter_file import CounterFile
from magcal_service.pipeline import Pipeline
from magcal_service.private_files import read_key
from magcal_service.recordings.descriptor import load_descriptor
from magcal_service.recordings.json_form import from_json, schema_name, to_json
from magcal_service.recordings.mcap import CRAFT, STATE, McapReader, McapWriter, RawMessage, Topic
from magcal_service.recordings.reader import read_described
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.session_arrays import session_recording
from magcal_service.recordings.session_files import recover
from magcal_service.recordings.state_text import state_as_text
from magcal_service.recordings.timestamps import iso8601_to_ns, seconds_to_ns
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.framing import FrameEncoder, StreamDecoder
from magcal_service.wire.kinds import KIND_BY_CODE, KINDS, kind_of
from magcal_service.wire.messages import Command, Message, Status
from magcal_service.wire.seal import SealGate
from sim_sensor.scenario import load_scenario, resolve, shipped_scenarios
from sim_sensor.simulation import Simulation
from tests.fuzz import dress
from tests.fuzz.mutate import Operation

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).parent / "corpus"
_DIGITS = re.compile(r"[0-9]+")


@dataclass(frozen=True)
class Target:
    """One reader.

    Parameters
    ----------
    name: as the command line and the corpus folder call it.
    run: reads one input; what it returns tells outcomes apart.
    refuses: what it may raise.
    seeds: inputs to begin with.
    tokens: words that it knows.
    own: operations that get past its checksums.
    share: how many inputs it gets, relative to the others; slow readers get fewer.
    """

    name: str
    run: Callable[[bytes], Hashable]
    refuses: type[MagcalError] | tuple[()]
    seeds: Callable[[], Sequence[bytes]]
    tokens: tuple[bytes, ...] = ()
    own: tuple[Operation, ...] = ()
    share: float = 1.0

    def corpus(self) -> list[bytes]:
        """Inputs that were worth keeping."""
        return [path.read_bytes() for path in sorted((CORPUS / self.name).glob("*")) if path.is_file()]


@cache
def _folder() -> Path:
    """Where readers of files find their input; in memory where the machine has such a place."""
    shared = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="magcal-fuzz-", dir=shared if shared.is_dir() else None))


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


@cache
def _flight(seconds: int, scenario: str = "hot-electronics") -> tuple[Message, ...]:
    return tuple(replace(one, craft="a") for one in Simulation(load_scenario(scenario), 1, float(seconds)).messages())


def _one_of_each() -> tuple[Message, ...]:
    """A message of every kind: what a pipeline is given and what it answers."""
    pipeline = Pipeline(CraftConfig("a"))
    command = Command(craft="a", source="b", sequence=1, time_ns=2, name="freeze", arguments={"x": 1.5, "y": "z"})
    sent: list[Message] = [*_flight(30), command]
    given = [one for message in sent for one in (message, *pipeline.handle(message))]
    given.append(pipeline.status(1.0, pipeline.ticks.counters))
    return tuple({type(message): message for message in given}.values())


def _frames(messages: Sequence[Message]) -> bytes:
    encoder = FrameEncoder()
    return b"".join(map(encoder.encode, messages))


# The wire


def run_payload(data: bytes) -> Hashable:
    """What is accepted is encoded and accepted again as the same."""
    message = decode(data)
    assert repr(decode(encode(message))) == repr(message)
    return type(message)


def _gated() -> StreamDecoder:
    return StreamDecoder(gate=SealGate(dress.KEY, 0, lambda counter: None), refused=lambda command, error: None)


def run_stream(data: bytes) -> Hashable:
    """Whole or in pieces, gated or not: a stream gives messages and counters and never raises."""
    whole, pieces = StreamDecoder(), StreamDecoder()
    messages = whole.feed(data)
    size = 1 + len(data) // 7
    split = [message for at in range(0, len(data), size) for message in pieces.feed(data[at : at + size])]
    assert repr(messages) == repr(split)
    assert whole.counters == pieces.counters
    gated = _gated()
    gated.feed(data)
    return frozenset(whole.counters), frozenset(gated.counters)


def run_pipeline(data: bytes) -> Hashable:
    """Whatever messages come, in whatever order: what goes out can be sent, and the state stays finite."""
    outcomes: list[str] = []
    for craft in (CraftConfig("a"), CraftConfig("a", spin=SpinConfig(), filter=FilterConfig(start_s=10.0))):
        pipeline = Pipeline(craft)
        for message in StreamDecoder().feed(data):
            for answer in pipeline.handle(message):
                encode(answer)
        for answer in pipeline.flush():
            encode(answer)
        assert isinstance(pipeline.status(1.0, pipeline.ticks.counters), Status)
        outcomes += [name for name, count in (pipeline.ticks.counters + pipeline.counters).items() if count]
    return frozenset(outcomes)


def run_counter(data: bytes) -> Hashable:
    """A counter is believed or it is not."""
    last = CounterFile(_file("counter", data)).last
    assert last is None or 0 <= last < 1 << 64
    return last is None


def run_key(data: bytes) -> Hashable:
    """A key is long enough or refused."""
    path = _file("key", data)
    path.chmod(0o600)
    key = read_key(path)
    assert len(key) >= 16
    return len(key)


def run_address(data: bytes) -> Hashable:
    """An address is read or refused."""
    return parse_address(data.decode(errors="replace")).scheme


# State


CRAFTS = (
    CraftConfig("a", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig(), filter=FilterConfig(start_s=10.0)),
    CraftConfig("b", spin=SpinConfig(), filter=FilterConfig(method="spin", start_s=10.0)),
)


@cache
def _checkpoints() -> tuple[bytes, ...]:
    """Of two methods, before and after their start."""
    found = []
    for craft in CRAFTS:
        for seconds in (20, 900):
            pipeline, folder = Pipeline(craft), _folder() / f"made-{craft.name}-{seconds}"
            for message in _flight(seconds, "paper"):
                pipeline.handle(replace(message, craft=craft.name))
            Checkpoints(StateConfig(folder), (craft,)).save([pipeline])
            found += [path.read_bytes() for path in folder.glob("*/*.state")]
    return tuple(found)


def run_checkpoint(data: bytes) -> Hashable:
    """A checkpoint is taken up or dropped; with one that is taken up, all that goes out can be sent."""
    outcomes: list[str] = []
    for craft in CRAFTS:
        folder = _folder() / "state"
        (folder / craft.name).mkdir(parents=True, exist_ok=True)
        (folder / craft.name / "0000000001.state").write_bytes(data)
        fresh = Pipeline(craft)
        pipeline, events = Checkpoints(StateConfig(folder), (craft,)).restore(fresh)
        outcomes += [_DIGITS.sub("#", event.cause)[:60] for event in events]
        if pipeline is not fresh:
            newest_ns = min(pipeline.last_time_ns, (1 << 63) - 10**11)
            for message in _flight(3, "paper"):
                later = replace(message, craft=craft.name, time_ns=newest_ns + message.time_ns % 10**10)
                for answer in pipeline.handle(later):
                    encode(answer)
            encode(pipeline.status(1.0, pipeline.ticks.counters))
            for answer in pipeline.flush():
                encode(answer)
    return tuple(outcomes)


# Recordings


def run_json(data: bytes) -> Hashable:
    """The first byte chooses the kind; what is accepted comes back as the same."""
    kind = KINDS[(data[0] if data else 0) % len(KINDS)]
    message = from_json(kind, data[1:])
    assert repr(from_json(kind, to_json(message))) == repr(message)
    return kind.name


def run_times(data: bytes) -> Hashable:
    """A time is nanoseconds or none."""
    text = data.decode(errors="replace")
    values = iso8601_to_ns(text), seconds_to_ns(text)
    assert all(value is None or isinstance(value, int) for value in values)
    return values[0] is None, values[1] is None


def run_descriptor(data: bytes) -> Hashable:
    """A descriptor is accepted with a log's name in it, or refused."""
    descriptor = load_descriptor(_file("RECORDING.toml", data))
    return type(descriptor.reference), type(descriptor.position), descriptor.time.format, len(descriptor.channels)


def _described(data: bytes, name: str) -> Recording:
    descriptor = load_descriptor(_file("LOG.toml", DESCRIPTOR.replace(b"log.csv", name.encode())))
    _file(name, data)
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
    path = _file("session.mcap", data)
    reader = McapReader(io.BytesIO(data), "input")
    count = sum(1 for _ in reader.messages())
    assert reader.good_bytes <= len(data)
    if count and reader.profile == "magcal":
        recovered = recover(path, _folder() / "out.mcap")
        assert recovered.messages == count
        again = McapReader(io.BytesIO((_folder() / "out.mcap").read_bytes()), "again")
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


# Settings


def run_config(data: bytes) -> Hashable:
    """What is accepted is within its limits and comes back from text as the same."""
    config = load_config(_file("magcal.toml", data))
    for craft in config.crafts:
        assert craft_from_toml(craft_as_toml(craft), "text") == craft
    return len(config.crafts), config.record is None, config.link.partition(":")[0]


def run_scenario(data: bytes) -> Hashable:
    """A scenario that is accepted can be flown, and what its sensor sends can be sent."""
    scenario = load_scenario(_file("scenario.toml", data))
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


def _descriptors() -> list[bytes]:
    pages = (ROOT / "docs/recording-format.md").read_text().split("```toml\n")[1:]
    session = b'version = 1\n[samples]\nfile = "a.mcap"\ncraft = "a"\n[spin]\naxis = "z"\nrate_rpm = 7.5\n'
    return [DESCRIPTOR, session, *(page.split("```")[0].encode() for page in pages)]


def _configs() -> list[bytes]:
    pages = (ROOT / "docs/configuration.md").read_text().split("```toml\n")[1:]
    shipped = [path.read_bytes() for path in sorted((ROOT / "deploy/config").glob("*.toml"))]
    return [*(page.split("```")[0].encode() for page in pages), *shipped, craft_as_toml(CraftConfig("a")).encode()]


def _csv() -> bytes:
    rows = ["t,mx,my,mz,hx,hy,hz,x,y,z,temp"]
    rows += [f"2025-06-01T00:00:{n:02d}Z,{n}.5,2e4,-3,1.0,2.5e4,{n},7000,0.5,{n},2{n}.25" for n in range(12)]
    return "\n".join([*rows, '"2025-06-01 00:00:30",1,2,3,4,5,6,7,8,9,"10"', ""]).encode()


def _sessions() -> list[bytes]:
    files = []
    for messages in (_one_of_each(), _flight(20), (*_flight(5), *(replace(one, craft="b") for one in _flight(5)))):
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


_TOML = (
    b"[craft.filter]\n",
    b"[[craft]]\n",
    b"[samples]\n",
    b"[channels]\n",
    b"[orbit]\n",
    b"= 1979-05-27T07:32:00Z",
    b"= {}",
)
_NAMES = tuple(name.encode() for kind in KIND_BY_CODE.values() for name in (kind.name, *(one.name for one in kind.own)))
_ADDRESSES = (
    b"zenoh:tcp/127.0.0.1:7447?mode=peer&listen=yes",
    b"serial:/dev/ttyUSB0?baud=115200",
    b"recording:a%20b?speed=1",
)
_TIMES = (b"2025-06-01T00:00:00.123456789Z", b"20250601 235960+02:00", b"1692888249.25", b"-1.5e3")

TARGETS: tuple[Target, ...] = (
    Target(
        "payload", run_payload, DecodeError, lambda: [*map(encode, _one_of_each())], own=(dress.payload,), share=4.0
    ),
    Target(
        "stream",
        run_stream,
        (),
        lambda: [_frames(_one_of_each()), *(_frames([m]) for m in _one_of_each())],
        own=(dress.frame,),
    ),
    Target(
        "pipeline", run_pipeline, (), lambda: [_frames(_flight(8)), _frames(_flight(4))], own=(dress.frame,), share=0.1
    ),
    Target("address", run_address, LinkAddressError, lambda: _ADDRESSES, (b"?", b"&", b"%00", b"=")),
    Target("counter", run_counter, (), lambda: [b"magcal counter 7 %08x\n" % zlib.crc32(b"7")]),
    Target("key", run_key, ConfigError, lambda: [b"0123456789abcdef" * 4 + b"\n"]),
    Target("checkpoint", run_checkpoint, (), _checkpoints, own=(dress.checkpoint,), share=0.2),
    Target("times", run_times, (), lambda: _TIMES, (b"UTC", b"Z", b"T24:00", b"e999")),
    Target(
        "json",
        run_json,
        DecodeError,
        lambda: [bytes([KINDS.index(kind_of(m))]) + to_json(m) for m in _one_of_each()],
        _NAMES,
        share=2.0,
    ),
    Target("descriptor", run_descriptor, RecordingError, _descriptors, _TOML),
    Target("csv", run_csv, RecordingError, lambda: [_csv()], (b",,", b"nan,", b"\r\n", b'"'), share=0.5),
    Target("csv-gz", run_csv_gz, RecordingError, lambda: [gzip.compress(_csv(), mtime=0)], share=0.5),
    Target("session", run_session, MagcalError, _sessions, own=(dress.session,), share=0.25),
    Target("config", run_config, ConfigError, _configs, _TOML),
    Target(
        "scenario",
        run_scenario,
        ConfigError,
        lambda: [path.read_bytes() for path in shipped_scenarios().values()],
        _TOML,
        share=0.2,
    ),
)
