"""An HTML page as a reader of it finds it: its headings, tables, figures and whatever it would fetch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any, BinaryIO
from unittest.mock import patch

VOID = {"br", "hr", "img", "input", "link", "meta"}
EMPTY = b'<svg viewBox="0 0 1 1"></svg>'


@contextmanager
def undrawn() -> Iterator[None]:
    """Leave the figures of a page empty."""
    with patch("tiltcal.report.figure.save", lambda plot, stream, *style: stream.write(EMPTY)):
        yield


@contextmanager
def drawings() -> Iterator[dict[str, Any]]:
    """Leave the figures of a page empty, and keep them by name as matplotlib has them, and how high they are."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from tiltcal.report.figure import _STYLE

    kept: dict[str, Any] = {}

    def keep(plot: Any, stream: BinaryIO, width: float, height: float, salt: str = "tiltcal", *_: float) -> None:
        with rc_context(_STYLE):
            kept[salt.removeprefix("tiltcal-")] = figure = Figure(figsize=(width, height))
            plot(figure)
        stream.write(EMPTY)

    with patch("tiltcal.report.figure.save", keep):
        yield kept


@dataclass
class Element:
    """A tag with its attributes, and what is in it."""

    tag: str
    attributes: dict[str, str]
    inside: list[Element | str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """All text, one blank for any white space."""
        return " ".join("".join(self._texts()).split())

    def _texts(self) -> list[str]:
        return [one if isinstance(one, str) else "".join(one._texts()) for one in self.inside]

    def find(self, *tags: str) -> list[Element]:
        """Every element of these tags below this one, in order."""
        found = []
        for one in self.inside:
            if isinstance(one, Element):
                found += [one] * (one.tag in tags) + one.find(*tags)
        return found


class Page(HTMLParser):
    """A parsed page; tags that are not closed, or closed twice, are an error."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.root = Element("", {})
        self._open = [self.root]
        self.feed(text)
        self.close()
        assert self._open == [self.root], f"<{self._open[-1].tag}> is not closed"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            last = self._open[-1].inside[-1]
            assert isinstance(last, Element)
            self._open.append(last)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open[-1].inside.append(Element(tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self._open[-1].tag == tag, f"</{tag}> closes <{self._open[-1].tag}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        self._open[-1].inside.append(data)

    @property
    def headings(self) -> list[tuple[int, str]]:
        """Levels and texts of the headings, in order."""
        return [(int(one.tag[1]), one.text) for one in self.root.find("h1", "h2", "h3", "h4", "h5", "h6")]

    @property
    def facts(self) -> dict[str, str]:
        """What the tables of labels and values say."""
        tables = [one for one in self.root.find("table") if one.attributes.get("class", "").startswith("facts")]
        return {row.find("th")[0].text: row.find("td")[0].text for table in tables for row in table.find("tr")}

    def below(self, heading: str) -> list[list[str]]:
        """The rows of the first table below a heading, cell by cell."""
        seen = False
        for one in self.root.find("h2", "h3", "table"):
            seen = seen or (one.tag != "table" and one.text == heading)
            if seen and one.tag == "table" and not one.attributes.get("class", "").startswith("facts"):
                return [[cell.text for cell in row.find("th", "td")] for row in one.find("tr")]
        raise AssertionError(f"no table below {heading!r}")
