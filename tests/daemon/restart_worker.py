"""A process that has nothing but a configuration, a stored state and messages: what it publishes goes back.

Pickles over a pipe, each with its length before it; ``python -m tests.daemon.restart_worker`` serves until the end.
"""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from collections.abc import Sequence
from typing import IO, Any

import msgpack

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import Message


def put(stream: IO[bytes], value: Any) -> None:
    """Write one value."""
    data = pickle.dumps(value)
    stream.write(struct.pack("<Q", len(data)) + data)
    stream.flush()


def get(stream: IO[bytes]) -> Any:
    """Read one value; EOFError at the end."""
    head = stream.read(8)
    if len(head) < 8:
        raise EOFError
    return pickle.loads(stream.read(struct.unpack("<Q", head)[0]))


def published(pipeline: Pipeline, messages: Sequence[Message]) -> list[bytes]:
    """Every later output as it goes on the wire."""
    return [encode(answer) for message in messages for answer in pipeline.handle(message)]


class Worker:
    """The other process, from this side."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "tests.daemon.restart_worker"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __call__(self, config: CraftConfig, state: bytes, messages: Sequence[Message]) -> list[bytes]:
        """What a fresh pipeline publishes after it has taken up a stored state."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        put(self._process.stdin, (config, state, list(messages)))
        answer: list[bytes] = get(self._process.stdout)
        return answer

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(20)
        assert self._process.stdout is not None
        self._process.stdout.close()


def serve() -> None:
    """Answer until the input ends."""
    while True:
        try:
            config, state, messages = get(sys.stdin.buffer)
        except EOFError:
            return
        pipeline = Pipeline(config)
        pipeline.restore_state(msgpack.unpackb(state, strict_map_key=False))
        put(sys.stdout.buffer, published(pipeline, messages))


if __name__ == "__main__":
    serve()
