"""Records are built by name, hold nothing else, cannot be changed, and begin with what the wire says."""

from __future__ import annotations

import dataclasses
import struct

import pytest
import wire_cases as cases
from hypothesis import example, given
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.wire import fields
from magcal_service.wire.messages import Estimate
from magcal_service.wire.seal import MAX_COUNTER, seal, split

RECORDS = {type(golden.message): golden.message for golden in cases.GOLDEN}


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_a_record_is_built_by_name_only(record):
    """A field that is added in the middle never takes the place of another."""
    values = [getattr(RECORDS[record], field.name) for field in dataclasses.fields(record)]
    with pytest.raises(TypeError, match="positional"):
        record(*values)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_a_record_holds_its_fields_and_nothing_else(record):
    assert not hasattr(RECORDS[record], "__dict__")


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.__name__)
def test_a_record_cannot_be_changed(record):
    with pytest.raises(dataclasses.FrozenInstanceError):
        RECORDS[record].craft = "other"


def test_an_estimate_has_used_no_sample_unless_it_says_so():
    fields_of = {field.name: field.default for field in dataclasses.fields(Estimate)}
    assert fields_of["samples_used"] == 0


def test_a_counters_name_has_at_most_64_characters():
    check = fields.name_like(fields.COUNTER_NAME)
    assert check("a" * 64, "name") == "a" * 64
    with pytest.raises(DecodeError, match="bad_name"):
        check("a" * 65, "name")


def test_a_number_beyond_64_bits_is_shown_by_its_size():
    assert fields.shown((1 << 64) - 1) == "18446744073709551615"
    assert fields.shown(1 << 64) == "an integer of 65 bits"


def test_the_largest_counter_is_the_largest_that_the_seal_carries():
    assert split(seal(b"key", MAX_COUNTER, b"x")).counter == MAX_COUNTER
    with pytest.raises(struct.error):
        seal(b"key", MAX_COUNTER + 1, b"x")


@given(st.text(alphabet=st.characters()))
@example("two lines\nof faults\r\n")
@example("a path that is no UTF-8: \udcff, and \x1b[2J")
@example(600 * "ü")
def test_whatever_is_made_fitting_is_accepted_as_a_text(words):
    check, fit = fields.text(), fields.fitting(words)
    assert check(fit, "text") == fit
    if words.isprintable() and len(words.encode()) <= fields.TEXT_BYTES:
        assert fit == words
