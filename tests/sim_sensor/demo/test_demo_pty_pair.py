"""The pair of pseudo-terminals that stands for a serial cable."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest
import serial

from sim_sensor.demo.pty_pair import PtyPair


def read_all(port: serial.Serial, count: int) -> bytes:
    data = bytearray()
    while len(data) < count:
        piece = port.read(max(1, port.in_waiting))
        assert piece, f"the line went quiet after {len(data)} of {count} bytes"
        data += piece
    return bytes(data)


@pytest.mark.parametrize("direction", [0, 1])
def test_every_byte_value_passes_unchanged_both_ways(direction: int) -> None:
    every = bytes(range(256)) * 4
    with (
        PtyPair() as pair,
        serial.Serial(pair.paths[direction], timeout=5) as near,
        serial.Serial(pair.paths[1 - direction], timeout=5) as far,
    ):
        near.write(every)
        assert read_all(far, len(every)) == every


def test_nothing_is_lost_when_both_ends_write_more_than_the_buffers_hold() -> None:
    rng = np.random.default_rng(7)
    blocks = [rng.bytes(300_000) for _ in range(2)]
    received: dict[int, bytes] = {}
    with PtyPair() as pair:
        ports = [serial.Serial(path, timeout=10) for path in pair.paths]
        readers = [
            threading.Thread(target=lambda i=i: received.update({i: read_all(ports[i], len(blocks[1 - i]))}))
            for i in range(2)
        ]
        writers = [threading.Thread(target=ports[i].write, args=(blocks[i],)) for i in range(2)]
        for thread in readers + writers:
            thread.start()
        for thread in readers + writers:
            thread.join()
        for port in ports:
            port.close()
    assert [received[1], received[0]] == blocks


def test_an_end_can_be_closed_and_opened_again() -> None:
    with PtyPair() as pair, serial.Serial(pair.paths[0], timeout=5) as near:
        with serial.Serial(pair.paths[1], timeout=5) as far:
            near.write(b"one")
            assert read_all(far, 3) == b"one"
        with serial.Serial(pair.paths[1], timeout=5) as far:
            near.write(b"two")
            assert read_all(far, 3) == b"two"


def test_closing_gives_every_file_and_thread_back() -> None:
    files, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    pair = PtyPair()
    pair.close()
    pair.close()
    assert (len(os.listdir("/proc/self/fd")), threading.active_count()) == (files, threads)
