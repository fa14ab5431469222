"""YAML 1.2 with locations: every value has its file, line and key.

PyYAML alone reads ``1e-8`` as text, ``0042`` as 34, ``12:30`` as 750 and the second of two equal keys in silence. Here
its parser gives only the events; what a scalar means is decided by the reader's expectation under the YAML 1.2 core
schema::

    top = read_document(path).mapping(required=("name", "samples"), optional=("settle",))
    name = top["name"].text()
    samples = top["samples"].integer(minimum=2)

Anchors, aliases and tags are refused: no file of ours needs them, and a bomb is made of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from tiltcal.errors import InputError
from tiltcal.files.node import DEPTH_LIMIT, Node, Scalar, item_key, member_key, require_printable
from tiltcal.stated_arguments import require_path

SIZE_LIMIT = 4_000_000
"""Bytes; the largest calibration file seen is a hundredth of it."""
NODE_LIMIT = 200_000


def read_document(path: str | Path) -> Node:
    """Read one YAML document from a file.

    Raises
    ------
    InputError
        The file is not there, is too large, is not UTF-8, is not YAML, or uses what is refused here.
    """
    return parse_document(read_text(path), file=str(path))


def read_text(path: str | Path) -> str:
    """Return the text of a small file in UTF-8.

    Raises
    ------
    InputError
        No such file, a folder, no permission, more than ``SIZE_LIMIT`` bytes, or not UTF-8.
    """
    require_path("a file", path)
    try:
        with open(path, "rb") as stream:
            size = Path(path).stat().st_size
            # A pipe or device has no size of its own, so what is read is bounded too.
            data = b"" if size > SIZE_LIMIT else stream.read(SIZE_LIMIT + 1)
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except IsADirectoryError:
        raise InputError("this is a folder; name a file in it", file=path) from None
    except (OSError, ValueError) as failure:
        raise InputError(f"cannot be read: {getattr(failure, 'strerror', None) or failure}", file=path) from None
    if size > SIZE_LIMIT or len(data) > SIZE_LIMIT:
        found = f"{size:,} bytes" if size > SIZE_LIMIT else "more bytes than that"
        raise InputError(f"the file is too large: at most {SIZE_LIMIT:,} bytes are read, found {found}", file=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        line = data.count(b"\n", 0, failure.start) + 1
        byte = data[failure.start]
        raise InputError(f"not UTF-8 (byte 0x{byte:02x}); save the file as UTF-8", file=path, line=line) from None


def parse_document(text: str, file: str | None = None, language: str = "YAML") -> Node:
    """Parse one YAML document; an InputError names ``file`` and line of what is not YAML, or is refused here.

    Parameters
    ----------
    language : str
        What the document is called in messages: JSON is YAML, too.
    """
    return _Composer(file, language).compose(text)


@dataclass
class _OpenCollection:
    """A collection whose end was not read yet."""

    node: Node
    key: str | None = None
    key_line: int | None = None


class _Composer:
    """Builds the tree from the parser's events, with a stack of its own: depth costs no recursion."""

    def __init__(self, file: str | None, language: str) -> None:
        self._file = file
        self._language = language
        self._stack: list[_OpenCollection] = []
        self._root: Node | None = None
        self._count = 0

    def compose(self, text: str) -> Node:
        try:
            # The C library, where PyYAML was built with it.
            for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
                self._take(event)
        except yaml.MarkedYAMLError as failure:
            mark = failure.problem_mark or failure.context_mark
            problem = failure.problem or failure.context or "the parser gives no reason"
            # What is missing at the end is reported for the last line, not for the one after it.
            line = None if mark is None else min(mark.line + 1, len(text.splitlines()))
            raise self._error(f"not {self._language}: {problem}", line) from None
        except yaml.reader.ReaderError as failure:
            line = text.encode().count(b"\n", 0, failure.position) + 1
            raise self._error(f"not {self._language}: {failure.reason}", line) from None
        except (yaml.YAMLError, UnicodeError) as failure:
            raise self._error(f"not {self._language}: {failure}", None) from None
        if self._root is None:
            raise self._error("the file is empty", None)
        return self._root

    def _take(self, event: yaml.Event) -> None:
        mark = event.start_mark
        line = 1 if mark is None else mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise self._error(f"the alias *{event.anchor} is not allowed; write the value out", line)
        if isinstance(event, yaml.NodeEvent):
            self._refuse_extras(event, line)
        if isinstance(event, yaml.ScalarEvent):
            self._add_scalar(event, line)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._begin({} if isinstance(event, yaml.MappingStartEvent) else [], line)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._stack.pop()
        elif isinstance(event, yaml.DocumentStartEvent) and self._root is not None:
            raise self._error("a second document begins; keep one document per file", line)

    def _refuse_extras(self, event: yaml.NodeEvent, line: int) -> None:
        if event.anchor is not None:
            raise self._error(f"the anchor &{event.anchor} is not allowed; write the value out", line)
        if getattr(event, "tag", None) is not None:
            raise self._error(f"the tag {event.tag} is not allowed; write the value alone", line)  # type: ignore[attr-defined]
        self._count += 1
        if self._count > NODE_LIMIT:
            raise self._error(f"more than {NODE_LIMIT:,} values in one file", line)

    def _add_scalar(self, event: yaml.ScalarEvent, line: int) -> None:
        scalar = Scalar(event.value, plain=not event.style)
        parent = self._stack[-1] if self._stack else None
        if parent is not None and isinstance(parent.node.content, dict) and parent.key is None:
            self._name_next(parent, parent.node.content, scalar, line)
        else:
            self._place(scalar, line)

    def _name_next(self, parent: _OpenCollection, entries: dict[str, Node], scalar: Scalar, line: int) -> None:
        """Take a scalar as the key of the value that follows."""
        require_printable(scalar.text, self._file, line, parent.node.key)
        key = member_key(parent.node.key, scalar.text)
        meaning = Node(scalar, self._file, line, key).plain() if scalar.plain else scalar.text
        if not isinstance(meaning, str):
            raise self._error(f"the key {scalar.text or 'null'} is not text; put it in quotes", line, parent.node.key)
        if scalar.text in entries:
            first = entries[scalar.text].line
            raise self._error(f"the key {scalar.text!r} is given twice, on lines {first} and {line}", line, key)
        parent.key, parent.key_line = scalar.text, line

    def _begin(self, content: list[Node] | dict[str, Node], line: int) -> None:
        if len(self._stack) >= DEPTH_LIMIT:
            raise self._error(f"nested deeper than {DEPTH_LIMIT}", line)
        parent = self._stack[-1] if self._stack else None
        if parent is not None and isinstance(parent.node.content, dict) and parent.key is None:
            raise self._error("a key is a list or a mapping; keys are text", line, parent.node.key)
        self._stack.append(_OpenCollection(self._place(content, line)))

    def _place(self, content: Scalar | list[Node] | dict[str, Node], line: int) -> Node:
        """Put a value where the innermost open collection expects it."""
        if not self._stack:
            self._root = Node(content, self._file, line, None)
            return self._root
        parent = self._stack[-1]
        if isinstance(parent.node.content, dict) and parent.key is not None:
            node = Node(content, self._file, parent.key_line, member_key(parent.node.key, parent.key))
            parent.node.content[parent.key] = node
            parent.key = None
        elif isinstance(parent.node.content, list):
            node = Node(content, self._file, line, item_key(parent.node.key, len(parent.node.content)))
            parent.node.content.append(node)
        else:
            raise self._error("a value stands without a key", line, parent.node.key)
        return node

    def _error(self, message: str, line: int | None, key: str | None = None) -> InputError:
        return InputError(message, file=self._file, line=line, key=key)
