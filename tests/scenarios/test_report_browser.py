"""The page in Chromium: nothing to complain of, nothing to fetch, and paper in A4."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from support import FIXTURES
from support.browser import CHROMIUM
from support.browser import QUIET as QUIET_BROWSER

from tiltcal.cli.main import run

QUIET = (*QUIET_BROWSER, "--enable-logging=stderr", "--no-pdf-header-footer")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: apt install chromium")


def printed(page: Path, folder: Path) -> tuple[bytes, list[str], str]:
    """The page as PDF, what the browser's console says, and the log of its network."""
    pdf, net = folder / "page.pdf", folder / "net.json"
    places = [f"--user-data-dir={folder / 'profile'}", f"--log-net-log={net}", f"--print-to-pdf={pdf}"]
    done = subprocess.run(
        [str(CHROMIUM), *QUIET, *places, page.as_uri()], capture_output=True, text=True, timeout=60, check=False
    )
    assert pdf.exists(), done.stderr
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    return pdf.read_bytes(), console, net.read_text(encoding="utf-8")


def test_it_is_quiet_complete_in_itself_and_prints_on_a4(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert run(["report", str(FIXTURES / "complete.yaml"), "-o", str(page)]) == 0
    pdf, console, net = printed(page, tmp_path)
    assert console == []
    assert "[internally: file://]" not in net  # as it stands with every request that a page on the disk makes
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 5
    sizes = {tuple(map(float, box.split()[2:])) for box in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", pdf)}
    assert all(abs(width - 595.3) < 1 and abs(height - 841.9) < 1 for width, height in sizes)
    assert sizes


def test_a_page_that_fetches_and_complains_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text('<img src="http://x.invalid/x.png"><script>console.error("no")</script>', encoding="utf-8")
    _, console, net = printed(page, tmp_path)
    assert len(console) == 1
    assert "[internally: file://]" in net


MEASURE = """<script>
const wide = [...document.querySelectorAll("table")].filter(
  (table) => table.getBoundingClientRect().right > document.querySelector("main").getBoundingClientRect().right + 1);
const page = document.documentElement;
document.title = `${document.querySelectorAll("table").length} tables, ${wide.length} too wide, ` +
  `${page.scrollWidth - page.clientWidth} beyond the window`;
</script>"""


@pytest.mark.parametrize("window", [1200, 500])
@pytest.mark.parametrize("name", ["rotation", "temperature-sweep", "free", "fleet"])
def test_no_table_is_wider_than_the_page(name: str, window: int, tmp_path: Path) -> None:
    page, source = tmp_path / "report.html", FIXTURES / f"{name}.yaml"
    if name == "fleet":
        source = tmp_path / name
        source.mkdir()
        text = (FIXTURES / "plane.yaml").read_text(encoding="utf-8").replace("SIM-42", "S-" + "0123456789" * 20)
        for year in ("2000", "2001"):
            (source / f"{'long' * 30}-{year}.yaml").write_text(text.replace("2000-01", f"{year}-01"), encoding="utf-8")
    assert run(["report", str(source), "-o", str(page)]) == 0
    text = re.sub("<meta http-equiv=.Content-Security-Policy.[^>]*>", "", page.read_text(encoding="utf-8"))
    page.write_text(text + MEASURE, encoding="utf-8")
    options = [*QUIET, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={window},900", "--dump-dom"]
    done = subprocess.run(
        [str(CHROMIUM), *options, page.as_uri()], capture_output=True, text=True, timeout=60, check=False
    )
    (title,) = re.findall("<title>(.*?)</title>", done.stdout)
    assert re.fullmatch(r"\d+ tables, 0 too wide, 0 beyond the window", title)
