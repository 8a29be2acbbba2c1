"""What people look at while a calibration runs: messages in, what a page or a terminal shows out.

Imports offline, links and rooms below them; no pipeline of the daemon.
"""

from pathlib import Path
from typing import Final

PAGE: Final = Path(__file__).parent / "page"
"""Folder of what a browser is given; ``base.css`` in it is the style of the diagnosis' report too."""
