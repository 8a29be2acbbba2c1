"""Write the tables of README and docs from the results in docs/results: ``make docs-figures``."""

from __future__ import annotations

from tests.figures.pages import ROOT, pages, written
from tests.figures.tables import TABLES


def main() -> None:
    """Write every page that changes, and name it."""
    for page in pages():
        before = page.read_text(encoding="utf-8")
        after = written(before, TABLES)
        if after != before:
            page.write_text(after, encoding="utf-8")
            print(f"{page.relative_to(ROOT)}: written")


if __name__ == "__main__":
    main()
