"""Every magnetometer as telemetry, for mission control: rows of numbers over time, and what is said now."""

from __future__ import annotations

from typing import Any

from magcal_service.views.field import FieldView
from magcal_service.views.history import History
from magcal_service.views.series import Lacking
from magcal_service.views.state import Magnetometer, Views


class _Reading:
    """What one reader has had of one magnetometer."""

    def __init__(self) -> None:
        self._field: FieldView | None = None
        self._history: History | None = None
        self._samples, self._results = Lacking(), Lacking()

    def update(self, one: Magnetometer) -> dict[str, Any]:
        field, history = one.craft.field_of(one.label), one.result.history
        update: dict[str, Any] = {"now": one.result.now()}
        if field is not None:
            if field is not self._field:
                self._field, self._samples = field, Lacking()
            update |= {"start_ms": field.start_ns * 1e-6, "samples": self._samples.update(field.recent, field.whole)}
        if history is not self._history:
            self._history, self._results = history, Lacking()
        return update | {"results": self._results.update(history.recent, history.whole)}


class Telemetry:
    """Updates of one reader: at first all rows of all magnetometers, then what has come."""

    def __init__(self) -> None:
        self._readings: dict[str, _Reading] = {}

    def update(self, views: Views, now_s: float) -> dict[str, Any]:
        """What has come since the last call, as plain data; ``now_s`` [s] is the clock messages were heard by.

        ``samples`` are rows of ``FieldView``, ``results`` of ``history.result_row``.
        """
        of = {one.label: self._readings.setdefault(one.label, _Reading()).update(one) for one in views.magnetometers()}
        return {"list": views.listed(now_s), "magnetometers": of}
