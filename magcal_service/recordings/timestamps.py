"""Time cells to whole nanoseconds, digit by digit: no float comes near them."""

from __future__ import annotations

import datetime
import re
from decimal import Context, Decimal

NS_PER_S = 1_000_000_000  # nanoseconds in a second
MAX_TIME_NS = 2**63 - 1
"""Times beyond +-292 years do not fit the record's int64 and are refused as absurd."""

_MAX_CHARACTERS = 100
"""Of a rare form of a number: far more than any log writes, and few enough for exact arithmetic to be quick."""

_EXACT = Context(prec=2 * _MAX_CHARACTERS)

_EPOCH_DAY = datetime.date(1970, 1, 1).toordinal()
_DECIMAL = re.compile(r"([+-]?)(\d{1,18})(?:\.(\d{0,9}))?", re.ASCII)
_ANY_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_ISO8601 = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)[Tt ](\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d+))?)?\s*(Z|z|UTC|[+-]\d\d(?::?\d\d)?)?", re.ASCII
)


def decimal_to_ns(text: str, decimals: int) -> int | None:
    """A decimal number of a unit that is 10**``decimals`` ns, to the nearest nanosecond; None where it is none."""
    text = text.strip()
    match = _DECIMAL.fullmatch(text)
    if match is None or len(match.group(3) or "") > decimals:
        return _any_decimal_to_ns(text, decimals)
    sign, whole, fraction = match.groups()
    value: int = int(whole) * 10**decimals + (int(fraction.ljust(decimals, "0")) if fraction else 0)
    return -value if sign == "-" else value


def _any_decimal_to_ns(text: str, decimals: int) -> int | None:
    """The rare forms: exponents, and more digits than nanoseconds (rounded half to even)."""
    if len(text) > _MAX_CHARACTERS or not _ANY_DECIMAL.fullmatch(text):
        return None
    return int(Decimal(text).scaleb(decimals, _EXACT).to_integral_value(context=_EXACT))


def days_to_ns(text: str, epoch: Decimal) -> int | None:
    """A decimal number of days to the nearest nanosecond since day ``epoch``; None where it is no finite number."""
    text = text.strip()
    if len(text) > _MAX_CHARACTERS or not _ANY_DECIMAL.fullmatch(text):
        return None
    days = _EXACT.subtract(Decimal(text), epoch)
    return int(_EXACT.multiply(days, Decimal(86400 * NS_PER_S)).to_integral_value(context=_EXACT))


def iso8601_to_ns(text: str) -> int | None:
    """An ISO 8601 instant to nanoseconds since 1970-01-01 UTC; None where it is none.

    A space may stand for the T, ``-`` and ``:`` may be absent, the fraction may have any length (rounded to the
    nanosecond), and no zone means UTC.  A leap second 23:59:60 is the same instant as the midnight after it, as in
    Unix time.
    """
    match = _ISO8601.fullmatch(text.strip())
    if match is None:
        return None
    year, month, day, hour, minute, second, fraction, zone = match.groups()
    try:
        days = datetime.date(int(year), int(month), int(day)).toordinal() - _EPOCH_DAY
    except ValueError:
        return None
    hours, minutes, seconds = int(hour), int(minute), int(second or 0)
    if hours > 23 or minutes > 59 or seconds > 60 or (seconds == 60 and minutes != 59):
        return None
    offset_s = _zone_s(zone)
    if offset_s is None:
        return None
    whole_s = days * 86400 + hours * 3600 + minutes * 60 + seconds - offset_s
    return whole_s * NS_PER_S + _fraction_ns(fraction or "")


def _fraction_ns(digits: str) -> int:
    if len(digits) <= 9:
        return int(digits.ljust(9, "0"))
    return int(Decimal(f"0.{digits[:_MAX_CHARACTERS]}").scaleb(9, _EXACT).to_integral_value(context=_EXACT))


def _zone_s(zone: str | None) -> int | None:
    """Offset of a zone from UTC [s]; None where it is out of range."""
    if zone is None or zone in {"Z", "z", "UTC"}:
        return 0
    digits = zone[1:].replace(":", "")
    hours, minutes = int(digits[:2]), int(digits[2:] or 0)
    if hours > 23 or minutes > 59:
        return None
    return (-1 if zone[0] == "-" else 1) * (hours * 3600 + minutes * 60)


def ns_to_seconds(time_ns: int) -> str:
    """Nanoseconds as decimal seconds with nine places, the exact inverse of ``decimal_to_ns`` with 9 decimals."""
    whole, rest = divmod(abs(time_ns), NS_PER_S)
    return f"{'-' if time_ns < 0 else ''}{whole}.{rest:09d}"


def ns_to_iso8601(time_ns: int) -> str:
    """Nanoseconds since 1970-01-01 UTC as ``2025-06-01T00:00:00.000000000Z``; ``iso8601_to_ns`` is its inverse."""
    whole, rest = divmod(time_ns, NS_PER_S)
    instant = datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=whole)
    return f"{instant.isoformat(timespec='seconds')}.{rest:09d}Z"
