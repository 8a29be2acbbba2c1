"""Rows of estimates in a file, while the disk takes them."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from magcal_service.base.errors import InputRefusedError
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.wire.messages import Estimate

log = logging.getLogger("magcal")

RETRY_S: Final = 60.0  # choice: as often as a recorder tries its disk again


class Rows:
    """A file of estimates that may be none, or fail: a full disk stops the rows, not the service.

    A file that is continued after a restart is continued after an error as well, as soon as the disk takes rows again.

    Parameters
    ----------
    csv: the file; None: no rows are written.
    retry_s: time between two attempts to go on [s].

    Attributes
    ----------
    error: why no rows are written now; None where they are.
    trouble: the same as one line; it stays until rows are on the disk again.
    """

    def __init__(self, csv: EstimateCsv | None, retry_s: float = RETRY_S) -> None:
        self._csv = csv
        self._retry_s = retry_s
        self._again_s = math.inf  # on the monotonic clock
        self._added = False  # a row since the last flush
        self.error: InputRefusedError | None = None
        self.trouble = ""

    def add(self, estimate: Estimate) -> bool:
        """Write one row; False where it is lost, because the file has failed before."""
        if self.error is not None:
            return False
        self._to_disk(lambda csv: csv.add(estimate))
        self._added = True
        return True

    def flush(self) -> None:
        """Put the rows written so far on disk, or try again whether it takes any."""
        if self.error is not None and time.monotonic() >= self._again_s:
            self.error = None
            self._to_disk(EstimateCsv.open_again)
        self._to_disk(EstimateCsv.flush)
        if self.error is None and self._added and self.trouble:
            self.trouble = ""
            log.info("estimates are written as rows again")
        self._added = False

    def _to_disk(self, work: Callable[[EstimateCsv], None]) -> None:
        if self._csv is None or self.error is not None:
            return
        try:
            work(self._csv)
        except InputRefusedError as error:
            self._failed(self._csv, error)

    def _failed(self, csv: EstimateCsv, error: InputRefusedError) -> None:
        self.error = error
        with suppress(InputRefusedError):
            csv.close()
        if csv.append:
            self._again_s = time.monotonic() + self._retry_s
        if self.trouble != str(error):
            then = f", it is tried again in {self._retry_s:g} s" if csv.append else ""
            log.error("estimates are no longer written as rows: %s; the calibration goes on%s", error, then)
        self.trouble = str(error)
