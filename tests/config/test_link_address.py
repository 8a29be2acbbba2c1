"""Addresses: what is accepted, and how the rest is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from magcal_service.base.errors import LinkAddressError
from magcal_service.links import Role, open_link, parse_address


def test_an_address_is_split_into_scheme_rest_and_options() -> None:
    address = parse_address("serial:/dev/ttyUSB0?baud=9600&note=a%26b%3Dc")
    assert (address.scheme, address.rest) == ("serial", "/dev/ttyUSB0")
    assert (address.integer("baud", 0, 0, 10**6), address.text_of("note", "")) == (9600, "a&b=c")
    address.finish()


def test_an_option_that_is_absent_has_its_default() -> None:
    address = parse_address("loop:x")
    assert address.integer("queue", 7, 1, 9) == 7
    assert address.real("speed", 1.5, 0.0, 9.0) == 1.5
    assert address.flag("samples", True) is True
    assert address.choice("mode", ("a", "b"), "b") == "b"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no scheme"),
        ("/dev/ttyUSB0", "no scheme"),
        ("Zenoh:x", "no scheme"),
        ("loop:x?queue", "'queue'"),
        ("loop:x?queue=", "'queue='"),
        ("loop:x?=3", "'=3'"),
        ("loop:x?Queue=3", "'Queue=3'"),
        ("loop:x?queue=3&&a=1", "''"),
        ("loop:x?queue=3&queue=3", "each option once"),
        ("loop://x", "without the two slashes"),
        ("loop:x\n?queue=3", "printable"),
        ("loop:" + "x" * 5000, "at most 4096"),
    ],
)
def test_a_malformed_address_is_refused(text: str, named: str) -> None:
    with pytest.raises(LinkAddressError, match=named):
        parse_address(text)


@pytest.mark.parametrize("value", ["0", "11", "-1", "1.5", "ten", "1e1", "١"])
def test_a_number_outside_its_limits_or_no_number_is_refused(value: str) -> None:
    with pytest.raises(LinkAddressError, match="from 1 to 10"):
        parse_address(f"loop:x?queue={value}").integer("queue", 5, 1, 10)


@pytest.mark.parametrize("value", ["nan", "inf", "-0.1", "1_0x"])
def test_a_real_that_is_not_finite_or_outside_is_refused(value: str) -> None:
    with pytest.raises(LinkAddressError, match="from 0 to 10"):
        parse_address(f"loop:x?speed={value}").real("speed", 5.0, 0.0, 10.0)


def test_an_option_nobody_read_is_refused_with_the_nearest_known() -> None:
    address = parse_address("loop:x?qeue=3")
    address.integer("queue", 1, 1, 9)
    with pytest.raises(LinkAddressError, match=r"'qeue'.*did you mean 'queue'"):
        address.finish()


def test_an_unknown_scheme_is_refused_with_the_nearest() -> None:
    with pytest.raises(LinkAddressError, match="did you mean 'serial'"):
        parse_address("serail:/dev/ttyUSB0")
    with pytest.raises(LinkAddressError, match="known: ccsds, loop, recording, serial, zenoh"):
        open_link("carrier-pigeon".replace("-", "") + ":x", Role.SERVICE)


@pytest.mark.parametrize(
    ("address", "absent"),
    [
        ("loop:x", "zenoh serial magcal_service.links.ccsds"),
        ("serial:/dev/none", "zenoh"),
        ("ccsds:udp/127.0.0.1:9", "zenoh serial numpy xml"),
    ],
)
def test_a_link_imports_only_what_it_needs(address: str, absent: str) -> None:
    code = (
        "import sys; from magcal_service.links import Role, open_link\n"
        f"open_link({address!r}, Role.SERVICE).close()\n"
        f"sys.exit(any(name in sys.modules for name in {absent!r}.split()))"
    )
    root = Path(__file__).resolve().parents[2]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False, capture_output=True).returncode == 0
