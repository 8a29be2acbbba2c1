"""The systemd unit, judged by systemd itself, and the daemon's imports under the unit's strictest line."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit with its drop-ins, its program replaced by one that is installed here."""
    shutil.copytree(DEPLOY / "magcal.service.d", tmp_path / "magcal.service.d")
    text = (DEPLOY / "magcal.service").read_text()
    path = tmp_path / "magcal.service"
    path.write_text(re.sub(r"^ExecStart=\S+", f"ExecStart={shutil.which('true')}", text, flags=re.MULTILINE))
    return path


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", "--no-pager", *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def verified(unit: Path) -> str:
    """What ``systemd-analyze verify`` has to say; it exits 0 on a mistyped key, so silence is what counts."""
    done = analyze("verify", "--man=no", str(unit))
    return done.stdout + done.stderr + (f"exit {done.returncode}" if done.returncode else "")


@needs_systemd
def test_systemd_has_nothing_to_say_about_the_unit(unit: Path) -> None:
    assert verified(unit) == ""


@needs_systemd
@pytest.mark.parametrize(
    ("file", "line", "typo"),
    [
        ("magcal.service", "ProtectSystem=strict", "ProtectSytem=strict"),
        ("magcal.service", "WatchdogSec=30", "WatchdogSec=soon"),
        ("magcal.service.d/tls.conf", "LoadCredential=", "LoadCredentials="),
    ],
)
def test_a_typo_would_be_heard(unit: Path, file: str, line: str, typo: str) -> None:
    path = unit.parent / file
    text = path.read_text()
    path.write_text(text.replace(line, typo))
    assert line in text
    assert path.name in verified(unit)


@needs_systemd
def test_systemd_rates_the_unit_as_hardened() -> None:
    done = analyze("security", "--offline=yes", "--threshold=30", str(DEPLOY / "magcal.service"))
    assert done.returncode == 0, done.stdout + done.stderr


@needs_systemd
def test_an_unhardened_unit_would_fail_the_rating(tmp_path: Path) -> None:
    path = tmp_path / "magcal.service"
    path.write_text("[Service]\nExecStart=/bin/true\n")
    assert analyze("security", "--offline=yes", "--threshold=30", str(path)).returncode != 0


def test_the_unit_runs_the_documented_command() -> None:
    text = (DEPLOY / "magcal.service").read_text()
    assert "\nExecStart=/opt/magcal/bin/magcal run --config /etc/magcal/magcal.toml\n" in text


def test_the_key_that_systemd_hands_over_is_the_one_zenoh_reads() -> None:
    name = re.search(r"LoadCredential=([\w.]+):", (DEPLOY / "magcal.service.d/tls.conf").read_text())
    assert name is not None
    assert f'"/run/credentials/magcal.service/{name[1]}"' in (DEPLOY / "config/zenoh-tls.json5").read_text()


# prctl PR_SET_MDWE (Linux 6.3) does what MemoryDenyWriteExecute=yes asks for.
UNDER_MDWE = """
import ctypes, mmap, sys
if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0) != 0:
    sys.exit(77)
try:
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    sys.exit("memory is still writable and executable")
except PermissionError:
    pass
import msgpack, numpy, serial, zenoh
from cobs import cobs
config = zenoh.Config()
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
with zenoh.open(config):
    numpy.linalg.cholesky(numpy.eye(9))
"""


def test_the_daemons_imports_work_where_memory_is_never_both_writable_and_executable() -> None:
    done = subprocess.run([sys.executable, "-c", UNDER_MDWE], capture_output=True, text=True, timeout=60, check=False)
    if done.returncode == 77:
        pytest.skip("this kernel has no PR_SET_MDWE (Linux 6.3)")
    assert (done.returncode, done.stderr) == (0, "")
