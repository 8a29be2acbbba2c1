"""The version, for sessions, checkpoints, reports and ``--version``."""

from typing import Final

__version__: Final = "0.1.0"
