"""One declared dataclass, read from tables that are right and wrong in every way a declaration can say."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from enum import StrEnum
from typing import Any

import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.base.typed_toml import Table, parse_toml
from magcal_service.base.typed_toml.keys import (
    choice,
    defaulted_section,
    flag,
    inline,
    number,
    numbers,
    optional_choice,
    section,
    sections,
    special,
    text,
    texts,
    whole,
)
from magcal_service.base.typed_toml.record import REQUIRED, Limits, Reading, declared, read_record
from magcal_service.base.typed_toml.table import nearest


class Colour(StrEnum):
    """Two of them."""

    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Inner:
    """A table of one key."""

    size: float = number(2.0, 1.0, 3.0)


@dataclass(frozen=True)
class Needy:
    """A table whose key must be there."""

    size: float = number(minimum=1.0)


def _check_high(reading: Reading, name: str, high: float) -> None:
    if high < reading.values["low"]:
        reading.table.refuse(name, high, f"at least {reading.context.get('word', 'low')}")


@dataclass(frozen=True)
class Part:
    """Keys of the table around it."""

    beside: bool = flag(True)


@dataclass(frozen=True)
class Record:
    """One field of each kind."""

    given: str
    low: float = number(1.0, 0.0, 10.0, unit="nT")
    high: float = number(5.0, 0.0, 10.0, check=_check_high)
    maybe: float | None = number(None, 0.0, 1.0)
    turn: float = number(1.0, name="turn_deg", convert=lambda degrees: degrees * 2.0)
    count: int = whole(3, 1, 9)
    on: bool = flag(False)
    label: str = text("none")
    colour: Colour = choice(Colour, Colour.BLUE)
    tint: Colour | None = optional_choice(Colour)
    three: tuple[float, ...] = numbers(3, (0.0, 0.0, 0.0), -1.0, 1.0)
    inner: Inner = defaulted_section(Inner)
    option: Inner | None = section(Inner, None)
    many: tuple[Inner, ...] = sections(Inner)
    part: Part = inline(Part)
    own: Any = special(lambda reading, name: reading.table.has(name), False)


def read(content: str, kind: type[Any] = Record, **context: str) -> tuple[Any, list[str]]:
    """The record and the faults of a table."""
    table = parse_toml(content.encode(), "file", "file", ConfigError)
    record = read_record(table, kind, {"given": "g"} if kind is Record else None, context)
    return record, [str(fault) for fault in table.faults]


def test_an_empty_table_gives_the_dataclasss_own_defaults() -> None:
    assert read("") == (Record("g"), [])


FULL = """
low = 2
high = 3.5
maybe = 0.5
turn_deg = 4
count = 7
on = true
label = "l"
colour = "red"
tint = "blue"
three = [1, 0, -1]
own = 0
beside = false
[inner]
size = 3
[option]
size = 1
[[many]]
size = 1.5
[[many]]
"""


def test_every_kind_of_value_is_read() -> None:
    record = Record(
        "g", 2.0, 3.5, 0.5, 8.0, 7, True, "l", Colour.RED, Colour.BLUE, (1.0, 0.0, -1.0), Inner(3.0), Inner(1.0),
        (Inner(1.5), Inner(2.0)), Part(False), True,
    )  # fmt: skip
    assert read(FULL) == (record, [])


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("low = 11", "file: low: 11 is refused; a finite number from 0 to 10 is accepted"),
        ("low = -0.1", "file: low: -0.1 is refused; a finite number from 0 to 10 is accepted"),
        ("low = true", "file: low: True is refused; a finite number from 0 to 10 is accepted"),
        ("turn_deg = 'x'", "file: turn_deg: 'x' is refused; a finite number is accepted"),
        ("turn = 1", "file: turn: 1 is refused; unknown key; did you mean 'turn_deg'? known: "),
        ("count = 10", "file: count: 10 is refused; a whole number from 1 to 9 is accepted"),
        ("count = 2.0", "file: count: 2.0 is refused; a whole number from 1 to 9 is accepted"),
        ("on = 1", "file: on: 1 is refused; true or false is accepted"),
        ("label = 1", "file: label: 1 is refused; a string is accepted"),
        ("colour = 'bleu'", "file: colour: 'bleu' is refused; did you mean 'blue'? known: blue, red"),
        ("tint = 'x'", "file: tint: 'x' is refused; known: blue, red"),
        ("three = [1, 2]", "file: three: [1, 2] is refused; an array of 3 finite numbers is accepted"),
        ("three = [0, 0, 2]", "file: three: [0.0, 0.0, 2.0] is refused; numbers from -1 to 1 are accepted"),
        ("three = [0, 0, -2]", "file: three: [0.0, 0.0, -2.0] is refused; numbers from -1 to 1 are accepted"),
        ("high = 0.5", "file: high: 0.5 is refused; at least low"),
        ("given = 'x'", "file: given: 'x' is refused; unknown key; "),
        ("inner = 1", "file: inner: 1 is refused; a table [inner] is accepted"),
        ("inner = {size = 4}", "file: inner.size: 4 is refused; a finite number from 1 to 3 is accepted"),
        ("inner = {sise = 2}", "file: inner.sise: 2 is refused; unknown key; did you mean 'size'? known: size"),
        ("option = {size = 0}", "file: option.size: 0 is refused; a finite number from 1 to 3 is accepted"),
        ("many = [{}, {size = 0}]", "file: many[1].size: 0 is refused; a finite number from 1 to 3 is accepted"),
        ("beside = 1", "file: beside: 1 is refused; true or false is accepted"),
    ],
)
def test_what_is_wrong_is_said_once(line: str, fault: str) -> None:
    _, faults = read(line)
    assert len(faults) == 1
    assert faults[0].startswith(fault)


def test_all_faults_are_collected_in_the_order_of_the_fields_and_unknown_keys_last() -> None:
    _, faults = read("beyond = 1\ncolour = 'x'\nlow = 99\n[inner]\nsize = 9\n")
    assert [fault.split(": ")[1] for fault in faults] == ["low", "colour", "inner.size", "beyond"]


def test_a_check_knows_the_callers_context() -> None:
    _, faults = read("high = 0.5", word="WORD")
    assert faults == ["file: high: 0.5 is refused; at least WORD"]


@dataclass(frozen=True)
class Strict:
    """Nothing has a default in the file."""

    size: float = number(minimum=1.0)
    three: tuple[float, ...] = numbers(3)
    name: str = text(accepted="a name")
    colour: Colour = choice(Colour)
    pair: tuple[str, ...] = texts(2)
    needy: Needy = section(Needy)
    rate: float = number(fallback=7.5)
    unit: tuple[float, ...] = numbers(3, fallback=(0.0, 0.0, 1.0))


def test_each_missing_key_is_named_once_and_a_missing_section_without_its_keys() -> None:
    record, faults = read("", Strict)
    keys = ["size", "three", "name", "colour", "pair", "needy", "rate", "unit"]
    assert [fault.split(": ")[1] for fault in faults] == keys
    assert all("missing; required: " in fault for fault in faults)
    assert record == Strict(0.0, (0.0,) * 3, "", Colour.RED, (), Needy(0.0), 7.5, (0.0, 0.0, 1.0))


def test_a_required_section_that_is_there_has_faults_of_its_own() -> None:
    table = Table({"size": 1, "rate": 1, "three": [0, 0, 0], "unit": [0, 0, 1], "name": "n", "colour": "red",
                   "pair": ["a", "b"], "needy": {}}, "file", "", [])  # fmt: skip
    read_record(table, Strict)
    assert [str(fault) for fault in table.faults] == [
        "file: needy.size: missing; required: a finite number from 1 to inf"
    ]


def test_a_required_key_has_no_default_in_code_unless_one_is_named() -> None:
    without = {one.name for one in fields(Strict) if one.default is MISSING}
    assert without == {"size", "three", "name", "colour", "pair", "needy"}


@dataclass(frozen=True)
class Apart:
    """The file may leave out what code may not."""

    size: float = number(2.0, file_only=True)


def test_a_default_of_the_file_alone_is_none_in_code() -> None:
    assert read("", Apart) == (Apart(2.0), [])
    assert fields(Apart)[0].default is MISSING


def test_declarations_can_be_asked() -> None:
    keys = declared(Record)
    assert list(keys) == [one.name for one in fields(Record) if one.name != "given"]
    assert keys["low"].limits == Limits(0.0, 10.0)
    assert keys["turn"].limits is None
    assert keys["low"].unit == "nT"
    assert keys["turn"].name == "turn_deg"
    assert keys["low"].default == 1.0
    assert declared(Strict)["size"].default is REQUIRED


def test_what_the_caller_gives_is_not_read() -> None:
    table = Table({"low": 2.0}, "file", "", [])
    record = read_record(table, Record, {"given": "g", "low": 9.0, "high": 9.5})
    assert record.low == 9.0
    assert [str(fault).split(";")[1] for fault in table.faults] == [" unknown key"]


@dataclass(frozen=True)
class Named:
    """A dictionary as default."""

    values: dict[str, float] = special(lambda reading, name: {}, {})


def test_a_dictionary_as_default_is_each_instances_own() -> None:
    assert Named().values == {}
    assert Named().values is not Named().values


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"a" + b".a" * 501 + b" = 1", "nested too deeply"),
        (b"a = " + b"[" * 33 + b"]" * 33, "nested too deeply"),
        (b"a = " + b"9" * 400, "an integer of hundreds of digits"),
        (b"a = \xff", "no text in UTF-8"),
        (b"a = ", "Invalid value"),
    ],
)
def test_a_text_that_no_file_of_ours_is_is_refused(raw: bytes, said: str) -> None:
    with pytest.raises(ConfigError, match=r"^place") as caught:
        parse_toml(raw, "place", "file", ConfigError)
    assert said in str(caught.value)


@pytest.mark.parametrize("raw", [b"a" + b".a" * 30 + b" = 1", b"a = " + b"[" * 31 + b"]" * 31, b"a = " + b"9" * 308])
def test_what_is_just_within_those_bounds_is_read(raw: bytes) -> None:
    assert parse_toml(raw, "place", "file", ConfigError).keys() == ("a",)


@pytest.mark.parametrize("micro", ["\u00b5", "\u03bc"])
def test_the_sign_for_micro_means_the_letter_that_units_have(micro: str) -> None:
    """A tesla is a million times as much."""
    assert nearest(f"{micro}T", ["nT", "uT", "T"]).startswith("did you mean 'uT'?")
