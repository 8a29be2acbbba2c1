"""Settings that need more than a kind and limits: texts of a certain form, and settings that depend on each other."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final

from magcal_service.base.errors import LinkAddressError
from magcal_service.base.typed_toml import nearest
from magcal_service.base.typed_toml.record import Reading
from magcal_service.config.address import OUTPUT_SCHEMES, parse_address
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector

NAME_ACCEPTED: Final = "1 to 32 characters of A-Z a-z 0-9 _ - are accepted"

MIN_RATE_RPM: Final = 0.01  # slower turns are longer than an orbit

RANGE_NT: Final = (1000.0, 1e6)
"""Accepted full scales of a sensor [nT]: the Earth's field is 18 000 and more, and 1 mT is no magnetometer of it."""

_MAX_PORT: Final = 65_535  # a port has 16 bits

_AXIS_LENGTHS: Final = (1e-6, 1e6)
"""Accepted lengths of an axis given as a vector: outside, its direction is rounding or a mistake."""

_UNIT_LENGTH: Final = 1e-12
"""A vector this close to length 1 stays as it was written, bit for bit; some thousand roundings of a double."""

_AXES: Final[dict[str, Vector]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_METHOD: Final = re.compile(r"[a-z][a-z0-9-]{0,31}")
_LOOPBACK: Final = re.compile(r"(127\.[0-9]{1,3}\.[0-9]{1,3}\.[0-9]{1,3}|localhost|\[::1\]):([0-9]{1,5})")
_METRICS_ACCEPTED: Final = "a loopback address and port such as '127.0.0.1:9464'"


def check_link(reading: Reading, name: str, link: str) -> None:
    """The link's address has its form, and a known scheme that brings samples in."""
    try:
        scheme = parse_address(link).scheme
    except LinkAddressError as exc:
        reading.table.refuse(name, link, str(exc))
        return
    if scheme in OUTPUT_SCHEMES:
        reading.table.refuse(
            name, link, f"{scheme}: only sends; give the link that samples come from, and this one as [output] links"
        )


def output_links(reading: Reading, name: str) -> tuple[str, ...]:
    """Addresses of links that only send, each once."""
    table, outputs = reading.table, " and ".join(f"{scheme}:" for scheme in OUTPUT_SCHEMES)
    if not table.has(name):
        return ()
    links = table.content[name]
    accepted = f"an array of at most {MOST_OUTPUTS} addresses, each once, is accepted"
    if not isinstance(links, list) or not all(isinstance(link, str) for link in links):
        table.refuse(name, links, accepted)
        return ()
    if len(links) > MOST_OUTPUTS or len(set(links)) < len(links):
        table.refuse(name, links, accepted)
    for link in links:
        try:
            if parse_address(link).scheme not in OUTPUT_SCHEMES:
                table.refuse(name, link, f"{outputs} addresses are accepted, which only send")
        except LinkAddressError as exc:
            table.refuse(name, link, str(exc))
    return tuple(links)


def check_craft_name(reading: Reading, key: str, name: str) -> None:
    """A name as the wire carries it, each once in a file: ``context["names"]`` holds those before."""
    names: set[str] = reading.context["names"]
    if name in names:
        reading.table.refuse(key, name, "each craft needs a name of its own")
    elif reading.table.has(key) and not NAME.fullmatch(name):
        reading.table.refuse(key, name, NAME_ACCEPTED)
    names.add(name)


MOST_OUTPUTS: Final = 8
"""Links besides the main one: each costs every vector some 50 us before the next is looked at."""

RESERVED_SOURCE: Final = "magcal"
"""The source of the daemon's own results: of the craft's own magnetometer, so no other may be called that."""


def check_source(reading: Reading, key: str, source: str) -> None:
    """A name as the wire carries it, each once in a craft: ``context["sources"]`` holds those before."""
    sources: set[str] = reading.context["sources"]
    if source in sources:
        reading.table.refuse(key, source, "each magnetometer of a craft has a source of its own")
    elif source == RESERVED_SOURCE:
        reading.table.refuse(key, source, "any other name is accepted: this one is the daemon's own")
    elif reading.table.has(key) and not NAME.fullmatch(source):
        reading.table.refuse(key, source, NAME_ACCEPTED)
    sources.add(source)


def check_method(reading: Reading, name: str, method: str) -> None:
    """One of ``context["methods"]``; any well-formed name where none are given."""
    methods = reading.context.get("methods", ())
    if methods and method not in methods:
        reading.table.refuse(name, method, nearest(method, methods))
    elif not _METHOD.fullmatch(method):
        reading.table.refuse(name, method, "the name of an estimator such as 'ukf' is accepted")


def check_rate(reading: Reading, name: str, rate_rpm: float) -> None:
    """No rate below ``MIN_RATE_RPM``, where there would be no spin."""
    if abs(rate_rpm) < MIN_RATE_RPM:
        accepted = f"at least {MIN_RATE_RPM} either way; leave [craft.spin] out for no spin"
        reading.table.refuse(name, rate_rpm, accepted)


def check_start_max(reading: Reading, name: str, start_max_s: float) -> None:
    """The start's second stage begins after its first."""
    _at_least(reading, name, start_max_s, "start_s")


def check_disturbance(reading: Reading, name: str, disturbance_nt: float) -> None:
    """No protection level is below it: above the limit of the level, no estimate would ever be trusted."""
    limit = reading.values["protection_nt"]
    if reading.values["protection"] and disturbance_nt > limit:
        reading.table.refuse(
            name, disturbance_nt, f"at most protection_nt ({limit:g}) is accepted; raise protection_nt"
        )


def check_late(reading: Reading, name: str, late_s: float) -> None:
    """No sample is a clock step while its tick may still be open."""
    _at_least(reading, name, late_s, "hold_s")


def check_step_confirm(reading: Reading, name: str, step_confirm_s: float) -> None:
    """A jump that has to be confirmed is a gap as well."""
    _at_least(reading, name, step_confirm_s, "gap_s")


def _at_least(reading: Reading, name: str, value: float, other: str) -> None:
    least: float = reading.values[other]
    if value < least:
        reading.table.refuse(name, value, f"at least {other} = {least:g} is accepted")


def check_total(reading: Reading, name: str, total_mb: float | None) -> None:
    """Room for the file that is written and the one before it."""
    file_mb: float = reading.values["file_mb"]
    if total_mb is not None and total_mb < 2.0 * file_mb:
        reading.table.refuse(name, total_mb, f"at least twice file_mb = {file_mb:g} is accepted")


def axis(reading: Reading, name: str) -> Vector:
    """``"x"``, ``"y"``, ``"z"`` or a body vector of any length; a unit vector comes back."""
    table = reading.table
    if not isinstance(table.content.get(name), list):
        letter = table.text(name, "z")
        if letter not in _AXES:
            table.refuse(name, letter, 'a body vector such as [-0.20, -0.98, -0.03] or "x", "y", "z" is accepted')
        return _AXES.get(letter, _AXES["z"])
    x, y, z = table.numbers(name, 3) or _AXES["z"]
    length = math.hypot(x, y, z)
    shortest, longest = _AXIS_LENGTHS
    if not shortest <= length <= longest:
        table.refuse(name, [x, y, z], "a vector of length 1e-6 to 1e6 is accepted (its length does not matter)")
        return _AXES["z"]
    if abs(length - 1.0) < _UNIT_LENGTH:
        return (x, y, z)
    return (x / length, y / length, z / length)


def csv_file(reading: Reading, name: str) -> Path | None:
    """A file's name; None where it is left out."""
    table = reading.table
    text = table.text(name, "", accepted="a file name")
    if isinstance(table.content.get(name), str) and not text.strip():
        table.refuse(name, text, "a file name is accepted; leave it out for no file")
    return Path(text) if text else None


def recordings_directory(reading: Reading, name: str) -> Path:
    """The folder of ``[record]``."""
    return _directory(reading, name, "the folder that recordings go to", "[record]")


def checkpoints_directory(reading: Reading, name: str) -> Path:
    """The folder of ``[state]``."""
    return _directory(reading, name, "the folder that checkpoints go to", "[state]")


def _directory(reading: Reading, name: str, accepted: str, section: str) -> Path:
    """A section's folder, which may not be empty."""
    text = reading.table.text(name, accepted=accepted)
    if not text.strip() and isinstance(reading.table.content.get(name), str):
        reading.table.refuse(name, text, f"{accepted} is accepted; leave {section} out for none")
    return Path(text)


def checkpoints_key(reading: Reading, name: str) -> Path | None:
    """The file of the key that checkpoints are signed with."""
    accepted = "a file with a key in hexadecimal, that its owner alone can read"
    text = reading.table.text(name, "", accepted=accepted)
    if text.strip():
        return Path(text)
    if isinstance(reading.table.content.get(name), str):
        reading.table.refuse(name, text, f"{accepted} is accepted; leave it out for none")
    return None


def checkpoints_counters(reading: Reading, name: str) -> Path | None:
    """The folder that keeps old checkpoints from being played again: of no use without a key."""
    content = reading.table.content
    accepted = "a folder outside that of the checkpoints, together with their key,"
    text = reading.table.text(name, "", accepted=accepted)
    if not isinstance(content.get(name), str):
        return None
    if not text.strip() or "key" not in content:
        reading.table.refuse(name, text, f"{accepted} is accepted; leave it out for none")
    return Path(text)


def metrics_address(reading: Reading, name: str) -> str | None:
    """A loopback address and port: what the text says about the craft is not for the network."""
    text = reading.table.text(name, "", accepted=_METRICS_ACCEPTED)
    match = _LOOPBACK.fullmatch(text)
    if isinstance(reading.table.content.get(name), str) and (match is None or int(match[2]) > _MAX_PORT):
        reading.table.refuse(name, text, f"{_METRICS_ACCEPTED} is accepted")
    return text or None
