"""The JSON Schema that a result keeps, as it is shipped."""

from __future__ import annotations

from magcal_service.offline.exports.form import Exported, Form, Wanted
from magcal_service.offline.given import Given
from magcal_service.offline.result_head import CALIBRATION, schema_text


def _make(given: Given, _wanted: Wanted) -> Exported:
    return Exported(schema_text(given.schema or CALIBRATION))


JSON_SCHEMA = Form("json-schema", "the JSON Schema of the result itself", _make)
