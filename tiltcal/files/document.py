"""YAML 1.2 with locations: a document is plain data whose scalars stay text, and the line of every value.

PyYAML alone reads ``1e-8`` as text, ``0042`` as 34, ``12:30`` as 750 and the second of two equal keys in silence. Here
its parser gives only the events; the type of a record decides what a scalar means. Anchors, aliases and tags are
refused: no file of ours needs them, and a bomb is made of them.

msgspec converts a sound document at once. Where it refuses one, the data are taken part by part, which finds the
place, also in a mapping with free keys, and converts what YAML allows and msgspec does not: numbers such as ``.5`` or
``0x1d``, keys by their former names, and optional keys that hold nothing.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import takewhile
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import yaml

from tiltcal.errors import InputError, TiltcalError
from tiltcal.files.moments import moment
from tiltcal.files.record import FORMAT_VERSION, KINDS
from tiltcal.files.refusal import FLOAT, NOT_FINITE, WHOLE, Quoted, beyond, numeral, refusal, unknown
from tiltcal.stated_arguments import require_path, require_printable

T = TypeVar("T")
Alternative = tuple[Any, tuple[msgspec.Meta, ...]]
"""A type without its annotations, and these."""
Place = tuple[str | int, ...]

SIZE_LIMIT = 4_000_000
"""Bytes; the largest calibration file seen is a hundredth of it."""
NODE_LIMIT = 200_000
DEPTH_LIMIT = 32

CONTROL_OR_NO_TEXT = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
_NULL = re.compile(r"null|Null|NULL|~|")
_TRUTH = {word: word.lower() == "true" for word in ("true", "True", "TRUE", "false", "False", "FALSE")}
_OTHER_THAN_TEXT = re.compile("|".join([_NULL.pattern, *_TRUTH, WHOLE.pattern, FLOAT.pattern, NOT_FINITE.pattern]))


@dataclass(frozen=True)
class Document:
    """The data of a document, or of a part of it: mappings, lists, texts, None; numbers where it came from a program.

    ``lines`` are those of keys and of items by their place in the whole document; ``place`` is that of the part.
    """

    data: Any
    lines: Mapping[Place, int]
    file: str | None = None
    place: Place = ()

    def at(self, *place: str | int) -> Document:
        """Return a part of the document."""
        data = self.data
        for step in place:
            data = data[step]
        return Document(data, self.lines, self.file, (*self.place, *place))

    def child(self, *place: str | int) -> Document:
        """Return a part for its location alone."""
        return Document(None, self.lines, self.file, (*self.place, *place))

    def items(self) -> list[Document]:
        """Return the members of a list; an InputError where it is none."""
        if not isinstance(self.data, list):
            raise self.error(refusal(self.data, list))
        return [self.at(number) for number in range(len(self.data))]

    @property
    def line(self) -> int | None:
        """The line of the part."""
        around = (self.place[:k] for k in range(len(self.place), -1, -1))
        return next((self.lines[place] for place in around if place in self.lines), None)

    @property
    def key(self) -> str | None:
        """The dotted path of the part; None of a whole document."""
        steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in self.place)
        return "".join(steps).removeprefix(".") or None

    def members(self) -> dict[str, Any]:
        """Return the data of a mapping; an InputError where it is none."""
        if not isinstance(self.data, dict):
            raise self.error(refusal(self.data, dict))
        return self.data

    @property
    def kind(self) -> str | None:
        """The kind that a whole file states; an InputError where it is no mapping."""
        kind = self.members().get("kind")
        return str(kind) if isinstance(kind, str) else None

    def error(self, message: str, *place: str | int) -> InputError:
        """Return an error with file, line and key of a place in it, to be raised."""
        part = self.child(*place)
        return InputError(message, file=part.file, line=part.line, key=part.key)

    @contextmanager
    def locating(self, *place: str | int) -> Iterator[None]:
        """Give errors that are raised in the block the location of a place."""
        try:
            yield
        except TiltcalError as failure:
            raise self.error(str(failure), *place) from None

    def require_keys(
        self, names: Collection[str], known: Collection[str], *place: str | int, complete: bool = False
    ) -> None:
        """Refuse names of keys of a place that are not known and, where they are complete, one that is missing."""
        for name in names:
            if name not in known:
                raise self.error(unknown(name, known), *place, name)
        missing = [name for name in known if name not in names] if complete else []
        if missing:
            raise self.error(f"the key {missing[0]!r} is missing; it is required here", *place)

    def require_order(self, interval: tuple[float, float] | None, *place: str | int) -> None:
        """Refuse a range ``[low, high]`` at a place that is the wrong way round."""
        if interval is not None and interval[0] > interval[1]:
            low, high = interval
            raise self.error(f"the range [{low:g}, {high:g}] is the wrong way round; write [low, high]", *place)

    def require_moments(self, section: Any, *keys: str, place: Place = ()) -> None:
        """Refuse texts of a section that are no moments in ISO 8601."""
        for key in keys:
            if (text := getattr(section, key)) is not None:
                with self.locating(*place, key):
                    moment(text)

    def read(self, record: type[T]) -> T:
        """Return the document as a record; an InputError names file, line and key of what is wrong."""
        if not self._has_quoted_values(self.data, self.place):
            with suppress(msgspec.ValidationError):
                return msgspec.convert(self.data, record, strict=False)
        return msgspec.convert(_repaired(self, record), record, strict=False)

    def body(self, kind: str) -> Document:
        """Return a file without the keys ``tiltcal`` and ``kind``, which are checked."""
        stated = self.kind
        for name in ("tiltcal", "kind"):
            if self.data.get(name) is None:
                raise self.error(f"the key {name!r} is missing; {KINDS[kind]} has 'tiltcal: 1' and 'kind: {kind}'")
        version = self.data["tiltcal"]
        if version not in (FORMAT_VERSION, str(FORMAT_VERSION)):
            if numeral(version, int) is None:
                raise self.error(refusal(version, int), "tiltcal")
            raise self.error(f"format version {version} is not known; this program reads {FORMAT_VERSION}", "tiltcal")
        if stated not in KINDS:
            raise self.error(refusal(self.data["kind"], KINDS), "kind")
        if stated != kind:
            raise self.error(f"this file is {KINDS[stated]}; {KINDS[kind]} is needed here (kind: {kind})", "kind")
        data = {name: value for name, value in self.data.items() if name not in ("tiltcal", "kind")}
        return Document(data, self.lines, self.file, self.place)

    def plain(self) -> Any:
        """Return the document as plain data, by the core schema of YAML 1.2; an InputError where it has NaN."""
        data = self.data
        if isinstance(data, dict):
            return {name: self.at(name).plain() for name in data}
        if isinstance(data, list):
            return [item.plain() for item in self.items()]
        if not isinstance(data, str) or isinstance(data, Quoted):
            return str(data) if isinstance(data, Quoted) else data
        number = numeral(data, int if WHOLE.fullmatch(data) else float)
        if NOT_FINITE.fullmatch(data) or (number is not None and not isfinite(number)):
            raise self.error(f"{data[:40]} is no finite number")
        return _TRUTH.get(data, data) if number is None else number

    def _has_quoted_values(self, data: Any, place: Place) -> bool:
        """Return whether a text in quotes looks like a number or a truth; refuse control characters."""
        if isinstance(data, str):
            if CONTROL_OR_NO_TEXT.search(data):
                part = Document(data, self.lines, self.file, place)
                require_printable(data, part.key, part.file, part.line)
            return isinstance(data, Quoted) and _OTHER_THAN_TEXT.fullmatch(data.lower()) is not None
        if isinstance(data, dict | list):
            members = data.items() if isinstance(data, dict) else enumerate(data)
            # Every member is looked at.
            return sum(self._has_quoted_values(member, (*place, step)) for step, member in members) > 0
        return False


def read_document(path: str | Path) -> Document:
    """Read one YAML document from a file; an InputError where it cannot be read, or uses what is refused here."""
    return parse_document(read_text(path), file=str(path))


def read_text(path: str | Path) -> str:
    """Return the text of a file of at most ``SIZE_LIMIT`` bytes of UTF-8; an InputError where it cannot be read."""
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


def parse_document(text: str, file: str | None = None, language: str = "YAML") -> Document:
    """Parse one YAML document, or JSON, which is YAML; an InputError names ``file`` and line of what is refused."""
    return _Composer(file, language).compose(str(text))


class _Composer:
    """Builds the data from the parser's events; how deep and how many they are is limited."""

    def __init__(self, file: str | None, language: str) -> None:
        self._file = file
        self._language = language
        self._lines: dict[Place, int] = {}
        self._count = 0

    def compose(self, text: str) -> Document:
        roots: list[Any] = []
        try:
            # The C library, where PyYAML was built with it.
            events = yaml.parse(text, Loader=getattr(yaml, "CBaseLoader", yaml.BaseLoader))
            for event in events:
                if isinstance(event, yaml.DocumentStartEvent) and roots:
                    raise self._error("a second document begins; keep one document per file", _line(event))
                if isinstance(event, yaml.NodeEvent):
                    roots.append(self._value(event, events, ()))
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
        if not roots:
            raise self._error("the file is empty", None)
        return Document(roots[0], self._lines, self._file)

    def _value(self, event: yaml.Event, events: Iterator[yaml.Event], place: Place) -> Any:
        """Return the value that begins with an event, and take the events up to its end."""
        line = self._checked(event)
        self._lines.setdefault(place, line)
        if isinstance(event, yaml.ScalarEvent):
            return None if not event.style and _NULL.fullmatch(event.value) else _text(event)
        if len(place) >= DEPTH_LIMIT:
            raise self._error(f"nested deeper than {DEPTH_LIMIT}", line)
        parts = takewhile(lambda part: not isinstance(part, yaml.CollectionEndEvent), events)
        if isinstance(event, yaml.SequenceStartEvent):
            return [self._value(part, events, (*place, number)) for number, part in enumerate(parts)]
        data: dict[str, Any] = {}
        for part in parts:
            name = self._key(part, data, place)
            data[name] = self._value(next(events), events, (*place, name))
        return data

    def _key(self, event: yaml.Event, members: Mapping[str, Any], parent: Place) -> str:
        line = self._checked(event)
        if not isinstance(event, yaml.ScalarEvent):
            raise self._error("a key is a list or a mapping; keys are text", line, parent)
        text = str(event.value)
        place = (*parent, text)
        require_printable(text, Document(None, {}, place=parent).key, self._file, line)
        if not event.style and _OTHER_THAN_TEXT.fullmatch(text):
            raise self._error(f"the key {text or 'null'} is not text; put it in quotes", line, parent)
        if text in members:
            first = self._lines[place]
            raise self._error(f"the key {text!r} is given twice, on lines {first} and {line}", line, place)
        self._lines[place] = line
        return text

    def _checked(self, event: Any) -> int:
        """Return the line of a value or a key; anchors, aliases, tags and bombs are refused."""
        line = _line(event)
        if isinstance(event, yaml.AliasEvent):
            raise self._error(f"the alias *{event.anchor} is not allowed; write the value out", line)
        if event.anchor is not None:
            raise self._error(f"the anchor &{event.anchor} is not allowed; write the value out", line)
        if event.tag is not None:
            raise self._error(f"the tag {event.tag} is not allowed; write the value alone", line)
        self._count += 1
        if self._count > NODE_LIMIT:
            raise self._error(f"more than {NODE_LIMIT:,} values in one file", line)
        return line

    def _error(self, message: str, line: int | None, place: Place = ()) -> InputError:
        return InputError(message, file=self._file, line=line, key=Document(None, {}, place=place).key)


def _line(event: yaml.Event) -> int:
    return 1 if event.start_mark is None else int(event.start_mark.line) + 1


def _text(event: yaml.ScalarEvent) -> str:
    return Quoted(event.value) if event.style else str(event.value)


def document_of(data: Any, file: str | None = None, line: int | None = None) -> Document:
    """Return plain data as a document, so that the code that checks a file checks a record too.

    Errors name ``file`` and ``line``, where the record stands; data of other types, or too deep, is one.
    """
    lines: dict[Place, int] = {} if line is None else {(): line}
    return Document(_taken(data, Document(None, lines, file)), lines, file)


def _taken(data: Any, part: Document) -> Any:
    """Return plain data as those of a document: texts of a program are in quotes."""
    if len(part.place) > DEPTH_LIMIT:
        raise part.error(f"nested deeper than {DEPTH_LIMIT}")
    if isinstance(data, Mapping):
        for name in data:
            require_printable(str(name), part.key, part.file, part.line)
        return {str(name): _taken(value, part.child(str(name))) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [_taken(value, part.child(number)) for number, value in enumerate(data)]
    if isinstance(data, str):
        return Quoted(data)
    if data is None or isinstance(data, bool | int | float):
        return data
    raise part.error(f"a number or a text is needed, not a {type(data).__name__}")


def _repaired(part: Document, kind: Any) -> Any:
    """Return the data of a part as msgspec takes them; an InputError names the first place that a type refuses."""
    value, alternatives = part.data, _alternatives(kind)
    shape = next((one for one in (dict, list) if isinstance(value, one)), None)
    base, metas = next((one for one in alternatives if _shape(one[0]) is shape), alternatives[0])
    if base is Any:
        return value
    if _shape(base) != shape:
        raise part.error(refusal(value, _shape(base) or base))
    if shape is dict:
        return _mapping(part, base)
    if shape is list:
        return _list(part, base, metas)
    literals = [get_args(one) for one, _ in alternatives if getattr(one, "__origin__", None) is Literal]
    return value if any(value in words for words in literals) else _scalar(part, base, metas)


def _mapping(part: Document, base: Any) -> dict[str, Any]:
    if get_origin(base) is not None:
        name_kind, kind = get_args(base)
        names = _words(_alternatives(name_kind)[0][1])
        kinds, needed = dict.fromkeys(names or part.data, kind), set() if names else set(part.data)
    else:
        fields = msgspec.structs.fields(base)
        kinds = {one.encode_name: one.type for one in fields}
        needed = {one.encode_name for one in fields if one.required}
        part = replace(part, data=_renamed(part, kinds))
    part.require_keys(part.data, kinds)
    part.require_keys(part.data, [name for name in kinds if name in needed or name in part.data], complete=True)
    return {
        name: _repaired(part.at(name), one)
        for name, one in kinds.items()
        if name in part.data and (name in needed or part.data[name] is not None)
    }


def _renamed(part: Document, kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Return a section by the present names of its keys."""
    metas = ((meta, name) for name, kind in kinds.items() for meta in getattr(kind, "__metadata__", ()))
    former = {meta.extra["formerly"]: name for meta, name in metas if meta.extra and meta.extra.get("formerly")}
    for name in part.data:
        if (present := former.get(name)) in part.data:
            raise part.error(f"this is the key {present!r} by its present and its former name: leave one out", name)
    return {former.get(name, name): member for name, member in part.data.items()}


def _list(part: Document, base: Any, metas: tuple[msgspec.Meta, ...]) -> list[Any]:
    kinds, count = get_args(base), len(part.data)
    least = most = None if kinds[-1] is Ellipsis else len(kinds)
    for meta in metas:
        least, most = meta.min_length or least, meta.max_length or most
    if count < (least or 0) or count > (count if most is None else most):
        bounds = f"{least}" if least == most else f"at least {least}" if most is None else f"{least or 0} to {most}"
        bounds = f"at most {most}" if not least else bounds
        raise part.error(f"a list of {bounds} values is needed here, found {count}")
    fixed = kinds[:1] * count if kinds[-1] is Ellipsis else kinds
    return [_repaired(item, kind) for item, kind in zip(part.items(), fixed, strict=True)]


def _scalar(part: Document, base: Any, metas: tuple[msgspec.Meta, ...]) -> Any:
    value = part.data
    number = numeral(value, base) if base in (float, int) else value
    if number is None:
        raise part.error(refusal(value, base))
    try:
        if base is bool and isinstance(value, Quoted):
            raise msgspec.ValidationError
        msgspec.convert(number, Annotated[(base, *metas)] if metas else base, strict=False)
    except msgspec.ValidationError:
        if base in (float, int):
            raise part.error(beyond(value, number, metas)) from None
        says = next((meta.extra["says"] for meta in metas if meta.extra and "says" in meta.extra), "")
        if says and isinstance(value, str) and value.strip():
            raise part.error(f"{value!r} is not {says}") from None
        raise part.error(refusal(value, _words(metas) or get_args(base) or base)) from None
    return number


def _alternatives(kind: Any, metas: tuple[msgspec.Meta, ...] = ()) -> list[Alternative]:
    """Return what a type is, without its annotations and without None."""
    if hasattr(kind, "__metadata__"):
        return _alternatives(kind.__origin__, (*kind.__metadata__, *metas))
    if get_origin(kind) in (Union, UnionType):
        return [one for member in get_args(kind) if member is not NoneType for one in _alternatives(member, metas)]
    return [(kind, metas)]


def _shape(base: Any) -> type[Any] | None:
    """Return whether a type is a mapping or a list; None for a scalar."""
    origin = get_origin(base)
    if (isinstance(base, type) and issubclass(base, msgspec.Struct)) or origin in (dict, Mapping):
        return dict
    return list if origin in (tuple, list) else None


def _words(metas: tuple[msgspec.Meta, ...]) -> tuple[str, ...]:
    return next((meta.extra["words"] for meta in metas if meta.extra and "words" in meta.extra), ())
