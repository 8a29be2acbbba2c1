"""Passwords instead of client certificates: a wrong one or none stays out, and each name keeps to its role."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.links import Role
from tests.security.rogue_links import DEPLOY, Door, caller, command, door, make_certificates, sample, shipped

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")

PASSWORDS = {"feeder": "corn", "operator": "levers", "viewer": "glasses"}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_certificates(tmp_path_factory.mktemp("rogues") / "tls")
    users = folder / "users"
    users.write_text("".join(f"{name}:{password}\n" for name, password in PASSWORDS.items()))
    users.chmod(0o600)
    return folder


def client(certificates: Path, name: str, password: str = "") -> Path:
    """The shipped client configuration with a name and a password."""
    changes = {'"feeder"': f'"{name}"', "change me": password or PASSWORDS[name]}
    return shipped("zenoh-password-client.json5", certificates, certificates.parent / f"{name}.json5", **changes)


@pytest.fixture(scope="module")
def guarded(certificates: Path) -> Iterator[Door]:
    folder = certificates.parent
    service = shipped("zenoh-password.json5", certificates, folder / "service.json5")
    with door(folder, service, client(certificates, "viewer")) as found:
        yield found


def stays_out(guarded: Door, config: Path) -> None:
    """Somebody knocks, is counted and is not let in."""
    before = guarded.denied("password")
    with caller(guarded, config, Role.NODE) as rogue:
        guarded.until("the password is not counted", lambda: guarded.denied("password") > before)
        assert rogue.counters["up"] == 0
    guarded.rest()  # so that the next one's count is its own


@pytest.mark.parametrize(("name", "password"), [("feeder", "guess"), ("nobody", "guess")])
def test_a_wrong_password_or_name(guarded: Door, certificates: Path, name: str, password: str) -> None:
    """Whoever gives a wrong password, or a name that is not known, stays out and is counted."""
    stays_out(guarded, client(certificates, name, password))


def test_without_a_password(guarded: Door, certificates: Path, tmp_path: Path) -> None:
    """Whoever gives no name at all stays out and is counted."""
    text = client(certificates, "feeder").read_text()
    config = tmp_path / "without.json5"
    config.write_text(re.sub(r"auth: .*", "", text))
    stays_out(guarded, config)


def test_a_feeder_feeds_and_may_not_command(guarded: Door, certificates: Path) -> None:
    """The right password opens the door, and the rules of the name hold behind it."""
    with caller(guarded, client(certificates, "feeder"), Role.NODE) as feeder:
        guarded.until("the feeder is not connected", lambda: feeder.counters["up"] == 1)
        feeder.send(command())
        for number in range(20):
            feeder.send(sample(number))
        guarded.until("the samples are not accepted", lambda: guarded.counters.get("accepted", 0) >= 20)
        guarded.until("the command is not counted", lambda: guarded.denied("command") == 1)


def test_both_shipped_files_have_the_same_rules() -> None:
    """The rules for certificates and for passwords are the same; only who is who differs."""
    parts = []
    for name in ("zenoh-tls.json5", "zenoh-password.json5"):
        text = (DEPLOY / "config" / name).read_text()
        parts.append((text.partition("rules: [")[2].partition("// Who is who")[0], text.partition("policies: [")[2]))
    assert len(parts[0][0]) > 1000
    assert parts[0] == parts[1]
