"""What one reader of the page is sent: at first all of one magnetometer, then what has changed."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

from magcal_service.views.field import FieldView
from magcal_service.views.series import Lacking
from magcal_service.views.state import Views

SPECTRUM_EVERY_S: Final = 2.0
"""Between two spectra [s]: the dearest part of an update."""


class Feed:
    """Updates of one reader.

    Parameters
    ----------
    label: the magnetometer asked for; the first there is where it is empty or not heard yet.
    """

    def __init__(self, label: str = "") -> None:
        self._asked = label
        self._field: FieldView | None = None
        self._rows = Lacking()
        self._sphere = 0
        self._spectrum_s = -SPECTRUM_EVERY_S
        self._spectrum_rows = -1

    def update(self, views: Views, now_s: float) -> dict[str, Any]:
        """What has changed since the last call, as plain data; ``now_s`` [s] is the clock messages were heard by."""
        update: dict[str, Any] = {"list": views.listed(now_s)}
        shown = views.find(self._asked)
        if shown is None:
            return update
        craft = shown.craft
        update |= {"label": shown.label, "craft": craft.name, "result": shown.result.shown(craft.start_ns)}
        field = craft.field_of(shown.label)
        if field is not None:
            update |= self._field_update(field, now_s)
        return update

    def _field_update(self, field: FieldView, now_s: float) -> dict[str, Any]:
        is_new = field is not self._field
        if is_new:
            self._field, self._rows, self._sphere = field, Lacking(), 0
            self._spectrum_s, self._spectrum_rows = -SPECTRUM_EVERY_S, -1
        update: dict[str, Any] = {
            "vectors": field.pulse.shown(now_s),
            "fresh": is_new,
            "coverage": round(field.sphere.coverage, 4),
        }
        update |= self._rows.update(field.recent, field.whole)
        update["every"] = field.whole.every
        update["cells"] = field.sphere.since(self._sphere)
        self._sphere = field.sphere.count
        if now_s - self._spectrum_s >= SPECTRUM_EVERY_S and field.recent.count != self._spectrum_rows:
            self._spectrum_s, self._spectrum_rows = now_s, field.recent.count
            found = field.spectrum()
            update["spectrum"] = None if found is None else asdict(found)
        return update
