"""A document: plain data whose scalars stay text, the line of every value, and the records that it is read as.

The type of a record decides what a scalar means. msgspec converts a sound document at once. Where it refuses one, the
data are taken part by part, which finds the place, also in a mapping with free keys, and converts what YAML allows and
msgspec does not: numbers such as ``.5`` or ``0x1d``, and optional keys that hold nothing.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import inf, isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from tiltcal.errors import InputError, TiltcalError
from tiltcal.files.moments import moment
from tiltcal.files.record import FORMAT_VERSION, KINDS
from tiltcal.files.yaml_text import DEPTH_LIMIT, Place, dotted, is_sent, parse, read_text
from tiltcal.printable import did_you_mean
from tiltcal.stated_arguments import LEAST, require_path, require_printable

T = TypeVar("T")

_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WHOLE = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_DIGIT_LIMIT = 200
_NEEDED = {float: "a number", int: "a whole number", bool: "true or false", list: "a list", dict: "a mapping"}


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
        """Return a part of the document; its data are None where it is absent."""
        data = self.data
        for step in place:
            try:
                data = data[step]
            except (LookupError, TypeError):
                data = None
        return Document(data, self.lines, self.file, (*self.place, *place))

    def items(self) -> list[Document]:
        """Return the members of a list; an InputError where it is none."""
        if not isinstance(self.data, list):
            raise self.error(_refusal(self.data, list))
        return [self.at(number) for number in range(len(self.data))]

    def members(self) -> dict[str, Any]:
        """Return the data of a mapping; an InputError where it is none."""
        if not isinstance(self.data, dict):
            raise self.error(_refusal(self.data, dict))
        return self.data

    @property
    def line(self) -> int | None:
        """The line of the part."""
        around = (self.place[:k] for k in range(len(self.place), -1, -1))
        return next((self.lines[place] for place in around if place in self.lines), None)

    def error(self, message: str, *place: str | int) -> InputError:
        """Return an error with file, line and key of a place in it, to be raised."""
        part = self.at(*place)
        return InputError(message, file=part.file, line=part.line, key=dotted(part.place))

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
                listed = ", ".join(known) or "none"
                raise self.error(f"unknown key {name!r}{did_you_mean(name, known)}; known here: {listed}", *place, name)
        missing = [name for name in known if name not in names] if complete else []
        if missing:
            raise self.error(f"the key {missing[0]!r} is missing; it is required here", *place)

    def require_known(self, word: str, words: Collection[str], *place: str | int) -> None:
        """Refuse a word at a place that is none of these."""
        if word not in words:
            raise self.error(_refusal(word, words), *place)

    def require_order(self, interval: tuple[float, float] | None, *place: str | int) -> None:
        """Refuse a range ``[low, high]`` at a place that is the wrong way round."""
        if interval is not None and interval[0] > interval[1]:
            low, high = interval
            raise self.error(f"the range [{low:g}, {high:g}] is the wrong way round; write [low, high]", *place)

    def require_moments(self, section: Any, *keys: str) -> None:
        """Refuse texts of a section that are no moments in ISO 8601."""
        for key in keys:
            if (text := getattr(section, key)) is not None:
                with self.locating(key):
                    moment(text)

    def read(self, record: type[T]) -> T:
        """Return the document as a record; an InputError names file, line and key of what is wrong."""
        with suppress(msgspec.ValidationError):
            return msgspec.convert(self.data, record, strict=False)
        try:
            return msgspec.convert(_repaired(self, record), record, strict=False)
        except msgspec.ValidationError as failure:
            why, _, place = str(failure).partition(" - at `$")
            steps = [int(step) if step.isdigit() else step for step in re.findall(r"\w+", place)]
            raise self.error(
                why.replace("Expected `object` of length >= 1", "name at least one key here"), *steps
            ) from None

    @property
    def kind(self) -> str | None:
        """The kind that a whole file states; an InputError where it is no mapping."""
        kind = self.members().get("kind")
        return kind if isinstance(kind, str) else None

    def body(self, kind: str) -> Document:
        """Return a file without the keys ``tiltcal`` and ``kind``, which are checked."""
        stated = self.kind
        for name in ("tiltcal", "kind"):
            if self.data.get(name) is None:
                raise self.error(f"the key {name!r} is missing; {KINDS[kind]} has 'tiltcal: 1' and 'kind: {kind}'")
        version = self.data["tiltcal"]
        if version not in (FORMAT_VERSION, str(FORMAT_VERSION)):
            if _numeral(version, int) is None:
                raise self.error(_refusal(version, int), "tiltcal")
            raise self.error(f"format version {version} is not known; this program reads {FORMAT_VERSION}", "tiltcal")
        if stated not in KINDS:
            raise self.error(_refusal(self.data["kind"], KINDS), "kind")
        if stated != kind:
            raise self.error(f"this file is {KINDS[stated]}; {KINDS[kind]} is needed here (kind: {kind})", "kind")
        return replace(self, data={name: self.data[name] for name in self.data if name not in ("tiltcal", "kind")})


_JOURNAL = b'{"tiltcal-journal"'
_LOGS = (".csv", ".tsv", ".parquet", ".nc", ".nc4", ".mcap", ".bag", ".db3")


def read_document(path: str | Path) -> Document:
    """Read one YAML document from a file; an InputError where it cannot be read, or uses what is refused here."""
    require_path("a file", path)  # a number would be an open file, which is closed behind it
    why = ""
    if os.path.isfile(path):  # a pipe is read once
        with suppress(OSError), open(path, "rb") as stream:
            if stream.read(len(_JOURNAL)) == _JOURNAL:
                why = "this is the journal of a session: tiltcal replay makes its calibration, measure --resume goes on"
            elif Path(path).suffix.lower() in _LOGS:
                why = "this is a log: tiltcal apply converts it, tiltcal fit calibrates from it"
    if why:
        raise InputError(why, file=str(path))
    return parse_document(read_text(path), file=str(path))


def parse_document(text: str, file: str | None = None) -> Document:
    """Parse one YAML document, or JSON, which is YAML; an InputError names ``file`` and line of what is refused."""
    return Document(*parse(text, file), file)


def document_of(data: Any, file: str | None = None, line: int | None = None) -> Document:
    """Return plain data as a document, so that the code that checks a file checks a record in a line of one too."""
    lines: dict[Place, int] = {} if line is None else {(): line}
    return Document(_taken(data, Document(None, lines, file)), lines, file)


def _taken(data: Any, part: Document) -> Any:
    """Return plain data as those of a document."""
    if len(part.place) > DEPTH_LIMIT:
        raise part.error(f"nested deeper than {DEPTH_LIMIT}")
    if isinstance(data, Mapping):
        for name in data:
            require_printable(str(name), dotted(part.place), part.file, part.line)
        return {str(name): _taken(value, part.at(str(name))) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [_taken(value, part.at(number)) for number, value in enumerate(data)]
    if isinstance(data, str):
        if not is_sent(part.place):
            require_printable(data, dotted(part.place), part.file, part.line)
    elif data is not None and not isinstance(data, bool | int | float):
        raise part.error(f"a number or a text is needed, not a {type(data).__name__}")
    return data


# ------------------------------------------------------------------------------------- what msgspec refuses at first


def _repaired(part: Document, kind: Any) -> Any:
    """Return the data of a part as msgspec takes them; an InputError names the first place that a type refuses."""
    value, alternatives = part.data, _alternatives(kind)
    shape = next((one for one in (dict, list) if isinstance(value, one)), None)
    base, metas = next((one for one in alternatives if _shape(one[0]) is shape), alternatives[0])
    if base is Any:
        return value
    if _shape(base) != shape:
        raise part.error(_refusal(value, _shape(base) or base))
    if shape is dict:
        return _mapping(part, base)
    if shape is list:
        return _list(part, base, metas)
    literals = [get_args(one) for one, _ in alternatives if getattr(one, "__origin__", None) is Literal]
    return value if any(value in words for words in literals) else _scalar(part, base, metas)


def _mapping(part: Document, base: Any) -> dict[str, Any]:
    if get_origin(base) is not None:
        name_kind, kind = get_args(base)
        names = _extra(_alternatives(name_kind)[0][1], "words") or ()
        kinds, needed = dict.fromkeys(names or part.data, kind), set() if names else set(part.data)
    else:
        fields = msgspec.structs.fields(base)
        kinds = {one.encode_name: one.type for one in fields}
        needed = {one.encode_name for one in fields if one.required}
    part.require_keys(part.data, kinds)
    part.require_keys(part.data, [name for name in kinds if name in needed or name in part.data], complete=True)
    return {
        name: _repaired(part.at(name), one)
        for name, one in kinds.items()
        if name in part.data and (name in needed or part.data[name] is not None)
    }


def _list(part: Document, base: Any, metas: tuple[msgspec.Meta, ...]) -> list[Any]:
    kinds, count = get_args(base), len(part.data)
    least = most = None if kinds[-1] is Ellipsis else len(kinds)
    for meta in metas:
        least, most = meta.min_length or least, meta.max_length or most
    if count < (least or 0) or count > (count if most is None else most):
        words = [f"at least {least}"] * (least is not None) + [f"at most {most}"] * (most is not None)
        bounds = f"{least}" if least == most else " and ".join(words)
        raise part.error(f"a list of {bounds} values is needed here, found {count}")
    fixed = kinds[:1] * count if kinds[-1] is Ellipsis else kinds
    return [_repaired(item, kind) for item, kind in zip(part.items(), fixed, strict=True)]


def _scalar(part: Document, base: Any, metas: tuple[msgspec.Meta, ...]) -> Any:
    value = part.data
    number = _numeral(value, base) if base in (float, int) else value
    if number is None:
        raise part.error(_refusal(value, base))
    try:
        msgspec.convert(number, Annotated[(base, *metas)] if metas else base, strict=False)
    except msgspec.ValidationError:
        if base in (float, int):
            raise part.error(_beyond(value, number, metas)) from None
        says = _extra(metas, "says")
        if says and isinstance(value, str) and value.strip():
            raise part.error(f"{value!r} is not {says}") from None
        raise part.error(_refusal(value, _extra(metas, "words") or get_args(base) or base)) from None
    return number


def _alternatives(kind: Any, metas: tuple[msgspec.Meta, ...] = ()) -> list[tuple[Any, tuple[msgspec.Meta, ...]]]:
    """Return what a type is without None, each with its annotations apart."""
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


def _extra(metas: tuple[msgspec.Meta, ...], name: str) -> Any:
    return next((meta.extra[name] for meta in metas if meta.extra and meta.extra.get(name)), None)


def _numeral(value: Any, base: Any) -> float | None:
    """Return the number that a value is, a whole one where the type is int; infinity above 200 digits; None if none."""
    number: float = inf
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = value
    elif not isinstance(value, str) or not (_WHOLE.fullmatch(value) or _FLOAT.fullmatch(value)):
        return None
    elif len(value) <= _DIGIT_LIMIT:
        number = int(value, 0 if value[1:2] in ("o", "x") else 10) if _WHOLE.fullmatch(value) else float(value)
    if not abs(number) <= sys.float_info.max:
        return inf
    return float(number) if base is float else int(number) if number == int(number) else None


# ------------------------------------------------------------------------------------------------- the words of it


def _refusal(value: Any, needed: Any) -> str:
    """Return why a value is refused: a type is needed, or one of a few words."""
    if isinstance(needed, Collection) and isinstance(value, str):
        words = list(map(str, needed))
        return f"unknown value {value!r}{did_you_mean(value, words)}; it is one of {', '.join(words)}"
    if isinstance(value, str) and not value.strip() and needed is str:
        return "the text is empty; write a text"
    advice = ""
    if isinstance(value, str) and needed in (float, int):
        advice = "; it must be finite" if _NOT_FINITE.fullmatch(value) else _advice(value.strip())
    kind = _NEEDED.get(needed, "text") if isinstance(needed, type) else "text"
    return f"{kind} is needed here, found {_shown(value)}{advice}"


def _beyond(value: Any, number: float, metas: tuple[msgspec.Meta, ...]) -> str:
    """Return why a number is refused that is beyond a bound."""
    for meta in metas if isfinite(number) else ():
        if meta.ge is not None and number < meta.ge:
            least = f"more than 0, at least {meta.ge:.10g}" if meta.ge == LEAST else f"at least {meta.ge:.10g}"
            return f"{_shown(value)} is too small; it must be {least}"
        if meta.le is not None and number > meta.le:
            return f"{_shown(value)} is too large; it must be at most {meta.le:.10g}"
    return f"{_shown(value)} is too large a number"


def _advice(text: str) -> str:
    """Return how a text that looks like a number becomes one."""
    if "," in text and _FLOAT.fullmatch(text.replace(",", ".")):
        return "; write the point as '.'"
    return "; write the number alone" if re.match(_FLOAT.pattern + r" ?[°%a-zA-Z]", text) else ""


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    if not isinstance(value, str):
        return str(value)
    text = value if len(value) <= 40 else value[:37] + "..."
    return text if _FLOAT.fullmatch(value) or _NOT_FINITE.fullmatch(value) else repr(text)
