"""What is fuzzed: every reader of bytes from outside, with inputs to begin with and what must hold of the result.

A target's ``run`` returns, or raises one of the errors that its reader is documented to raise.  Anything else is a
crash: another exception, a broken promise about the result (``AssertionError``), a hang, memory without bound.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path

from magcal_service.base.errors import ConfigError, DecodeError, LinkAddressError, MagcalError, RecordingError
from magcal_service.physics.apply.model_file import ModelError
from magcal_service.physics.catalogue import catalogue
from magcal_service.recordings.json_form import to_json
from magcal_service.wire.codec import encode
from magcal_service.wire.kinds import KIND_BY_CODE, KINDS, kind_of
from sim_sensor.scenario_reader import shipped_scenarios
from tests.fuzz import dress, file_readers, live_readers, physics_reader
from tests.fuzz.inputs import flight, frames, one_of_each
from tests.fuzz.mutate import Operation

CORPUS = Path(__file__).parent / "corpus"


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


_EFFECTS = tuple(
    word.encode() for effect in catalogue() for word in (f'"{effect.name}"', *(f"{name} = 1" for name in effect.units))
)


_TIMES = (b"2025-06-01T00:00:00.123456789Z", b"20250601 235960+02:00", b"1692888249.25", b"-1.5e3")


TARGETS: tuple[Target, ...] = (
    Target(
        "payload",
        live_readers.run_payload,
        DecodeError,
        lambda: [*map(encode, one_of_each())],
        own=(dress.payload,),
        share=4.0,
    ),
    Target(
        "stream",
        live_readers.run_stream,
        (),
        lambda: [frames(one_of_each()), *(frames([m]) for m in one_of_each())],
        own=(dress.frame,),
    ),
    Target(
        "pipeline",
        live_readers.run_pipeline,
        (),
        lambda: [frames(flight(8)), frames(flight(4))],
        own=(dress.frame,),
        share=0.1,
    ),
    Target("address", live_readers.run_address, LinkAddressError, lambda: _ADDRESSES, (b"?", b"&", b"%00", b"=")),
    Target("counter", live_readers.run_counter, (), lambda: [b"magcal counter 7 %08x\n" % zlib.crc32(b"7")]),
    Target("key", live_readers.run_key, ConfigError, lambda: [b"0123456789abcdef" * 4 + b"\n"]),
    Target("checkpoint", live_readers.run_checkpoint, (), live_readers.checkpoints, own=(dress.checkpoint,), share=0.2),
    Target("times", file_readers.run_times, (), lambda: _TIMES, (b"UTC", b"Z", b"T24:00", b"e999")),
    Target(
        "json",
        file_readers.run_json,
        DecodeError,
        lambda: [bytes([KINDS.index(kind_of(m))]) + to_json(m) for m in one_of_each()],
        _NAMES,
        share=2.0,
    ),
    Target("descriptor", file_readers.run_descriptor, RecordingError, file_readers.descriptors, _TOML),
    Target(
        "csv",
        file_readers.run_csv,
        RecordingError,
        lambda: [file_readers.csv_log()],
        (b",,", b"nan,", b"\r\n", b'"'),
        share=0.5,
    ),
    Target(
        "csv-gz",
        file_readers.run_csv_gz,
        RecordingError,
        lambda: [gzip.compress(file_readers.csv_log(), mtime=0)],
        share=0.5,
    ),
    Target("session", file_readers.run_session, MagcalError, file_readers.sessions, own=(dress.session,), share=0.25),
    Target("config", file_readers.run_config, ConfigError, file_readers.configs, _TOML),
    Target(
        "physics",
        physics_reader.run_physics,
        ModelError,
        physics_reader.models,
        (*_TOML, b"[[effect]]\n", b"[effect.nonlinear]\n", *_EFFECTS),
        share=0.2,
    ),
    Target(
        "scenario",
        file_readers.run_scenario,
        ConfigError,
        lambda: [path.read_bytes() for path in shipped_scenarios().values()],
        _TOML,
        share=0.2,
    ),
)
