"""``[[samples.join]]`` of a descriptor: a further file, whose rows go with the log's by their time."""

from __future__ import annotations

from dataclasses import dataclass

from magcal_service.base.typed_toml.keys import number, special, text
from magcal_service.base.typed_toml.record import Reading, read_part, read_record
from magcal_service.recordings.row_form import PLAIN_ROWS, RowForm
from magcal_service.recordings.time_spec import TimeSpec
from magcal_service.wire.fields import NAME


def _check_name(reading: Reading, name: str, given: str) -> None:
    if given and not NAME.fullmatch(given):
        accepted = "1 to 32 of A-Z a-z 0-9 _ - are accepted; its columns are called NAME.COLUMN"
        reading.table.refuse(name, given, accepted)


def _form(reading: Reading, _: str) -> RowForm:
    return read_part(reading.table, RowForm)


def _time(reading: Reading, name: str) -> TimeSpec | None:
    table = reading.table.table(name)
    return None if table is None else read_record(table, TimeSpec)


@dataclass(frozen=True, slots=True)
class JoinSpec:
    """A file of other rows, each of which goes with the log's rows from its time on.

    Parameters
    ----------
    name: its columns are called ``NAME.COLUMN`` in the descriptor.
    tolerance_s: a row of the log takes the newest joined row that is not later, and at most this much older.
    form: how its rows are laid out.
    time: its time; None: as the log's own.
    """

    file: str = text(accepted="the name of a log in rows")
    name: str = text(accepted="a name for its columns", check=_check_name)
    tolerance_s: float = number(minimum=0.0, maximum=1e6, unit="s")
    form: RowForm = special(_form, PLAIN_ROWS)
    time: TimeSpec | None = special(_time, None)
