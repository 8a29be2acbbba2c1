"""Packages of npm that some checks use where they are installed."""

from __future__ import annotations

from pathlib import Path

from tests.figures.pages import ROOT

_FOLDERS = ("build/node", "deploy/openmct")


def node_package(name: str) -> Path | None:
    """Folder of a package, None where it is not installed."""
    folders = (ROOT / folder / "node_modules" / name for folder in _FOLDERS)
    return next((folder for folder in folders if (folder / "package.json").is_file()), None)
