"""What the tests of the wire share: golden frames, the corpus, and Hypothesis strategies for every message."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from magcal_service.wire import kinds
from magcal_service.wire.messages import (
    CalibratedVector,
    Clock,
    Command,
    CommandReply,
    Estimate,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    TelemetrySample,
    Verdict,
)

HERE = Path(__file__).parent
_ENUMERATIONS = {"clock": Clock, "frame": Frame, "verdict": Verdict}
_RECORDS = {kind.name: kind.record for kind in kinds.KINDS}


@dataclass(frozen=True)
class Golden:
    """One golden frame: the message, its frame sequence, its payload and its frame."""

    name: str
    kind: str
    canonical: bool
    message: Message
    frame_sequence: int
    payload: bytes
    frame: bytes


def _golden(path: Path) -> Golden:
    entry = json.loads(path.read_text(encoding="utf-8"))
    content = {
        name: _ENUMERATIONS[name](value) if name in _ENUMERATIONS and value is not None else _frozen(value)
        for name, value in entry["message"].items()
    }
    message = _RECORDS[entry["kind"]](**content)
    payload, frame = bytes.fromhex(entry["payload_hex"]), bytes.fromhex(entry["frame_hex"])
    return Golden(path.stem, entry["kind"], entry["canonical"], message, entry["frame_sequence"], payload, frame)


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


GOLDEN = tuple(_golden(path) for path in sorted((HERE / "golden").glob("*.json")))
SAMPLE = next(golden for golden in GOLDEN if golden.name == "magnetometer")


def corpus(folder: str) -> list[tuple[str, dict[str, Any]]]:
    """The cases of a corpus folder; ``bytes`` is put together from ``HEX`` and ``HEX*COUNT``."""
    cases = []
    for path in sorted((HERE / "corpus" / folder).glob("*.toml")):
        case = tomllib.loads(path.read_text(encoding="utf-8"))
        parts = [part.partition("*") for part in case["bytes"]]
        case["bytes"] = b"".join(bytes.fromhex(text) * int(count or 1) for text, _, count in parts)
        cases.append((path.stem, case))
    return cases


names = st.text("ABCXYZabcxyz0189_-", min_size=1, max_size=32)
counter_names = st.text("abcxyz019_.:/-", min_size=1, max_size=64)
sequences = st.integers(0, 2**32 - 1)
counts = st.integers(0, 2**53 - 1)
texts = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF)).filter(
    lambda text: text.isprintable() and len(text.encode()) <= 256
)
units = texts.filter(lambda text: len(text.encode()) <= 32)


def reals(limit: float, low: float | None = None) -> st.SearchStrategy[float]:
    return st.floats(-limit if low is None else low, limit, allow_nan=False)


def vectors(limit: float) -> st.SearchStrategy[tuple[float, float, float]]:
    side = limit / 1.7320508075688776
    return st.tuples(*[reals(side)] * 3)


def covariances(size: int) -> st.SearchStrategy[tuple[float, ...]]:
    rows = [(row, column) for row in range(size) for column in range(row, size)]
    return st.tuples(*[reals(1e30, 0.0 if row == column else None) for row, column in rows])


_common = {
    "craft": names,
    "source": names,
    "sequence": sequences,
    "time_ns": st.integers(-(2**63), 2**63 - 1),
    "clock": st.sampled_from(Clock),
}


def _record(kind: type[Message], **own: st.SearchStrategy[Any]) -> st.SearchStrategy[Message]:
    return st.builds(kind, **_common, **own)


_verdicts = st.sampled_from(Verdict)


def _protected(kind: type[Message], **own: st.SearchStrategy[Any]) -> st.SearchStrategy[Message]:
    """With a protection level and what sets it, or without both."""
    level = {"protection_nt": reals(1e7, 0.0), "protection_by": names}
    return st.one_of(_record(kind, **own), _record(kind, **own, **level))


_arguments = st.one_of(st.booleans(), st.integers(-(2**63), 2**63 - 1), reals(1e300), texts)
BY_KIND: dict[str, st.SearchStrategy[Message]] = {
    "magnetometer": _record(MagnetometerSample, field_body_nt=vectors(1e6)),
    "reference": st.one_of(
        _record(ReferenceSample, field_nt=vectors(1e6), frame=st.sampled_from(Frame)),
        _record(ReferenceSample, magnitude_nt=reals(1e6, 0.0)),
    ),
    "position": _record(PositionSample, position_km=vectors(1e6), frame=st.sampled_from([Frame.ECI, Frame.ECEF])),
    "telemetry": _record(
        TelemetrySample,
        channel=names,
        unit=units,
        values=st.lists(reals(1e18), min_size=1, max_size=16).map(tuple),
    ),
    "calibrated": _protected(
        CalibratedVector, field_body_nt=vectors(1e7), covariance_nt2=covariances(3), verdict=_verdicts
    ),
    "estimate": _protected(
        Estimate,
        method=names,
        tick=counts,
        bias_nt=vectors(1e7),
        D=st.tuples(*[reals(1e3)] * 6),
        covariance=covariances(9),
        verdict=_verdicts,
        reasons=st.lists(names, max_size=16).map(tuple),
        remedy=texts,
        residual_rms_nt=reals(1e7, 0.0),
        noise_nt=reals(1e7, 0.0),
        samples_used=counts,
    ),
    "status": _record(
        Status,
        uptime_s=reals(1e12, 0.0),
        verdict=_verdicts,
        counters=st.dictionaries(counter_names, counts, max_size=20),
        text=texts,
    ),
    "command": _record(Command, name=names, arguments=st.dictionaries(names, _arguments, max_size=8)),
    "reply": _record(
        CommandReply,
        name=names,
        command_source=names,
        command_sequence=sequences,
        accepted=st.booleans(),
        text=texts,
    ),
}
messages = st.one_of(*BY_KIND.values())
