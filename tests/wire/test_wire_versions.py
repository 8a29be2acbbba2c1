"""Older and newer ends on one link: the forms that the first version took, and what this one adds to them."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import msgpack
import pytest
import wire_cases as cases

from magcal_service.wire.codec import decode, encode
from magcal_service.wire.kinds import KINDS, kind_of

FIRST_LENGTHS = {1: 8, 2: 10, 3: 9, 4: 10, 16: 10, 17: 18, 18: 11, 32: 9, 33: 12}
"""Values in a list of each kind as the first version had it; it refuses every other number of them, and other kinds."""

APPENDED = {16: ("protection_nt", "protection_by"), 17: ("protection_nt", "protection_by")}
"""What later versions may send behind these, by kind; an older receiver refuses a list that has it."""

OF_THE_FIRST = [golden for golden in cases.GOLDEN if golden.name != "calibrated_protected"]


def older_takes(payload: bytes) -> bool:
    """Whether a receiver of the first version takes a list, by its kind and length."""
    values = msgpack.unpackb(payload)
    return FIRST_LENGTHS.get(values[1]) == len(values)


def test_the_golden_payloads_are_still_those_of_the_first_version() -> None:
    """So that what this version takes and sends is held against what older nodes send and older viewers take."""
    payloads = b"".join(golden.payload for golden in sorted(OF_THE_FIRST, key=lambda golden: golden.name))
    assert hashlib.sha256(payloads).hexdigest() == "d471c7b72a4bfc4e2eebc504ecfe39f0246508f961871e2cfbef8c01fdefecaa"
    assert all(older_takes(golden.payload) and decode(golden.payload) == golden.message for golden in OF_THE_FIRST)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_kind_is_that_of_the_first_version_and_what_is_listed_here_as_appended(kind) -> None:
    """A field added or removed fails here: add it to APPENDED and to the table of docs/wire.md, or count a version."""
    appended = tuple(field.name for field in kind.fields[len(kind.fields) - kind.appended :])
    assert appended == APPENDED.get(kind.code, ())
    assert len(kind.fields) + 2 - kind.appended == FIRST_LENGTHS[kind.code]


@pytest.mark.parametrize("golden", [one for one in OF_THE_FIRST if kind_of(one.message).code in APPENDED], ids=str)
def test_an_older_receiver_refuses_results_with_a_level_and_takes_those_without(golden) -> None:
    """A daemon whose craft have ``[craft.trust] protection = false`` sends the latter alone."""
    protected = encode(replace(golden.message, protection_nt=208.5, protection_by="bias_step"))
    assert not older_takes(protected)
    assert decode(protected).protection_nt == 208.5
    assert older_takes(encode(golden.message))
    assert decode(golden.payload).protection_nt is None
