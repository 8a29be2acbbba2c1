"""Makes the golden frames beside it: ``python tests/wire/golden/make_golden.py``.

Written from docs/wire.md alone, as a second road: it imports nothing of the project, no msgpack, no cobs and no zlib.
Each file holds the message in words, the payload and the frame; ``canonical`` is false where the payload is accepted
but is not the form that the project itself would send (single-precision or integer numbers).
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

CLOCK = {"utc": 0, "elapsed": 1}
FRAME = {"eci": 0, "ecef": 1, "ned": 2}
VERDICT = {"not_started": 0, "converging": 1, "trusted": 2, "doubtful": 3}
COMMON = ["craft", "source", "sequence", "time_ns", "clock"]
OWN = {
    "magnetometer": (1, ["field_body_nt"]),
    "reference": (2, ["field_nt", "frame", "magnitude_nt"]),
    "position": (3, ["position_km", "frame"]),
    "telemetry": (4, ["channel", "unit", "values"]),
    "calibrated": (16, ["field_body_nt", "covariance_nt2", "verdict", "protection_nt", "protection_by"]),
    "estimate": (
        17,
        [
            *("method", "tick", "bias_nt", "D", "covariance", "verdict", "reasons", "remedy", "residual_rms_nt"),
            *("noise_nt", "samples_used", "protection_nt", "protection_by"),
        ],
    ),
    "status": (18, ["uptime_s", "verdict", "counters", "text"]),
    "command": (32, ["name", "arguments"]),
    "reply": (33, ["name", "command_source", "command_sequence", "accepted", "text"]),
}
APPENDED = {"protection_nt", "protection_by"}  # left out where the message has none
ENUMERATIONS = {"clock": CLOCK, "frame": FRAME, "verdict": VERDICT}


def msgpack_integer(value: int) -> bytes:
    if 0 <= value < 128:
        return bytes([value])
    if -32 <= value < 0:
        return struct.pack("b", value)
    unsigned = [(8, b"\xcc", ">B"), (16, b"\xcd", ">H"), (32, b"\xce", ">I"), (64, b"\xcf", ">Q")]
    signed = [(8, b"\xd0", ">b"), (16, b"\xd1", ">h"), (32, b"\xd2", ">i"), (64, b"\xd3", ">q")]
    for bits, mark, layout in unsigned if value >= 0 else signed:
        if (value >> bits if value >= 0 else (-value - 1) >> (bits - 1)) == 0:
            return mark + struct.pack(layout, value)
    raise ValueError(value)


def msgpack(value: object, number: str) -> bytes:
    """One value; ``number`` picks what floats become: ``double``, ``single`` or ``integer``."""
    if value is None:
        return b"\xc0"
    if isinstance(value, bool):
        return b"\xc3" if value else b"\xc2"
    if isinstance(value, int):
        return msgpack_integer(value)
    if isinstance(value, float):
        if number == "integer":
            return msgpack_integer(int(value))
        return b"\xcb" + struct.pack(">d", value) if number == "double" else b"\xca" + struct.pack(">f", value)
    if isinstance(value, str):
        raw = value.encode()
        if len(raw) < 32:
            return bytes([0xA0 + len(raw)]) + raw
        return (b"\xd9" + bytes([len(raw)]) if len(raw) < 256 else b"\xda" + struct.pack(">H", len(raw))) + raw
    if isinstance(value, list):
        head = bytes([0x90 + len(value)]) if len(value) < 16 else b"\xdc" + struct.pack(">H", len(value))
        return head + b"".join(msgpack(item, number) for item in value)
    if isinstance(value, dict):
        head = bytes([0x80 + len(value)]) if len(value) < 16 else b"\xde" + struct.pack(">H", len(value))
        return head + b"".join(msgpack(k, number) + msgpack(v, number) for k, v in value.items())
    raise TypeError(value)


def crc32(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def cobs(data: bytes) -> bytes:
    out = bytearray()
    blocks = data.split(b"\0")
    for place, block in enumerate(blocks):
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
            if not block and place == len(blocks) - 1:
                return bytes(out)
        out += bytes([len(block) + 1]) + block
    return bytes(out)


def golden(kind: str, message: dict[str, object], frame_sequence: int, number: str = "double") -> dict[str, object]:
    code, own = OWN[kind]
    values = [
        ENUMERATIONS[name][str(message[name])] if name in ENUMERATIONS and message[name] is not None else message[name]
        for name in COMMON + own
        if name in message or name not in APPENDED
    ]
    payload = msgpack([1, code, *values], number)
    body = struct.pack("<BBHH", 1, code, frame_sequence, len(payload)) + payload
    frame = b"\0" + cobs(body + struct.pack("<I", crc32(body))) + b"\0"
    return {
        "kind": kind,
        "canonical": number == "double",
        "message": message,
        "frame_sequence": frame_sequence,
        "payload_hex": payload.hex(),
        "frame_hex": frame.hex(),
    }


def hmac_sha256(key: bytes, data: bytes) -> bytes:
    """RFC 2104 in its own words; keys of up to 64 bytes."""
    padded = key.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(byte ^ 0x36 for byte in padded) + data).digest()
    return hashlib.sha256(bytes(byte ^ 0x5C for byte in padded) + inner).digest()


def sealed_golden(key: bytes, counter: int, frame_sequence: int) -> dict[str, object]:
    """The golden command, sealed."""
    payload = bytes.fromhex(str(all_golden()["command"]["payload_hex"]))
    counted = struct.pack("<Q", counter)
    tag = hmac_sha256(key, b"magcal sealed command 1\0" + counted + payload)[:16]
    content = counted + payload + tag
    body = struct.pack("<BBHH", 1, 32 + 0x40, frame_sequence, len(content)) + content
    return {
        "key_hex": key.hex(),
        "counter": counter,
        "frame_sequence": frame_sequence,
        "content_hex": content.hex(),
        "frame_hex": (b"\0" + cobs(body + struct.pack("<I", crc32(body))) + b"\0").hex(),
    }


def all_sealed() -> dict[str, dict[str, object]]:
    return {"command_sealed": sealed_golden(bytes(range(32)), 1_764_547_200, 10)}


def common(source: str, sequence: int, time_ns: int, clock: str = "utc", craft: str = "sat1") -> dict[str, object]:
    return {"craft": craft, "source": source, "sequence": sequence, "time_ns": time_ns, "clock": clock}


def all_golden() -> dict[str, dict[str, object]]:
    utc = 1_764_547_200_000_000_000  # 2025-12-01T00:00:00Z
    sample = common("mag0", 1, utc) | {"field_body_nt": [21500.25, -13000.5, 38250.0]}
    whole = common("mag0", 70000, 250_000_000, "elapsed") | {"field_body_nt": [21500.0, -13000.0, 0.0]}
    edges = common("m" * 32, 4294967295, -9_223_372_036_854_775_808, "elapsed", "Craft_32-characters_long_name_0x")
    covariance = [0.0] * 45
    for row in range(9):
        covariance[row * 9 - row * (row - 1) // 2] = 5.76 if row < 3 else 1e-8
    covariance[3] = -0.0001220703125
    return {
        "magnetometer": golden("magnetometer", sample, 0),
        "magnetometer_edges": golden("magnetometer", edges | {"field_body_nt": [-1e6, 0.0, 1e-300]}, 65535),
        "magnetometer_single": golden("magnetometer", sample, 1, "single"),
        "magnetometer_integer": golden("magnetometer", whole, 2, "integer"),
        "reference_vector": golden(
            "reference",
            common("igrf", 130, utc + 1)
            | {"field_nt": [18000.0, 2500.5, -31000.25], "frame": "eci"}
            | {"magnitude_nt": None},
            256,
        ),
        "reference_magnitude": golden(
            "reference",
            common("scalar", 300, 128, "elapsed") | {"field_nt": None, "frame": None, "magnitude_nt": 45678.9},
            257,
        ),
        "position": golden(
            "position", common("gnss", 7, utc) | {"position_km": [6990.0, -12.5, 0.125], "frame": "ecef"}, 3
        ),
        "telemetry": golden(
            "telemetry", common("obc", 8, utc) | {"channel": "torquer", "unit": "A m2", "values": [0.2, -0.2, 0.0]}, 4
        ),
        "calibrated": golden(
            "calibrated",
            common("mag0", 1, utc)
            | {
                "field_body_nt": [17000.5, -12000.25, 33000.0],
                "covariance_nt2": [90000.0, 1.5, -2.5, 90001.0, 0.5, 9e4],
            }
            | {"verdict": "trusted"},
            5,
        ),
        "calibrated_protected": golden(
            "calibrated",
            common("mag0", 2, utc)
            | {"field_body_nt": [17000.5, -12000.25, 33000.0], "covariance_nt2": [9e4, 0.0, 0.0, 9e4, 0.0, 9e4]}
            | {"verdict": "trusted", "protection_nt": 208.5, "protection_by": "bias_step"},
            11,
        ),
        "estimate": golden(
            "estimate",
            common("magcal", 18000, utc)
            | {"method": "ukf", "tick": 18000, "bias_nt": [5000.125, 2999.75, 4000.5]}
            | {"D": [0.05, 0.1, 0.05, 0.05, 0.05, 0.05], "covariance": covariance, "verdict": "doubtful"}
            | {"reasons": ["coverage"], "remedy": "Tumble about a second axis, 5° are enough."}
            | {"residual_rms_nt": 301.5, "noise_nt": 300.0, "samples_used": 18000},
            6,
        ),
        "status": golden(
            "status",
            common("magcal", 12, utc)
            | {"uptime_s": 3600.5, "verdict": "converging", "counters": {"received": 3600, "refused.bad_crc": 2}}
            | {"text": ""},
            7,
        ),
        "command": golden(
            "command",
            common("console", 3, utc)
            | {"name": "reset", "arguments": {"keep_bias": True, "sigma_nt": 2000.0, "ticks": -300, "note": "again"}},
            8,
        ),
        "reply": golden(
            "reply",
            common("magcal", 3, utc)
            | {"name": "reset", "command_source": "console", "command_sequence": 3, "accepted": False}
            | {"text": "a reset needs the craft to be named"},
            9,
        ),
    }


def main() -> None:
    here = Path(__file__).parent
    (here / "sealed").mkdir(exist_ok=True)
    for folder, entries in ((here, all_golden()), (here / "sealed", all_sealed())):
        for name, entry in entries.items():
            text = json.dumps(entry, indent=1, ensure_ascii=False)
            (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
