"""What became of a recording's rows on the way into a diagnosis."""

from __future__ import annotations

from magcal_service.diagnosis.prepare import Prepared
from magcal_service.recordings.inspect.account import Account
from magcal_service.recordings.inspect.inspection import Inspection


def account_of(inspection: Inspection, prepared: Prepared) -> Account:
    """What the reader, the inspection and the preparation have left out of the log, and how many rows are fitted."""
    return inspection.account_to_diagnose.less(prepared.left_out)
