"""Hook of mkdocs: links of a page to files beside ``docs/`` work on the site as they do in the repository.

Each such file is put on the site under ``repository/``; a page of it is a page there.  A folder has no page, so its
name is shown without a link.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

DOCS = "docs/"
SHOWN = "repository/"
BEHIND = (SHOWN, "results/")
"""Pages that a search finds after all others: what lies beside the docs, and tables that commands have written."""

ROOT = Path(__file__).resolve().parents[1]

_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<path>[^)#\s:]+)(?P<anchor>#[^)\s]*)?\)")


def on_files(files: Files, *, config: Any) -> Files:
    """Add what the pages link to beside ``docs/``, and what that links to in turn."""
    waiting = [DOCS + file.src_uri for file in files.documentation_pages()]
    seen = set(waiting)
    while waiting:
        page = waiting.pop()
        for link in _LINK.finditer((ROOT / page).read_text(encoding="utf-8")):
            target = _target(page, link["path"])
            if target in seen or target.startswith(DOCS) or not (ROOT / target).is_file():
                continue
            seen.add(target)
            files.append(File.generated(config, SHOWN + target, abs_src_path=str(ROOT / target)))
            if target.endswith(".md"):
                waiting.append(target)
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """The page's text with the links as they are on the site; one that leads nowhere stays, for mkdocs to refuse."""
    here = page.file.src_uri
    if here.startswith(BEHIND):
        page.meta["search"] = {"boost": 0.1}
    source = here.removeprefix(SHOWN) if here.startswith(SHOWN) else DOCS + here

    def on_site(link: re.Match[str]) -> str:
        target = _target(source, link["path"])
        if (ROOT / target).is_dir():
            return link["text"]
        shown = target.removeprefix(DOCS) if target.startswith(DOCS) else SHOWN + target
        path = os.path.relpath(shown, os.path.dirname(here))
        return f"[{link['text']}]({path}{link['anchor'] or ''})"

    return _LINK.sub(on_site, markdown)


def _target(page: str, path: str) -> str:
    """Where a link of a page leads, from the root of the repository."""
    return os.path.normpath(os.path.join(os.path.dirname(page), path))
