"""The nine numbers in the forms that flight software reads, one form a file.

Imports ``offline.given`` and ``offline.result_head``; nothing but the command imports it.
"""

from __future__ import annotations

from magcal_service.offline.exports.ardupilot import ARDUPILOT
from magcal_service.offline.exports.betaflight import BETAFLIGHT
from magcal_service.offline.exports.c_header import C_HEADER
from magcal_service.offline.exports.cfs_table import CFS_TABLE
from magcal_service.offline.exports.form import Exported, Form, Wanted
from magcal_service.offline.exports.json_schema import JSON_SCHEMA
from magcal_service.offline.exports.plain_csv import PLAIN_CSV
from magcal_service.offline.exports.px4 import PX4

__all__ = ["FORMS", "Exported", "Form", "Wanted"]

FORMS = {one.name: one for one in (C_HEADER, ARDUPILOT, PX4, BETAFLIGHT, JSON_SCHEMA, PLAIN_CSV, CFS_TABLE)}
"""By the name that ``--format`` takes."""
