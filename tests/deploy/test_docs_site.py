"""The pages as a site: each stands in its navigation; where mkdocs is installed, it is built and no link is dead."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "docs/mkdocs.yml"


def test_every_page_stands_in_the_navigation_once_in_one_of_five_parts() -> None:
    navigation = CONFIG.read_text(encoding="utf-8").partition("\nnav:\n")[2]
    pages = re.findall(r": (\S+\.md)$", navigation, re.M)
    assert re.findall(r"^  - (.+):$", navigation, re.M) == ["Start", "Tutorials", "How to", "Reference", "Why"]
    docs = ROOT / "docs"
    written = [*docs.glob("*.md"), *docs.glob("tutorials/*.md")]
    assert sorted(pages) == sorted(str(path.relative_to(docs)) for path in written)


@pytest.mark.skipif(not importlib.util.find_spec("material"), reason="mkdocs-material is not installed: make docs")
def test_the_site_is_built_without_a_warning_and_its_links_to_other_files_work(tmp_path: Path) -> None:
    text = CONFIG.read_text(encoding="utf-8").replace("site_dir: build/docs", f"site_dir: {tmp_path / 'site'}")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--config-file", "-"]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, input=text, env=environment, capture_output=True, text=True, timeout=100, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "site/repository/deploy/config/zenoh-peer.toml").is_file()
    page = (tmp_path / "site/configuration.html").read_text(encoding="utf-8")
    assert 'href="repository/deploy/config/zenoh-peer.toml"' in page
