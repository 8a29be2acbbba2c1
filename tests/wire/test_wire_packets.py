"""Space packets and their XTCE: read back by another program, space-packet-parser, for every message there can be."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.config.address import parse_address
from magcal_service.links.ccsds import DEFAULT_ADDRESS, apids_of
from magcal_service.wire.fields import TEXT_BYTES
from magcal_service.wire.kinds import KIND_BY_CODE, MAX_COUNTERS, kind_of
from magcal_service.wire.messages import Message, Status, Verdict
from magcal_service.wire.packets import HEALTH, PARAMETERS, SENT, pack, values_of
from magcal_service.wire.space_packet import MAX_UDP_BYTES, cuc, space_packet
from magcal_service.wire.xtce import names_of, xtce
from tests.links.link_messages import RESULTS, sample
from tests.wire.wire_cases import BY_KIND

YAMCS: Final = Path(__file__).resolve().parents[2] / "deploy/yamcs"
APIDS: Final = apids_of(parse_address(DEFAULT_ADDRESS))


@pytest.fixture(scope="module")
def definition() -> Any:
    definitions = pytest.importorskip("space_packet_parser.xtce.definitions")
    return definitions.XtcePacketDefinition.from_xtce(YAMCS / "mdb/magcal.xml")


def packet(message: Message, count: int = 0) -> bytes:
    return space_packet(APIDS[kind_of(message).code], count, message.time_ns, pack(message))


def test_the_file_for_yamcs_is_what_the_table_of_the_wire_gives() -> None:
    """`magcal xtce --out deploy/yamcs/mdb/magcal.xml` makes it anew."""
    assert (YAMCS / "mdb/magcal.xml").read_text(encoding="utf-8") == xtce(APIDS)


def test_the_instance_of_yamcs_takes_the_packets_whole_and_where_they_are_sent_to() -> None:
    settings = (YAMCS / "etc/yamcs.magcal.yaml").read_text(encoding="utf-8")
    found = dict(re.findall(r"(port|maxLength|pktTimeOffset|file): ([\w./]+)", settings))
    port = DEFAULT_ADDRESS.rpartition(":")[2]
    assert found == {"port": port, "maxLength": str(MAX_UDP_BYTES), "pktTimeOffset": "6", "file": "mdb/magcal.xml"}


def test_the_xtce_keeps_to_the_schema_of_the_omg() -> None:
    validation = pytest.importorskip("space_packet_parser.xtce.validation")
    assert validation.validate_xtce(YAMCS / "mdb/magcal.xml").errors == []


@settings(max_examples=60, deadline=None)
@given(message=st.one_of(*(BY_KIND[KIND_BY_CODE[code].name] for code in SENT)))
def test_another_program_reads_what_was_packed(message: Message, definition: Any) -> None:
    read = definition.parse_bytes(packet(message))
    kind = kind_of(message)
    for name, parameter, value in zip(names_of(kind), PARAMETERS[kind.code], values_of(message), strict=True):
        found = read[name].raw_value if parameter.labels else read[name]
        assert found == value or (math.isnan(value) and math.isnan(found)), name


def test_enumerations_carry_the_words_of_the_wire(definition: Any) -> None:
    for message in RESULTS[:3]:
        read = definition.parse_bytes(packet(message))
        name = kind_of(message).name
        assert str(read[f"{name}_verdict"]) == str(message.verdict)
        assert str(read[f"{name}_clock"]) == "utc"
    assert str(definition.parse_bytes(packet(RESULTS[3]))["reply_accepted"]) == "yes"


def test_the_parameters_of_an_estimate_have_their_names_and_units() -> None:
    units = {parameter.name: parameter.unit for parameter in PARAMETERS[17]}
    assert [units[name] for name in ("bias_x_nt", "protection_nt", "D11", "time_ns")] == ["nT", "nT", "", "ns"]
    assert {"covariance_bx_bx", "covariance_by_D23", "covariance_D23_D23", "protection_by", "reasons"} <= units.keys()
    assert [parameter.name for parameter in PARAMETERS[17]][:6] == [
        "schema_version", "craft", "source", "sequence", "time_ns", "clock",
    ]  # fmt: skip


def test_a_status_shows_its_health_as_numbers_and_every_counter_as_text() -> None:
    status = Status(
        craft="a", source="b", sequence=0, time_ns=0, uptime_s=1.0, verdict=Verdict.TRUSTED,
        counters={"ticks": 7, "link.lost": 2, "output.sent": 9},
    )  # fmt: skip
    values = dict(zip(names_of(KIND_BY_CODE[18]), values_of(status), strict=True))
    assert (values["status_ticks"], values["status_link_lost"], values["status_troubles"]) == (7, 2, 0)
    assert values["status_counters"] == "link.lost=2 output.sent=9 ticks=7"


def test_the_largest_message_is_far_below_a_datagram() -> None:
    largest = Status(
        craft="c" * 32, source="s" * 32, sequence=2**32 - 1, time_ns=2**63 - 1, uptime_s=1e12, verdict=Verdict.DOUBTFUL,
        counters={f"{number:064d}": 2**53 - 1 for number in range(MAX_COUNTERS)}, text="t" * TEXT_BYTES,
    )  # fmt: skip
    assert len(packet(largest)) == 11_228 < MAX_UDP_BYTES


def test_a_packet_begins_with_the_headers_of_the_standard() -> None:
    first = space_packet(0x123, 3, 1_500_000_000, b"\xaa")
    assert first.hex() == "0923c00300082f00000001800000aa"
    assert space_packet(0x123, 16_384, 0, b"\xaa")[2:4].hex() == "c000"


@given(time_ns=st.integers(0, 2**32 * 1_000_000_000 - 1))
def test_the_time_of_the_header_is_within_60_ns(time_ns: int) -> None:
    octets = cuc(time_ns)
    ticks = int.from_bytes(octets[1:], "big")
    assert octets[0] == 0x2F
    assert 0 <= time_ns * 2**24 - ticks * 10**9 < 10**9


@pytest.mark.parametrize(("time_ns", "octets"), [(-1, "00" * 7), (2**63 - 1, "ff" * 7)])
def test_a_time_that_the_header_cannot_hold_is_its_first_or_last_moment(time_ns: int, octets: str) -> None:
    assert cuc(time_ns).hex() == "2f" + octets


def test_what_comes_in_is_not_sent() -> None:
    with pytest.raises(DecodeError, match="a magnetometer is not sent in space packets; calibrated, estimate, status"):
        pack(sample(0))


def test_health_is_named_after_counters_that_there_are() -> None:
    text = (YAMCS.parents[1] / "docs/health.md").read_text(encoding="utf-8")
    shown = text + (YAMCS.parents[1] / "docs/links.md").read_text(encoding="utf-8")
    for name in HEALTH:
        assert f"`{name.removeprefix('link.')}`" in shown, name


def test_every_kind_that_the_daemon_sends_has_a_packet() -> None:
    assert {type(message) for message in RESULTS} == {KIND_BY_CODE[code].record for code in SENT}
