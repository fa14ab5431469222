"""The documentation site: Sphinx over the pages of README, CONTRIBUTING, CHANGELOG and docs/, as they stand there.

``make site`` builds it into site/<version>/, with warnings as errors.
"""

import json
import re
import sys
import tomllib
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tiltcal import __version__  # noqa: E402

SITE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Documentation"]

project = "tiltcal"
author = "The tiltcal authors"
version = release = __version__

extensions = ["myst_parser", "sphinx_copybutton"]
root_doc = "README"
include_patterns = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "benchmarks/README.md",
    "examples/README.md",
    "docs/**.md",
]
myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline"]
suppress_warnings = ["misc.highlighting_failure"]

html_theme = "pydata_sphinx_theme"
html_title = f"tiltcal {version}"
html_sidebars = {"**": ["contents.html"]}
templates_path = ["_templates"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_center": [],
    "navbar_end": ["version-switcher", "theme-switcher"],
    "switcher": {
        "json_url": f"{SITE}versions.json",
        "version_match": version,
    },
    "check_switcher": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
}

CHAPTERS = {
    "First steps": ["docs/tutorial", "docs/which-sensor", "docs/wiring"],
    "How to": ["docs/how-to/README", "docs/season", "docs/library", "examples/README", "docs/add-a-device"],
    "Understand": ["docs/explanation", "docs/glossary"],
    "Reference": ["docs/reference/cli", "docs/reference/files", "docs/reference/protocol", "docs/reference/library"],
    "Develop": [
        "docs/architecture",
        "CONTRIBUTING",
        "docs/decisions/README",
        "benchmarks/README",
        "SECURITY",
        "CHANGELOG",
    ],
}
"""The pages of each chapter in order; a README of a folder stands for the other pages of the folder."""


NAMED_BLOCK = re.compile(r"^```(\w+) (\S+)$", re.MULTILINE)
"""A block of a page with the name of its file behind the language."""


def add_contents(_: Sphinx, page: str, source: list[str]) -> None:
    """Show the file names of blocks, and append the table of contents to a README, which has none on other sites."""
    source[0] = NAMED_BLOCK.sub(r"```{code-block} \1\n:caption: \2\n", source[0])
    if page == root_doc:
        for chapter, pages in CHAPTERS.items():
            there = [one for one in pages if (ROOT / f"{one}.md").is_file()]
            source[0] += _contents(there, f":caption: {chapter}")
    elif page.startswith("docs/") and page.endswith("/README"):
        folder = (ROOT / page).parent
        listed = re.findall(r"\]\((?!\.\./)([\w-]+)\.md\)", source[0])
        others = sorted(path.stem for path in folder.glob("*.md") if path.stem not in (*listed, "README"))
        source[0] += _contents(list(dict.fromkeys([*listed, *others])))


def _contents(pages: list[str], *options: str) -> str:
    return "\n\n```{toctree}\n:hidden:\n" + "\n".join([*options, "", *pages]) + "\n```\n"


def add_versions(app: Sphinx, _: Exception | None) -> None:
    """Write what leads to the README, and beside the folder of this version the list of all that are there."""
    here = Path(app.outdir)
    forward = (
        '<!doctype html><title>tiltcal</title><meta name="viewport" content="width=device-width">\n'
        '<meta http-equiv="refresh" content="0; url={0}"><a href="{0}">The documentation of tiltcal</a>\n'
    )
    (here / "_static" / "webpack-macros.html").unlink(missing_ok=True)  # a template of the theme, no page
    (here / "index.html").write_text(forward.format(f"{root_doc}.html"), encoding="utf-8")
    (here.parent / "index.html").write_text(forward.format(f"{here.name}/"), encoding="utf-8")
    there = sorted((path.parent.name for path in here.parent.glob("*/index.html")), reverse=True)
    listed = [{"name": name, "version": name, "url": f"{SITE}{name}/"} for name in there]
    (here.parent / "versions.json").write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Connect the functions above to the events of a build."""
    app.connect("source-read", add_contents)
    app.connect("build-finished", add_versions)
