"""Values as plain data: no two alike, each comes back as it was, and reading runs nothing."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, make_dataclass
from enum import Enum, StrEnum
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest

from magcal_service.many.plain import NotKnownError, pack, unpack
from tests.many import work


class Colour(Enum):
    RED = 1


class Word(StrEnum):
    YES = "yes"


@dataclass(frozen=True, slots=True)
class Pair:
    left: object
    right: object


@dataclass
class Loud:
    """Whatever makes one by its constructor is heard."""

    value: int
    made: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        raise AssertionError("its code was run")


DATA: list[Any] = [
    None, 0, False, 0.0, -0.0, 1.5, float("inf"), "", "0", "\ud800", b"0", Path("0"), 2**63, 2**64, -(2**70), "yes",
    (), [], {}, set(), frozenset(), (0,), ((0,),), (0, 0), ("ab",), ("a", "b"), ["list"], {1, 2}, {"a": 1}, {"a": 2},
    {"b": 1}, {(1, 2): [3]}, Colour.RED, Word.YES, Pair(1, 2), Pair(2, 1), Pair((1,), Pair(2, None)), {"b": 1, "a": 1},
    {"a": 1, "b": 1},
]  # fmt: skip
ARRAYS: list[Any] = [
    np.zeros(2), np.zeros((2, 1)), np.zeros(2, dtype=np.float32), np.array(0.0), np.float64(0.0), np.bool_(False),
    np.array([0.0, 1e-300]), np.arange(6).reshape(2, 3).T, np.zeros((0, 3)), np.array(["a", "bc"]),
]  # fmt: skip
SEEDS = [*np.random.SeedSequence(1).spawn(2), np.random.SeedSequence(1), np.random.SeedSequence(2**100)]
NAMES: list[Any] = [work.squared, work.solved, partial(work.squared, 1), partial(work.squared), Pair]


def test_no_two_values_are_the_same_data() -> None:
    values = [*DATA, *ARRAYS, *SEEDS, *NAMES]
    assert len({pack(value) for value in values}) == len(values)


@pytest.mark.parametrize("value", DATA, ids=ascii)
def test_what_was_kept_comes_back_as_it_was(value: Any) -> None:
    back = unpack(pack(value))
    assert back == value
    assert type(back) is type(value)
    assert repr(back) == repr(value)


@pytest.mark.parametrize("value", ARRAYS, ids=repr)
def test_arrays_come_back_to_the_last_bit(value: Any) -> None:
    back = unpack(pack(value))
    assert (type(back), back.dtype, back.shape) == (type(value), value.dtype, value.shape)
    assert back.tobytes() == value.tobytes()
    assert back.flags.writeable or not isinstance(value, np.ndarray)


def test_a_seed_comes_back_as_one_that_draws_the_same() -> None:
    for seed in SEEDS:
        assert np.array_equal(unpack(pack(seed)).generate_state(8), seed.generate_state(8))


def test_equal_values_are_the_same_data_whatever_way_they_were_made() -> None:
    assert pack(("".join(["x", "y"]), "xy")) == pack(("xy", "xy"))
    fresh, used = np.random.SeedSequence(3), np.random.SeedSequence(3)
    used.spawn(2)
    assert pack(fresh) == pack(used)
    assert pack({1, 2, 300}) == pack({300, 2, 1})


@pytest.mark.parametrize("value", [SimpleNamespace(), object(), np.array([object()]), (1, iter(()))])
def test_what_is_no_data_says_so(value: object) -> None:
    with pytest.raises(TypeError, match="is not plain data"):
        pack(value)


def test_a_record_is_made_without_running_its_code() -> None:
    loud = object.__new__(Loud)
    loud.value, loud.made = 3, []
    back = unpack(pack(loud))
    assert (type(back), back.value, back.made) == (Loud, 3, [])


@pytest.mark.parametrize(
    "plain",
    [
        ["record", "os", "system", ["command", "true"]],
        ["record", "subprocess", "Popen"],
        ["record", "antigravity", "fly"],
        ["record", "pathlib", "Path"],
        ["record", __name__, "Pair", ["left", 1]],
        ["record", __name__, "Pair", ["left", 1], ["right", 2], ["more", 3]],
        ["enum", __name__, "Pair", "left"],
        ["named", "os", "system"],
        ["partial", ["named", "os", "system"], ["tuple", "true"], ["dict"]],
        ["whatever"],
    ],
    ids=str,
)
def test_what_is_no_loaded_record_is_not_made_and_nothing_is_imported(plain: list[Any]) -> None:
    loaded = set(sys.modules)
    with pytest.raises(NotKnownError):
        unpack(msgpack.packb(plain))
    assert set(sys.modules) == loaded


def test_a_record_whose_fields_have_changed_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = pack(Pair(1, 2))
    changed = make_dataclass("Pair", ["left", "other"])
    monkeypatch.setattr(sys.modules[__name__], "Pair", changed)
    with pytest.raises(NotKnownError, match="no record Pair with the fields left, right"):
        unpack(kept)
