"""Rows of estimates in a file, for as long as the disk takes them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress

from magcal_service.base.errors import InputRefusedError
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.wire.messages import Estimate

log = logging.getLogger("magcal")


class Rows:
    """A file of estimates that may be none, or end early: a full disk ends the file, not the service.

    Parameters
    ----------
    csv: the file; None: no rows are written.

    Attributes
    ----------
    error: why it ended early; None where it did not.
    """

    def __init__(self, csv: EstimateCsv | None) -> None:
        self._csv = csv
        self.error: InputRefusedError | None = None

    def add(self, estimate: Estimate) -> bool:
        """Write one row; False where it is lost, because the file has ended before."""
        if self.error is not None:
            return False
        self._to_disk(lambda csv: csv.add(estimate))
        return True

    def flush(self) -> None:
        """Put the rows written so far on disk."""
        self._to_disk(EstimateCsv.flush)

    def _to_disk(self, work: Callable[[EstimateCsv], None]) -> None:
        if self._csv is None or self.error is not None:
            return
        try:
            work(self._csv)
        except InputRefusedError as error:
            self.error = error
            with suppress(InputRefusedError):
                self._csv.close()
            log.error("estimates are no longer written as rows: %s; the calibration goes on", error)
