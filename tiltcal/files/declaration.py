"""File formats, each declared once: the reader, the writer, the JSON Schema and the reference tables come from it.

A section of a file is a frozen dataclass whose fields are made by :func:`entry`::

    @dataclass(frozen=True, kw_only=True)
    class Spin:
        turns: float = entry(Number(above=0.0), "turns of the stage in the record")
        frequency: float | None = entry(Number(above=0.0, unit="Hz"), "of the spin", default=None)

``Section(Spin).read(node)`` checks every key and value of a document and returns a Spin; an error names file, line and
key. ``Section(Spin).write(spin)`` gives plain data for the emitter, without the entries that have their default.
Formats of single values are in :mod:`tiltcal.files.scalars`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import MISSING, dataclass, field, fields, replace
from importlib import import_module
from typing import Any, Generic, Literal, TypeVar, overload

from tiltcal.core.model import AXES
from tiltcal.files.node import Node

S = TypeVar("S")
T = TypeVar("T")
D = TypeVar("D")

FORMAT_VERSION = 1

KINDS = {
    "tilt": "a tilt calibration",
    "pair": "a pair calibration, as 'tiltcal match' writes it",
    "procedure": "a procedure, as 'tiltcal measure' runs it",
    "bench": "a bench, for 'tiltcal measure --bench'",
    "twin": "a virtual sensor, for an address such as sim:?twin=FILE",
}
"""What messages call the files of each ``kind``."""

_ENTRY = "entry"


@dataclass(frozen=True)
class Context:
    """What earlier parts of a file, and the user, determine for later parts.

    Attributes
    ----------
    channels : sequence of str
        Of the sensor, in order.
    axes : sequence of str
        The columns of its sensitivity.
    coefficients : sequence of str
        The dotted names of the file's coefficients; empty where the file has none.
    given : float or None
        The angle that the user gives in place of the procedure's, degrees.
    angle : float or None
        The angle that positions may name, degrees.
    """

    channels: Sequence[str] = AXES
    axes: Sequence[str] = AXES
    coefficients: Sequence[str] = ()
    given: float | None = None
    angle: float | None = None


ANY = Context()


class Format(ABC, Generic[T]):
    """One kind of value: how it is read, written and described."""

    @abstractmethod
    def read(self, node: Node, context: Context = ANY) -> T:
        """Return the value that stands at a node.

        Raises
        ------
        InputError
            The value is wrong; the message names file, line and key.
        """

    def write(self, value: T) -> Any:
        """Return a value as plain data for the emitter."""
        return value

    @abstractmethod
    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the value."""


@dataclass(frozen=True)
class KeyDeclaration:
    """One key of a section.

    Attributes
    ----------
    text : str
        What the value means, for the schema and the reference.
    default : object
        The value of an absent key; ``MISSING`` where the key is required.
    formerly : str
        The key's name in files of earlier versions; empty where it always had this one.
    key : str
        The key in the file, where the field has another name.
    usual : str
        The default as the reference shows it, where it differs from the field's.
    kept : bool
        Whether the key is written where it has its default.
    """

    form: Format[Any]
    text: str
    default: Any = MISSING
    formerly: str = ""
    key: str = ""
    usual: str = ""
    kept: bool = False

    @property
    def required(self) -> bool:
        """Whether the key is required."""
        return self.default is MISSING


@overload
def entry(form: Format[T], text: str, *, formerly: str = "", key: str = "") -> T: ...


@overload
def entry(
    form: Format[T], text: str, *, default: D, formerly: str = "", key: str = "", usual: str = "", kept: bool = False
) -> T | D: ...


def entry(form: Format[Any], text: str, *, default: Any = MISSING, **more: Any) -> Any:
    """Declare one key of a section as a field of its dataclass.

    Parameters
    ----------
    text : str
        What the value means, a phrase without a full stop; the reference and the JSON Schema have it.
    default : optional
        The value of an absent key; without one the key is required.
    **more
        The other attributes of :class:`KeyDeclaration`.
    """
    metadata = {_ENTRY: KeyDeclaration(form, text, default, **more)}
    if isinstance(default, Hashable):
        return field(default=default, metadata=metadata)
    return field(default_factory=lambda: copy(default), metadata=metadata)


def entries_of(record: type[Any]) -> dict[str, KeyDeclaration]:
    """Return the entries of a section by the names of their fields, in the order of the file."""
    found = {each.name: each.metadata[_ENTRY] for each in fields(record) if _ENTRY in each.metadata}
    return {name: replace(declaration, key=declaration.key or name) for name, declaration in found.items()}


@dataclass(frozen=True)
class ListOf(Format[tuple[T, ...]]):
    """A list of values of one kind, of a bounded length.

    Attributes
    ----------
    least, most : int
        The bounds of the length; ``most`` may be None.
    says : str
        The message for a list of another length, in which ``{found}`` stands for its length.
    """

    item: Format[T]
    least: int = 0
    most: int | None = None
    says: str = ""

    def read(self, node: Node, context: Context = ANY) -> tuple[T, ...]:
        items = node.items()
        if len(items) < self.least or (self.most is not None and len(items) > self.most):
            bounds = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            says = self.says or f"a list of {bounds} values is needed here, found {{found}}"
            raise node.error(says.format(found=len(items)))
        return tuple(self.item.read(item, context) for item in items)

    def write(self, value: tuple[T, ...]) -> list[Any]:
        return [self.item.write(member) for member in value]

    def schema(self) -> dict[str, Any]:
        bounds = {"minItems": self.least or None, "maxItems": self.most}
        kept = {name: bound for name, bound in bounds.items() if bound is not None}
        return {"type": "array", "items": self.item.schema(), **kept}


@dataclass(frozen=True)
class ByName(Format[Mapping[str, T]]):
    """A mapping whose keys are free, such as the names of positions."""

    item: Format[T]

    def read(self, node: Node, context: Context = ANY) -> dict[str, T]:
        return {name: self.item.read(value, context) for name, value in node.entries().items()}

    def write(self, value: Mapping[str, T]) -> dict[str, Any]:
        return {name: self.item.write(member) for name, member in value.items()}

    def schema(self) -> dict[str, Any]:
        return {"type": "object", "additionalProperties": self.item.schema()}


@dataclass(frozen=True)
class ByCoefficient(ByName[T]):
    """A mapping whose keys are dotted names of the file's coefficients."""

    def read(self, node: Node, context: Context = ANY) -> dict[str, T]:
        known = node.mapping(optional=context.coefficients) if context.coefficients else node.entries()
        return {name: self.item.read(value, context) for name, value in known.items()}


@dataclass(frozen=True)
class ByKey(ByName[T]):
    """A mapping with a few fixed keys, whose values are of one kind; where ``complete``, none may be left out."""

    keys: Sequence[str]
    complete: bool = False

    def read(self, node: Node, context: Context = ANY) -> dict[str, T]:
        return self._read(node, self.keys, context)

    def schema(self) -> dict[str, Any]:
        item = self.item.schema()
        return {
            "type": "object",
            "properties": dict.fromkeys(self.keys, item),
            "required": list(self.keys) if self.complete else [],
            "additionalProperties": False,
        }

    def _read(self, node: Node, keys: Sequence[str], context: Context) -> dict[str, T]:
        known = node.mapping(required=keys) if self.complete else node.mapping(optional=keys)
        return {name: self.item.read(value, context) for name, value in known.items()}


@dataclass(frozen=True)
class ByChannel(ByKey[T]):
    """A value for each channel, or for each axis, of the sensor.

    Attributes
    ----------
    keys : sequence of str
        The axes, and what else may be named.
    of : str
        ``channels``, ``axes``, or ``any`` where the file does not say which the sensor has.
    """

    keys: Sequence[str] = AXES
    of: Literal["channels", "axes", "any"] = "any"

    def read(self, node: Node, context: Context = ANY) -> dict[str, T]:
        known = {"channels": context.channels, "axes": context.axes, "any": AXES}[self.of]
        return self._read(node, [*known, *(key for key in self.keys if key not in AXES)], context)

    def schema(self) -> dict[str, Any]:
        # Which channels the sensor has is said elsewhere in the file.
        return {**super().schema(), "required": []}


@dataclass(frozen=True)
class Converted(Format[T], Generic[S, T]):
    """A value that is checked, or converted to another one, after it was read.

    Attributes
    ----------
    form : Format
        As the value stands in the file.
    convert : callable
        From what was read, its node and the context to the value; raises the node's error.
    back : callable or None
        From the value to what ``form`` writes; None where they are equal.
    more : mapping
        What the JSON Schema can express of the check.
    """

    form: Format[S]
    convert: Callable[[S, Node, Context], T]
    back: Callable[[T], S] | None = None
    more: Mapping[str, Any] = field(default_factory=dict)

    def read(self, node: Node, context: Context = ANY) -> T:
        return self.convert(self.form.read(node, context), node, context)

    def write(self, value: T) -> Any:
        return self.form.write(value if self.back is None else self.back(value))  # type: ignore[arg-type]

    def schema(self) -> dict[str, Any]:
        return {**self.form.schema(), **self.more}


@dataclass(frozen=True)
class Either(Format[T]):
    """One of two kinds of section, distinguished by a key that the second one has."""

    key: str
    usual: Format[T]
    other: Format[T]

    def read(self, node: Node, context: Context = ANY) -> T:
        return (self.other if self.key in node.entries() else self.usual).read(node, context)

    def schema(self) -> dict[str, Any]:
        return {"anyOf": [self.usual.schema(), self.other.schema()]}


@dataclass(frozen=True)
class Imported(Format[T]):
    """A format whose module is imported only where a file has it."""

    module: str
    name: str

    def read(self, node: Node, context: Context = ANY) -> T:
        return self._form().read(node, context)

    def schema(self) -> dict[str, Any]:
        return self._form().schema()

    def _form(self) -> Format[T]:
        found: Format[T] = getattr(import_module(self.module), self.name)
        return found


@dataclass(frozen=True)
class Anything(Format[Any]):
    """A mapping that another declaration reads."""

    def read(self, node: Node, context: Context = ANY) -> dict[str, Any]:
        node.entries()
        plain: dict[str, Any] = node.plain()
        return plain

    def schema(self) -> dict[str, Any]:
        return {"type": "object"}


@dataclass(frozen=True)
class Section(Format[T]):
    """A mapping whose keys a dataclass declares.

    Attributes
    ----------
    record : type
        A dataclass whose fields are made by :func:`entry`.
    follow : callable or None
        Called after each entry, there or absent, with its key and all that was read so far; returns the context of the
        next one.
    kind : str
        ``kind`` of a whole file, one of :data:`KINDS`, whose keys ``tiltcal`` and ``kind`` come first and are checked
        first; empty for a part of a file.
    """

    record: type[T]
    follow: Callable[[str, Mapping[str, Any], Context], Context] | None = None
    kind: str = ""

    def read(self, node: Node, context: Context = ANY) -> T:
        if self.kind:
            _require_kind(node, self.kind)
        declared = {declaration.key: (name, declaration) for name, declaration in entries_of(self.record).items()}
        values = node.mapping(
            required=[*self._fixed(), *(key for key, (_, declaration) in declared.items() if declaration.required)],
            optional=[key for key, (_, declaration) in declared.items() if not declaration.required],
            former={declaration.formerly: key for key, (_, declaration) in declared.items() if declaration.formerly},
        )
        found: dict[str, Any] = {}
        for key, (name, declaration) in declared.items():
            if key in values:
                found[name] = declaration.form.read(values[key], context)
            context = context if self.follow is None else self.follow(key, found, context)
        return self.record(**found)

    def write(self, value: T) -> dict[str, Any]:
        """Return the section as plain data, without the entries that have their default."""
        plain = self._fixed()
        for name, declaration in entries_of(self.record).items():
            content = getattr(value, name)
            if declaration.required or declaration.kept or content != declaration.default:
                plain[declaration.key] = declaration.form.write(content)
        return plain

    def keys(self) -> dict[str, bool]:
        """Return the keys, and whether each is required."""
        return {declaration.key: declaration.required for declaration in entries_of(self.record).values()}

    def schema(self) -> dict[str, Any]:
        declared = entries_of(self.record).values()
        fixed: dict[str, Any] = {name: {"const": value} for name, value in self._fixed().items()}
        return {
            "type": "object",
            "properties": fixed
            | {
                declaration.key: {"description": declaration.text, **declaration.form.schema()}
                for declaration in declared
            },
            "required": [*fixed, *(declaration.key for declaration in declared if declaration.required)],
            "additionalProperties": False,
        }

    def _fixed(self) -> dict[str, Any]:
        """Return the keys that identify the file."""
        return {"tiltcal": FORMAT_VERSION, "kind": self.kind} if self.kind else {}


def _require_kind(document: Node, kind: str) -> None:
    """Refuse a document of another version or of another kind."""
    entries = document.entries()
    for name in ("tiltcal", "kind"):
        if name not in entries:
            raise document.error(f"the key {name!r} is missing; {KINDS[kind]} has 'tiltcal: 1' and 'kind: {kind}'")
    version = entries["tiltcal"].integer()
    if version != FORMAT_VERSION:
        raise entries["tiltcal"].error(f"format version {version} is not known; this program reads {FORMAT_VERSION}")
    found = entries["kind"].choice(list(KINDS))
    if found != kind:
        raise entries["kind"].error(f"this file is {KINDS[found]}; {KINDS[kind]} is needed here (kind: {kind})")
