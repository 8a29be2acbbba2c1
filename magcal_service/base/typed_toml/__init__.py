"""TOML files read into frozen dataclasses, collecting every fault instead of stopping at the first.

``open_toml`` gives a ``Table``; a dataclass declares with the functions of ``keys`` how each field stands in a table;
``read_record`` reads the table into the dataclass and refuses unknown keys.  The caller raises once, with all faults.
Imports ``base.errors`` alone.
"""

from magcal_service.base.typed_toml.kind import TomlKind, refuse_another
from magcal_service.base.typed_toml.parse import open_toml, parse_toml
from magcal_service.base.typed_toml.table import Table, nearest

__all__ = ["Table", "TomlKind", "nearest", "open_toml", "parse_toml", "refuse_another"]
