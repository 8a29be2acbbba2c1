"""``report.html``: one file, no network, hostile names harmless, the same numbers as the JSON."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from magcal_service.diagnosis.words import chance, odds, percent, strength
from magcal_service.physics.saying import measured
from tests.diagnosis.diagnosis_runs import diagnose, recorded

HOSTILE = "<script>x</script> {{7}}$\\fr{\U0001f9f2"


class Page(HTMLParser):
    """Every tag with its attributes, and the text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        self.text = " ".join(self.text.split())
        self.cells = " ".join(re.sub("<[^>]*>", " ", html).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def images(self) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.tags if tag == "img"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The diagnosis of a recording whose temperature channel has a hostile name."""
    descriptor = recorded("hot-electronics", 3000.0, tmp_path_factory.mktemp("hostile"))
    text = descriptor.read_text(encoding="utf-8")
    renamed = text.replace('"temperature" = ', json.dumps(HOSTILE, ensure_ascii=False) + " = ")
    assert renamed != text
    descriptor.write_text(renamed, encoding="utf-8")
    out = tmp_path_factory.mktemp("out")
    assert diagnose(descriptor, "--out", out, drawn=True).code == 0
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    """Its report."""
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_the_report_needs_nothing_but_itself(page: Page) -> None:
    """No script, style sheet, frame or font is fetched; images are in the file."""
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base", "form"}
    sources = [a[key] or "" for _, a in page.tags for key in ("src", "href", "srcset", "action") if key in a]
    assert sources
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)


def test_the_report_forbids_itself_the_network(page: Page) -> None:
    policies = [a["content"] or "" for tag, a in page.tags if tag == "meta" and "http-equiv" in a]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")


def test_the_report_is_smaller_than_two_megabytes(folder: Path) -> None:
    assert 50_000 < (folder / "report.html").stat().st_size < 2_000_000


def test_every_image_is_sound_and_has_its_words(page: Page) -> None:
    """Well-formed SVG without references to elsewhere; over time, spectrum, driver, histogram at least."""
    assert len(page.images()) >= 4
    for image in page.images():
        assert len(image["alt"] or "") > 20
        svg = base64.b64decode((image["src"] or "").partition(",")[2])
        for element in ElementTree.fromstring(svg).iter():
            links = [value for key, value in element.attrib.items() if key.endswith("href")]
            assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)


def test_a_hostile_channel_name_is_text(page: Page, folder: Path) -> None:
    assert "<script>" not in (folder / "report.html").read_text(encoding="utf-8")
    assert f"the recorded channel {HOSTILE}" in page.text


def test_the_report_has_verdict_and_numbers_of_the_json(page: Page, folder: Path) -> None:
    content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    assert page.text.startswith(content["verdict"])
    for value in content["fit"]["held_out_rms_nt"].values():
        assert f"{value:.1f} nT" in page.text
    off = content["fit"]["vectors_off_nt"]
    assert f"off by {measured(off['rms_nt'], off['sigma_nt'])} nT rms" in page.text
    assert f"the noise, {content['fit']['noise_floor_nt']:.1f} nT stated" in page.text
    assert " ".join(content["sentence"].split()) in page.text
    for effect in content["effects"]:
        assert " ".join(effect["says"].split()) in page.text


def test_the_report_says_how_to_repeat_it(page: Page, folder: Path) -> None:
    assert "magcal diagnose " in page.text
    assert f"--out {folder}" in page.text
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert len(set(re.findall(r"<code>([0-9a-f]{64})</code>", html))) == 2


def test_a_result_that_must_not_be_trusted_says_so_on_top(tmp_path: Path) -> None:
    diagnose(recorded("paper", 200.0, tmp_path / "short"), "--out", tmp_path)
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    content = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert (
        0 <= text.index("Do not act on this result.") < text.index(content["sentence"]) < text.index("Before and after")
    )
    assert [one["reason"] for one in content["advice"]] == content["reasons"] != []
    for one in content["advice"]:
        assert f"{one['reason']}: {one['means']}. To lift it: {one['remedy']}." in text


def test_numbers_stand_by_axis_with_sigma_unit_and_range(page: Page, folder: Path) -> None:
    """The bias per kelvin of the JSON is one row of the table: three axes, each with 1 sigma."""
    effects = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))["effects"]
    bias = next(effect["parameters"]["nt_per_k"] for effect in effects if "nt_per_k" in effect["parameters"])
    cells = [measured(value, sigma) for value, sigma in zip(bias["value"], bias["sigma"], strict=True)]
    assert all("±" in cell for cell in cells)
    limit = f"± {bias['range'][1]:.4g}"
    assert "parameter of axis x axis y axis z unit range" in page.cells
    assert f"nt_per_k {' '.join(cells)} nT/K {limit}" in page.cells


def test_the_same_recording_gives_the_same_report(tmp_path: Path) -> None:
    descriptor = recorded("paper", 400.0, tmp_path / "recording")
    pages = []
    for _ in range(2):
        diagnose(descriptor, "--out", tmp_path, drawn=True)
        pages.append((tmp_path / "report.html").read_bytes())
    assert pages[0] == pages[1]


@pytest.mark.parametrize(
    ("nats", "words"),
    [
        (0.0, "odds of 1 to 1"),
        (12.0, "odds of 160 000 to 1"),
        (20.0, "odds of about 10^9 to 1"),
        (27.7, "odds beyond 10^12 to 1"),
        (7303.0, "odds beyond 10^12 to 1"),
    ],
)
def test_evidence_is_said_as_odds(nats: float, words: str) -> None:
    assert odds(nats) == words


def test_a_probability_is_never_a_certainty() -> None:
    assert (chance(1.0), chance(0.998), percent(1.0)) == ("> 99.9 %", "99.8 %", "100 %")


def test_significance_has_a_word() -> None:
    assert [strength(nats) for nats in (5.0, 8.0, 13.0, 100.0)] == ["weak", "clear", "very strong", "beyond doubt"]


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_a_phone_shows_the_page_without_sideways_scrolling(folder: Path, tmp_path: Path) -> None:
    """At a width of 360 pixels nothing of the page is wider."""
    frame = tmp_path / "frame.html"
    frame.write_text(
        f'<iframe id="f" src="{(folder / "report.html").as_uri()}" style="width:360px;height:800px;border:0"></iframe>'
        '<script>onload=()=>{const d=document.getElementById("f").contentDocument.scrollingElement;'
        "document.title=`${d.clientWidth} ${d.scrollWidth}`}</script>",
        encoding="utf-8",
    )
    flags = [
        "--headless",
        "--no-sandbox",
        "--hide-scrollbars",
        "--allow-file-access-from-files",
        f"--user-data-dir={tmp_path}",
    ]
    page = subprocess.run(
        ["chromium", *flags, "--dump-dom", frame.as_uri()], capture_output=True, text=True, timeout=60, check=True
    ).stdout
    widths = re.search(r"<title>(\d+) (\d+)</title>", page)
    assert widths is not None
    assert widths[1] == "360" == widths[2]
