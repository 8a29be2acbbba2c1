"""What is saved comes back as it was, and what does not fit is refused by its place and by what is accepted there."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Generic, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.base.snapshot import SnapshotError, Stateful, plain, restored
from magcal_service.model import Array

T = TypeVar("T")


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Point:
    """A record of two numbers, of which the first is not negative."""

    x: float
    name: str

    def __post_init__(self) -> None:
        if self.x < 0.0:
            raise ValueError("x is negative; 0 or more is accepted")


@dataclass(init=False, repr=False, eq=False)
class _InnerMemory(Generic[T]):
    rows: list[T]


class Inner(Stateful, _InnerMemory[T]):
    """Rows of any kind."""

    def __init__(self) -> None:
        self.rows = []


@dataclass(init=False, repr=False, eq=False)
class _OuterMemory:
    flag: bool
    count: int
    level: float
    word: str
    colour: Colour
    maybe: float | None
    vector: Array
    grid: Array | None
    mask: NDArray[np.bool_]
    newest: deque[float]
    pair: tuple[int, str]
    many: tuple[float, ...]
    points: list[Point]
    by_name: dict[str, tuple[int, ...]]
    tally: Counter[str]
    inner: Inner[Point]


class Outer(Stateful, _OuterMemory):
    """One of everything that a memory may hold."""

    def __init__(self) -> None:
        self.flag, self.count, self.level, self.word = True, 3, 2.5, "text"
        self.colour, self.maybe = Colour.BLUE, None
        self.vector, self.grid = np.array([1.0, -2.0, 3.0]), np.arange(6.0).reshape(2, 3)
        self.mask = np.array([True, False])
        self.newest = deque([1.0, 2.0], maxlen=3)
        self.pair, self.many = (7, "seven"), (1.0, 2.0, 3.0)
        self.points = [Point(1.0, "a"), Point(2.0, "b")]
        self.by_name = {"one": (1,), "two": (1, 2)}
        self.tally = Counter(good=4, bad=1)
        self.inner = Inner()
        self.inner.rows = [Point(9.0, "inside")]


SAVED = Outer().export_state()


def blank() -> Outer:
    """An object of the same kind whose memory is another one."""
    other = Outer()
    other.flag, other.count, other.level, other.word, other.maybe = False, 0, 0.0, "", 1.0
    other.colour, other.vector, other.mask = Colour.RED, np.zeros(3), np.array([False, False])
    other.grid = None
    other.newest, other.pair, other.many = deque(maxlen=3), (0, ""), ()
    other.points, other.by_name, other.tally, other.inner = [], {}, Counter(), Inner()
    return other


def test_everything_comes_back_with_its_type() -> None:
    original, other = Outer(), blank()
    other.restore_state(SAVED)
    for name, value in vars(original).items():
        found = getattr(other, name)
        assert type(found) is type(value), name
        if isinstance(value, np.ndarray):
            assert (found.dtype, found.tolist()) == (value.dtype, value.tolist())
        elif name != "inner":
            assert found == value, name
    assert other.inner.rows == original.inner.rows
    assert other.newest.maxlen == 3
    assert other.export_state() == SAVED


def test_what_is_written_is_plain_and_little_endian() -> None:
    """The format of checkpoints: written out once by hand."""
    assert SAVED["vector"] == [[3], np.array([1.0, -2.0, 3.0], dtype="<f8").tobytes()]
    assert SAVED["grid"][0] == [2, 3]
    assert SAVED["mask"] == [[2], b"\x01\x00"]
    assert SAVED["points"] == [[1.0, "a"], [2.0, "b"]]
    assert SAVED["by_name"] == [["one", [1]], ["two", [1, 2]]]
    assert (SAVED["tally"], SAVED["pair"], SAVED["newest"]) == ({"good": 4, "bad": 1}, [7, "seven"], [1.0, 2.0])
    assert (SAVED["colour"], type(SAVED["colour"])) == ("blue", str)
    assert (SAVED["flag"], SAVED["maybe"]) == (True, None)
    assert type(plain(np.float64(2.5))) is float
    assert plain(np.array([1.0], dtype=">f8")) == [[1], np.array([1.0], dtype="<f8").tobytes()]


def test_what_cannot_be_saved_is_an_error_of_the_program() -> None:
    with pytest.raises(TypeError, match="set cannot be saved"):
        plain({1, 2})


RAW3 = np.zeros(3).tobytes()
NOT_FITTING: list[tuple[str, Any, str]] = [
    ("flag", 1, "state.flag is int; bool is accepted"),
    ("count", True, "state.count is bool; int is accepted"),
    ("count", 1.0, "state.count is float; int is accepted"),
    ("level", 1, "state.level is int; float is accepted"),
    ("level", math.nan, "state.level is nan; a finite number is accepted"),
    ("level", -math.inf, "state.level is -inf; a finite number is accepted"),
    ("word", b"text", "state.word is bytes; str is accepted"),
    ("colour", "green", "state.colour is str; one of red, blue is accepted"),
    ("colour", 3, "state.colour is int; one of red, blue is accepted"),
    ("maybe", "x", "state.maybe is str; float is accepted"),
    ("level", None, "state.level is NoneType; float is accepted"),
    ("vector", None, "state.vector is NoneType; an array is accepted"),
    ("vector", [[3]], "state.vector is list; an array is accepted"),
    ("vector", [[3], RAW3, RAW3], "state.vector is list; an array is accepted"),
    ("vector", [3, RAW3], "state.vector is list; an array is accepted"),
    ("vector", ([3], RAW3), "state.vector is tuple; an array is accepted"),
    ("vector", [[True], RAW3], "state.vector is list; an array of up to 3 axes is accepted"),
    ("vector", [[-3], RAW3], "state.vector is list; an array of up to 3 axes is accepted"),
    ("vector", [[3.0], RAW3], "state.vector is list; an array of up to 3 axes is accepted"),
    ("vector", [[1, 1, 1, 3], RAW3], "state.vector is list; an array of up to 3 axes is accepted"),
    ("vector", [[3], RAW3[1:]], "state.vector is bytes; as many bytes as the shape says is accepted"),
    ("vector", [[3], bytearray(RAW3)], "state.vector is bytearray; as many bytes as the shape says is accepted"),
    ("vector", [[3], "x" * 24], "state.vector is str; as many bytes as the shape says is accepted"),
    ("vector", [[4], np.zeros(4).tobytes()], r"state.vector has the shape \(4,\); \(3,\) is accepted"),
    ("vector", [[1, 3], RAW3], r"state.vector has the shape \(1, 3\); \(3,\) is accepted"),
    ("vector", plain(np.array([1.0, np.inf, 0.0])), "state.vector holds a NaN or an infinity"),
    ("grid", plain(np.array([[1.0, np.nan]])), "state.grid holds a NaN or an infinity"),
    ("mask", [[2], b"\x01"], "state.mask is bytes; as many bytes"),
    ("newest", (1.0, 2.0), "state.newest is tuple; an array is accepted"),
    ("newest", [1.0, "x"], r"state.newest\[1\] is str; float is accepted"),
    ("pair", [7], "state.pair is list; an array of 2 is accepted"),
    ("pair", [7, "seven", 7], "state.pair is list; an array of 2 is accepted"),
    ("pair", ["seven", 7], r"state.pair\[0\] is str; int is accepted"),
    ("many", [1.0, None], r"state.many\[1\] is NoneType; float is accepted"),
    ("points", [[1.0, "a"], [2.0]], r"state.points\[1\] is list; an array of 2 is accepted"),
    ("points", [[1.0, "a"], [2.0, 3]], r"state.points\[1\]\[1\] is int; str is accepted"),
    ("points", [[-1.0, "a"]], r"state.points\[0\]: x is negative; 0 or more is accepted"),
    ("points", {"a": 1}, "state.points is dict; an array is accepted"),
    ("by_name", {"one": [1]}, "state.by_name is dict; an array is accepted"),
    ("by_name", [["one"]], "state.by_name is list; an array of 2 is accepted"),
    ("by_name", [["one", [1.0]]], r"state.by_name\[1\]\[0\] is float; int is accepted"),
    ("tally", [["good", 4]], "state.tally is list; a map of names to counts is accepted"),
    ("tally", {"good": 4.0}, "state.tally is dict; a map of names to counts is accepted"),
    ("tally", {4: 4}, "state.tally is dict; a map of names to counts is accepted"),
    ("tally", {"good": True}, "state.tally is dict; a map of names to counts is accepted"),
    ("inner", {}, "state.inner is dict; a map of rows is accepted"),
    ("inner", {"rows": [[1.0]]}, r"state.inner.rows\[0\] is list; an array of 2 is accepted"),
    ("inner", {"rows": [[-1.0, "a"]]}, r"state.inner.rows\[0\]: x is negative"),
]


@pytest.mark.parametrize(("name", "value", "words"), NOT_FITTING)
def test_what_does_not_fit_is_refused_by_its_place(name: str, value: object, words: str) -> None:
    with pytest.raises(SnapshotError, match=f"^{words}"):
        blank_with_grid().restore_state({**SAVED, name: value})


def blank_with_grid() -> Outer:
    other = blank()
    other.grid = None  # of any shape
    return other


@pytest.mark.parametrize(
    "saved", [None, [], {}, {**SAVED, "more": 1}, {k: v for k, v in SAVED.items() if k != "tally"}]
)
def test_a_memory_with_a_part_too_many_or_too_few_is_refused(saved: object) -> None:
    with pytest.raises(SnapshotError, match=r"^there is \w+; a map of flag, count, .*inner is accepted"):
        Outer().restore_state(saved, "there")


def test_the_largest_array_has_a_million_elements_along_an_axis() -> None:
    assert restored([[1_000_000, 0], b""], Array, "a").shape == (1_000_000, 0)
    with pytest.raises(SnapshotError, match="a is list; an array of up to 3 axes"):
        restored([[1_000_001, 0], b""], Array, "a")


def test_arrays_may_have_up_to_three_axes_and_be_written_into() -> None:
    found = restored([[1, 2, 3], np.arange(6.0).tobytes()], Array, "a")
    assert found.tolist() == [[[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]]
    found[0, 0, 0] = 7.0
    assert restored([[], np.array(4.0).tobytes()], Array, "a").shape == ()


def test_counts_are_restored_in_place() -> None:
    """Others may count in the same object."""
    target = Outer()
    tally = target.tally
    tally["old"] = 3
    target.restore_state(SAVED)
    assert target.tally is tally
    assert tally == Counter(good=4, bad=1)


def test_a_type_that_no_memory_has_is_refused() -> None:
    with pytest.raises(SnapshotError, match="a is int; nothing is accepted"):
        restored(3, object, "a")


def test_none_is_taken_where_it_is_an_option() -> None:
    assert restored(None, float | None, "a") is None
    assert restored(2.0, float | None, "a") == 2.0
    assert restored("red", Colour | None, "a") is Colour.RED
    assert restored(None, Array | None, "a") is None


def test_a_record_is_equal_to_what_was_saved() -> None:
    point = Point(3.0, "c")
    assert restored(plain(point), Point, "p") == point
    assert restored(plain(point), Point, "p") != replace(point, x=4.0)
