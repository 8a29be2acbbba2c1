"""``[inspect]`` of a descriptor: likely defects that are none, by the word of whoever wrote it."""

from __future__ import annotations

from magcal_service.base.typed_toml import nearest
from magcal_service.base.typed_toml.record import Reading
from magcal_service.recordings.defects import Code


def read_accepted(reading: Reading, name: str) -> tuple[Code, ...]:
    """The codes of ``accept``; faults are added to the table's list."""
    table = reading.table.table(name)
    if table is None:
        return ()
    known = {str(code) for code in Code}
    codes = table.texts("accept", required=True) or ()
    for code in codes:
        if code not in known:
            table.refuse("accept", code, nearest(code, known))
    table.finish()
    return tuple(Code(code) for code in codes if code in known)
