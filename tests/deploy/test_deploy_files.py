"""Every shipped configuration is loaded by what will read it, and the router runs."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zenoh

from magcal_service.config.reader import load_config
from magcal_service.links import Role, open_link, parse_address
from magcal_service.links.zenoh_settings import ZenohSettings
from magcal_service.wire.messages import MagnetometerSample

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
TOML = sorted((DEPLOY / "config").glob("*.toml"))
JSON5 = sorted((DEPLOY / "config").glob("*.json5"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_all_the_promised_configurations_are_there() -> None:
    assert {path.stem for path in TOML} == {"serial", "zenoh-peer", "zenoh-router", "zenoh-tls", "zenoh-password"}
    assert {path.stem for path in JSON5} == {
        *("router", "zenoh-tls", "zenoh-tls-client", "zenoh-password", "zenoh-password-client"),
    }


@pytest.mark.parametrize("path", TOML, ids=lambda path: path.stem)
def test_each_daemon_configuration_loads(path: Path) -> None:
    assert load_config(path).crafts


@pytest.mark.parametrize("path", JSON5, ids=lambda path: path.stem)
def test_each_zenoh_configuration_loads_and_scouts_nobody(path: Path) -> None:
    config = zenoh.Config.from_file(str(path))
    scouting = [config.get_json(f"scouting/{way}/enabled") for way in ("multicast", "gossip")]
    assert (scouting, config.get_json("timestamping/enabled")) == (["false", "false"], "true")


@pytest.mark.parametrize("path", [path for path in TOML if "zenoh" in path.stem], ids=lambda path: path.stem)
def test_the_link_of_each_zenoh_configuration_is_one_the_link_accepts(path: Path) -> None:
    link = load_config(path).link.replace("/etc/magcal/zenoh", str(DEPLOY / "config/zenoh"))
    address = parse_address(link)
    config = ZenohSettings.read(address, Role.SERVICE).session_config(address)
    endpoints = [str(config.get_json(f"{way}/endpoints")) for way in ("listen", "connect")]
    assert any("127.0.0.1:7447" in endpoint for endpoint in endpoints)


def test_the_link_of_the_serial_configuration_opens_on_a_line() -> None:
    ours, theirs = os.openpty()
    try:
        link = load_config(DEPLOY / "config/serial.toml").link.replace("/dev/magcal-sensor", os.ttyname(theirs))
        with open_link(link, Role.SERVICE, crafts=["demo"]) as opened:
            opened.receive(0.2)
            assert opened.counters["up"] == 1
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize("path", TOML, ids=lambda path: path.stem)
def test_each_configuration_keeps_to_this_machine(path: Path) -> None:
    assert re.fullmatch(r"(zenoh:\w+/127\.0\.0\.1:7447|serial:/dev/magcal-sensor)\?\S*", load_config(path).link)


@pytest.fixture
def router() -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The shipped router in a process of its own, open on a port of its own."""
    port = free_port()
    command = [sys.executable, str(DEPLOY / "router.py"), "--listen", f"tcp/127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "router open\n"
        yield process, port
        process.kill()


def test_the_router_carries_samples_between_its_clients(router: tuple[subprocess.Popen[str], int]) -> None:
    _, port = router
    sample = MagnetometerSample(craft="spinner", source="mag", sequence=0, time_ns=0, field_body_nt=(1.0, 2.0, 3.0))
    options = load_config(DEPLOY / "config/zenoh-router.toml").link.partition("?")[2]
    with (
        closing(open_link(f"zenoh:tcp/127.0.0.1:{port}?{options}", Role.SERVICE, crafts=["spinner"])) as service,
        closing(open_link(f"zenoh:tcp/127.0.0.1:{port}", Role.NODE, crafts=["spinner"])) as node,
    ):
        received = []
        for _ in range(50):
            node.send(sample)
            received += service.receive(0.2)
            if received:
                break
    assert received[:1] == [sample]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_router_ends_by_itself_on_a_signal(router: tuple[subprocess.Popen[str], int], number: int) -> None:
    process, _ = router
    process.send_signal(number)
    assert process.wait(10) == 0


def test_a_router_without_its_configuration_says_so_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, str(DEPLOY / "router.py"), "--config", str(tmp_path / "absent.json5")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"router: No such file or directory.*; check the file and .*\n", done.stderr)


def container_lines(instruction: str) -> list[str]:
    text = (DEPLOY / "Containerfile").read_text()
    return re.findall(rf"^{instruction} (.*)$", text, flags=re.MULTILINE)


def test_the_container_copies_only_what_is_there() -> None:
    sources = [word for line in container_lines("COPY") if "--from" not in line for word in line.split()[:-1]]
    assert [source for source in sources if source != "README.md" and not (ROOT / source).exists()] == []


def test_the_container_runs_the_daemon_without_rights_or_extras() -> None:
    assert container_lines("USER") == ["65532:65532"]
    assert container_lines("FROM")[-1] == "python:3.11-slim"
    assert not re.search(r"\[(sim|view|dev|diagnosis|cluster)", (DEPLOY / "Containerfile").read_text())


def test_the_container_reads_the_configuration_it_is_given() -> None:
    target = next(line.split()[1] for line in container_lines("COPY") if line.startswith("deploy/config/"))
    assert target in container_lines("CMD")[0]


RULE = re.compile(r'^[A-Z]+(\{[A-Za-z_]+\})?(==|!=|\+=|-=|:=|=)"[^"]*"$')
RULE_KEYS = {
    "ACTION", "ATTR", "ATTRS", "DRIVER", "ENV", "GOTO", "GROUP", "LABEL", "MODE", "SUBSYSTEM", "SUBSYSTEMS", "SYMLINK",
}  # fmt: skip


def rules() -> list[str]:
    text = (DEPLOY / "70-magcal-sensor.rules").read_text()
    return [line for line in text.splitlines() if line and not line.startswith("#")]


@pytest.mark.parametrize("rule", rules())
def test_each_udev_rule_is_well_formed(rule: str) -> None:
    for part in rule.split(", "):
        assert RULE.fullmatch(part), part
        assert re.split(r"[{=!+:-]", part)[0] in RULE_KEYS


def test_the_udev_rules_jump_only_to_their_own_label() -> None:
    text = "\n".join(rules())
    assert set(re.findall(r'GOTO="(\w+)"', text)) == set(re.findall(r'LABEL="(\w+)"', text))


def test_the_udev_rule_gives_the_name_and_group_that_daemon_and_unit_use() -> None:
    text = "\n".join(rules())
    name, group = re.findall(r'SYMLINK\+="([^"]+)"', text), re.findall(r'GROUP="([^"]+)"', text)
    assert f"/dev/{name[0]}?" in load_config(DEPLOY / "config/serial.toml").link
    assert f"SupplementaryGroups={group[0]}\n" in (DEPLOY / "magcal.service").read_text()


def udevadm_verifies() -> bool:
    """Whether udevadm is there and new enough (systemd 254) to verify rules."""
    if shutil.which("udevadm") is None:
        return False
    done = subprocess.run(["udevadm", "verify", "--help"], capture_output=True, timeout=30, check=False)
    return done.returncode == 0


@pytest.mark.skipif(not udevadm_verifies(), reason="udevadm verify is not installed (systemd 254 or later)")
def test_udevadm_finds_no_fault_in_the_rules() -> None:
    command = ["udevadm", "verify", "--no-summary", str(DEPLOY / "70-magcal-sensor.rules")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_readme_lists_every_file_there_is() -> None:
    named = set(re.findall(r"`([\w./-]+)`", (DEPLOY / "README.md").read_text()))
    files = {str(path.relative_to(DEPLOY)) for path in DEPLOY.rglob("*") if path.is_file()}
    others = ("__pycache__", "node_modules")  # made by running and by `npm install`
    ours = {file for file in files if not file.startswith("firmware/") and not any(one in file for one in others)}
    assert ours - named == {"README.md"}


@pytest.mark.parametrize("document", ["docs/deploy.md", "deploy/README.md"])
def test_every_file_that_the_documents_name_is_there(document: str) -> None:
    path = ROOT / document
    text = path.read_text()
    named = [path.parent / link for link in re.findall(r"\]\(([^)#:]+)\)", text)]
    named += [ROOT / name for name in re.findall(r"\bdeploy/[\w./-]+\w", text.replace("../deploy", ""))]
    assert [name for name in named if not name.exists()] == []
