import datetime
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.recordings.timestamps import decimal_to_ns, iso8601_to_ns, ns_to_iso8601, ns_to_seconds

INT64 = st.integers(-(2**63) + 1, 2**63 - 1)
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


@given(INT64)
def test_seconds_written_and_read_are_the_same_nanosecond(time_ns: int) -> None:
    assert decimal_to_ns(ns_to_seconds(time_ns), 9) == time_ns


@given(INT64)
def test_iso8601_written_and_read_is_the_same_nanosecond(time_ns: int) -> None:
    assert iso8601_to_ns(ns_to_iso8601(time_ns)) == time_ns


@given(st.decimals(min_value=-(10**9), max_value=10**9, allow_nan=False, allow_infinity=False, places=14))
def test_seconds_are_rounded_to_the_nearest_nanosecond(value: object) -> None:
    assert decimal_to_ns(f"{value:f}", 9) == round(Fraction(str(value)) * 10**9)


@given(st.datetimes(datetime.datetime(1700, 1, 1), datetime.datetime(2250, 1, 1), timezones=st.just(datetime.UTC)))
def test_iso8601_agrees_with_the_standard_library(instant: datetime.datetime) -> None:
    assert iso8601_to_ns(instant.isoformat()) == (instant - EPOCH) // datetime.timedelta(microseconds=1) * 1000


@given(st.floats(-1e9, 1e9))
def test_every_way_python_writes_a_float_is_read(value: float) -> None:
    assert decimal_to_ns(repr(value), 9) == round(Fraction(repr(value)) * 10**9)


@given(st.text(max_size=30))
def test_no_text_raises(text: str) -> None:
    for ns in (decimal_to_ns(text, 9), iso8601_to_ns(text)):
        assert ns is None or isinstance(ns, int)


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-01 00:00:01.5", 1_500_000_000),
        ("1970-01-01T00:00:00.000000001Z", 1),
        ("1970-01-01T00:00:00.0000000016Z", 2),
        ("19700101T000100Z", 60_000_000_000),
        ("1970-01-01T00:01", 60_000_000_000),
        ("1970-01-01T01:00:00+01:00", 0),
        ("1969-12-31T19:30:00-0430", 0),
        ("1970-01-01T00:00:00 UTC", 0),
        ("  1970-01-01t00:00:00,25z ", 250_000_000),
        ("2016-12-31T23:59:60Z", 1_483_228_800_000_000_000),
        ("2025-06-01T12:34:56.123456789Z", 1_748_781_296_123_456_789),
    ],
)
def test_iso8601_forms_are_read_exactly(text: str, time_ns: int) -> None:
    assert iso8601_to_ns(text) == time_ns


@pytest.mark.parametrize(
    "text",
    [
        "",
        "yesterday",
        "2025-06-01",
        "2025-02-30T00:00:00Z",
        "2025-13-01T00:00:00Z",
        "2025-06-01T24:00:00Z",
        "2025-06-01T00:60:00Z",
        "2025-06-01T00:00:61Z",
        "2025-06-01T00:00:00+25:00",
        "1700000000.0",
        "０",
    ],
)
def test_what_is_no_instant_is_none(text: str) -> None:
    assert iso8601_to_ns(text) is None


@pytest.mark.parametrize("text", ["", "nan", "inf", "1_000", "0x10", "1.2.3", "1e9999", "--1", "1,5", "१"])
def test_what_is_no_number_of_seconds_is_none(text: str) -> None:
    assert decimal_to_ns(text, 9) is None


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1692888249.0", 1_692_888_249_000_000_000),
        ("-0.25", -250_000_000),
        ("1.6928882495e9", 1_692_888_249_500_000_000),
        (".5", 500_000_000),
        ("7.", 7_000_000_000),
        ("+3", 3_000_000_000),
        ("0.1234567895", 123_456_790),
    ],
)
def test_seconds_forms_are_read_exactly(text: str, time_ns: int) -> None:
    assert decimal_to_ns(text, 9) == time_ns
