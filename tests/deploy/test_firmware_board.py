"""The example board, in C, feeds a daemon over a serial line and uses what comes back."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim_sensor.demo.daemon_process import DaemonProcess
from sim_sensor.demo.pty_pair import PtyPair
from tests.daemon.service_processes import wait_for

KIT = Path(__file__).parents[2] / "deploy" / "firmware"
EXAMPLES = KIT / "examples"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) here")
needs_m4 = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="no arm-none-eabi-gcc or no qemu-system-arm here",
)
KEY = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff"


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A daemon at one end of a line; the board's end, and the key that commands are sealed with."""
    folder = tmp_path_factory.mktemp("board")
    key = folder / "line.key"
    key.write_text(KEY)
    key.chmod(0o600)
    with PtyPair() as pair:
        link = f"serial:{pair.paths[0]}?key={key}&counter={folder / 'line.counter'}"
        config = folder / "magcal.toml"
        crafts = "".join(
            f'[[craft]]\nname = "{name}"\n[craft.sensor]\nnoise_nt = 100.0\n' for name in ("demo", "bad", "m4")
        )
        config.write_text(f"version = 1\nlink = {json.dumps(link)}\n{crafts}[output]\nstatus_period_s = 1.0\n")
        with DaemonProcess(config, folder / "daemon.log") as process:
            wait_for('"text": "serving', process.log)
            yield pair.paths[1], key


def told(result: subprocess.CompletedProcess[str]) -> dict[str, int]:
    """The counts that a board prints at its end."""
    assert result.returncode == 0, result.stdout + result.stderr
    return {name: int(count) for name, count in re.findall(r"([a-z_][a-z_ ]*):? (\d+)(?=[,\n])", result.stdout)}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The example board, built for this machine."""
    folder = tmp_path_factory.mktemp("built")
    subprocess.run(["make", "-s", "-C", str(KIT), f"BUILD={folder}", "board"], check=True)
    return str(folder / "board")


@needs_cc
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("demo abc", "SECONDS 'abc': a whole number from 1 to 10000000 is accepted"),
        ("demo -5", "SECONDS '-5': a whole number from 1 to 10000000 is accepted"),
        ("demo 99999999999999999999", "SECONDS '99999999999999999999': a whole number from 1 to 10000000 is accepted"),
        ("demo 60 -1", "SPEED '-1': a whole number from 0 to 1000000 is accepted"),
        ("demo 60 1x", "SPEED '1x': a whole number from 0 to 1000000 is accepted"),
        ("demo 60 0 xyz", "NOISE 'xyz': a whole number from 0 to 4294967295 is accepted"),
        ("demo 60 0 4294967296", "NOISE '4294967296': a whole number from 0 to 4294967295 is accepted"),
        ("de.mo", "CRAFT 'de.mo': 1 to 32 characters of A-Z a-z 0-9 _ - are accepted"),
        (33 * "c", f"CRAFT '{33 * 'c'}': 1 to 32 characters of A-Z a-z 0-9 _ - are accepted"),
        ("demo 60 0 0 /k -1", "COUNTER '-1': a whole number from 0 to 18446744073709551615 is accepted"),
        ("demo 60 0 0 /k", "6 arguments; accepted: board DEVICE [CRAFT [SECONDS [SPEED [NOISE [KEYFILE COUNTER]]]]]"),
    ],
)
def test_a_board_refuses_a_word_that_is_no_value_before_it_opens_the_line(board, words, said):
    done = subprocess.run([board, "/dev/absent", *words.split()], capture_output=True, text=True, timeout=10)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said + "\n")


@needs_cc
def test_a_board_says_how_it_is_used(board):
    done = subprocess.run([board, "--help"], capture_output=True, text=True, timeout=10)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: board DEVICE [CRAFT [SECONDS [SPEED [NOISE [KEYFILE COUNTER]]]]]\n")


@needs_cc
def test_a_board_gets_a_vector_for_each_sample_and_counts_the_noise_of_a_bad_cable(line, board):
    device, key = line
    common = {"capture_output": True, "text": True, "timeout": 60}
    first = subprocess.run([board, device, "bad", "60", "0", "2000", str(key), "1000"], **common)
    noisy = told(first)
    assert re.search(r"\n60 s: 600 samples, \d+ vectors, [a-z_]+, protection none yet, bias ", first.stdout)
    assert "\nusable vectors: none\n" in first.stdout
    assert noisy["bad"] > 10
    assert noisy["bad"] == noisy.get("bad_cobs", 0) + noisy.get("bad_crc", 0) + noisy.get("bad_length", 0)
    assert 0 < noisy["lost"] < noisy["frames"]
    assert 300 < noisy["vectors"] < 600
    clean = told(subprocess.run([board, device, "demo", "600", "0", "0", str(key), "2000"], **common))
    assert (clean["samples"], clean["vectors"], clean["replies"]) == (6000, 6000, 1)
    assert (clean["bad"], clean["lost"], clean["skipped"], clean["wrong"]) == (0, 0, 0, 0)
    assert clean["estimates"] > 550
    assert clean["usable vectors"] > 1000


@needs_m4
def test_the_board_runs_on_an_emulated_cortex_m4(line, tmp_path):
    device, _ = line
    subprocess.run(["make", "-s", "-C", str(KIT), f"BUILD={tmp_path}", "m4"], check=True)
    arguments = ",".join(f"arg={word}" for word in ("board", "m4", "6", "0", "0", KEY, "3000"))
    machine = ["qemu-system-arm", "-M", "mps2-an386", "-display", "none", "-monitor", "none", "-serial", device]
    semihosting = ["-semihosting-config", f"enable=on,target=native,{arguments}"]
    command = [*machine, *semihosting, "-kernel", str(tmp_path / "board-m4.elf")]
    counts = told(subprocess.run(command, capture_output=True, text=True, timeout=60))
    assert (counts["samples"], counts["vectors"], counts["replies"]) == (60, 60, 1)
    assert (counts["bad"], counts["lost"]) == (0, 0)


@needs_cc
@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler (c++) here")
def test_the_arduino_sketch_compiles_against_what_arduino_declares(tmp_path):
    (tmp_path / "Arduino.h").write_text(
        "#include <stdint.h>\n#include <stddef.h>\nenum { LOW, HIGH, OUTPUT, LED_BUILTIN = 13 };\n"
        "void pinMode(int, int); void digitalWrite(int, int); unsigned long millis(void);\n"
        "struct Port { void begin(long); int available(); int read(); size_t write(const uint8_t *, size_t); };\n"
        "extern Port Serial;\n"
    )
    sketch = EXAMPLES / "magcal_board" / "magcal_board.ino"
    flags = ["-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-include", "Arduino.h", "-x", "c++"]
    command = ["c++", *flags, f"-I{tmp_path}", f"-I{KIT}", str(sketch)]
    assert subprocess.run(command, capture_output=True, text=True).stderr == ""


def test_the_packages_name_the_headers_that_are_there():
    library = json.loads((KIT / "library.json").read_text())
    assert {name for name in library["headers"] if not (KIT / name).is_file()} == set()
    arduino = dict(row.split("=", 1) for row in (KIT / "library.properties").read_text().splitlines())
    assert (arduino["name"], arduino["version"]) == (library["name"], library["version"])
    assert (KIT / arduino["includes"]).is_file()
