"""How long the wire takes, beside bare msgpack: ``python -m tests.benchmarks.bench_wire`` from the checkout's root.

Each figure is the best of several repetitions, in microseconds for one message.
"""

from __future__ import annotations

import json
import timeit
from collections.abc import Callable
from pathlib import Path

import msgpack

from magcal_service.wire.codec import decode, encode
from magcal_service.wire.framing import FrameEncoder, StreamDecoder

GOLDEN = Path(__file__).parents[1] / "wire" / "golden"
NAMES = ("magnetometer", "reference_vector", "reference_magnitude", "calibrated", "estimate", "status")
RUNS, REPETITIONS = 2000, 15


def microseconds(call: Callable[[], object]) -> float:
    return min(timeit.repeat(call, number=RUNS, repeat=REPETITIONS)) / RUNS * 1e6


def main() -> None:
    columns = ("bare packb", "encode", "ratio", "bare unpackb", "decode", "ratio", "to frame", "from frame")
    print(f"{'us per message':20}" + "".join(f"{column:>14}" for column in columns))
    for name in NAMES:
        entry = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
        payload, frame = bytes.fromhex(entry["payload_hex"]), bytes.fromhex(entry["frame_hex"])
        message, values = decode(payload), msgpack.unpackb(payload)
        framer, stream = FrameEncoder(), StreamDecoder()
        bare_pack = microseconds(lambda values=values: msgpack.packb(values))
        bare_unpack = microseconds(lambda payload=payload: msgpack.unpackb(payload))
        own_pack = microseconds(lambda message=message: encode(message))
        own_unpack = microseconds(lambda payload=payload: decode(payload))
        to_frame = microseconds(lambda framer=framer, message=message: framer.encode(message))
        from_frame = microseconds(lambda stream=stream, frame=frame: stream.feed(frame))
        figures = (bare_pack, own_pack, own_pack / bare_pack, bare_unpack, own_unpack, own_unpack / bare_unpack)
        print(f"{name:20}" + "".join(f"{figure:14.2f}" for figure in (*figures, to_frame, from_frame)))


if __name__ == "__main__":
    main()
