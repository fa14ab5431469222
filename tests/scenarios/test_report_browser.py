"""The page in Chromium: nothing to complain of, nothing to fetch, and paper in A4."""

import re
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import FIXTURES
from support.browser import CHROMIUM, Browser, Tab, browser

from tiltcal.cli.main import run

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: apt install chromium")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as running:
        yield running


def opened(chromium: Browser, page: Path) -> Tab:
    """Open a page, and note what it complains of and asks for."""
    chromium.complaints.clear()
    chromium.requests.clear()
    tab = chromium.open("about:blank")
    tab("Network.enable")
    tab("Page.navigate", url=page.as_uri())
    tab.until("document.readyState == 'complete' && location.protocol == 'file:'")
    return tab


def test_it_is_quiet_complete_in_itself_and_prints_on_a4(chromium: Browser, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert run(["report", str(FIXTURES / "complete.yaml"), "-o", str(page)]) == 0
    tab = opened(chromium, page)
    assert (chromium.complaints, [url for url in chromium.requests if url != page.as_uri()]) == ([], [])
    pdf = b64decode(tab("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 5
    sizes = {tuple(map(float, box.split()[2:])) for box in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", pdf)}
    assert all(abs(width - 595.3) < 1 and abs(height - 841.9) < 1 for width, height in sizes)
    assert sizes


def test_a_page_that_fetches_and_complains_would_be_seen(chromium: Browser, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text('<img src="absent.png"><script>console.error("no")</script>', encoding="utf-8")
    opened(chromium, page)
    assert (len(chromium.complaints), len(chromium.requests)) == (1, 2)


TOO_WIDE = """[...document.querySelectorAll("table")].filter((table) => table.getBoundingClientRect().right >
  document.querySelector("main").getBoundingClientRect().right + 1).length"""


@pytest.mark.parametrize("name", ["rotation", "temperature-sweep", "free", "fleet"])
def test_no_table_is_wider_than_the_page(chromium: Browser, name: str, tmp_path: Path) -> None:
    page, source = tmp_path / "report.html", FIXTURES / f"{name}.yaml"
    if name == "fleet":
        source = tmp_path / name
        source.mkdir()
        text = (FIXTURES / "plane.yaml").read_text(encoding="utf-8").replace("SIM-42", "S-" + "0123456789" * 20)
        for year in ("2000", "2001"):
            (source / f"{'long' * 30}-{year}.yaml").write_text(text.replace("2000-01", f"{year}-01"), encoding="utf-8")
    assert run(["report", str(source), "-o", str(page)]) == 0
    tab = opened(chromium, page)
    for window in (1200, 500):
        tab("Emulation.setDeviceMetricsOverride", width=window, height=900, deviceScaleFactor=1, mobile=False)
        assert tab.value("innerWidth") == window
        assert tab.value("document.documentElement.scrollWidth") <= window
        assert tab.value(TOO_WIDE) == 0
