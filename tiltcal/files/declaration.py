"""File formats, each declared once: the reader, the writer, the JSON Schema and the reference tables come from it.

A section of a file is a frozen dataclass whose fields are made by :func:`entry`::

    @dataclass(frozen=True, kw_only=True)
    class Spin:
        turns: float = entry(Number(above=0.0), "turns of the stage in the record")
        frequency: float | None = entry(Number(above=0.0, unit="Hz"), "of the spin", default=None)

``Section(Spin).read(node)`` checks every key and value of a document and returns a Spin; an error names file, line and
key. ``Section(Spin).write(spin)`` gives plain data for the emitter, without the entries that have their default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Generic, Literal, TypeVar, overload

from tiltcal.core.model import AXES
from tiltcal.files.node import Node

T = TypeVar("T")
D = TypeVar("D")

_ENTRY = "entry"


@dataclass(frozen=True)
class SensorNames:
    """The channels and axes that the mappings of a file may name.

    Attributes
    ----------
    channels : sequence of str
        Of the sensor, in order.
    axes : sequence of str
        The columns of its sensitivity.
    """

    channels: Sequence[str] = AXES
    axes: Sequence[str] = AXES


ANY = SensorNames()


class Format(ABC, Generic[T]):
    """One kind of value: how it is read, written and described."""

    @abstractmethod
    def read(self, node: Node, names: SensorNames = ANY) -> T:
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
class Entry:
    """One key of a section.

    Attributes
    ----------
    form : Format
    text : str
        What the value means, for the schema and the reference.
    default : object
        The value of an absent key; ``MISSING`` where the key is required.
    formerly : str
        The key's name in files of earlier versions; empty where it always had this one.
    usual : str
        The default, where the reference names it.
    """

    form: Format[Any]
    text: str
    default: Any = MISSING
    formerly: str = ""
    usual: str = ""

    @property
    def required(self) -> bool:
        """Whether the key has to be there."""
        return self.default is MISSING


@overload
def entry(form: Format[T], text: str, *, formerly: str = "") -> T: ...


@overload
def entry(form: Format[T], text: str, *, default: D, formerly: str = "", usual: str = "") -> T | D: ...


def entry(form: Format[Any], text: str, *, default: Any = MISSING, formerly: str = "", usual: str = "") -> Any:
    """Declare one key of a section as a field of its dataclass.

    Parameters
    ----------
    form : Format
        The kind of value.
    text : str
        What the value means, a phrase without a full stop; the reference and the JSON Schema have it.
    default : optional
        The value of an absent key; without one the key is required.
    formerly : str
        Name of the key in files of earlier versions, which are refused with the new name.
    usual : str
        The default as the reference shows it.
    """
    metadata = {_ENTRY: Entry(form, text, default, formerly, usual)}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


def entries_of(record: type[Any]) -> dict[str, Entry]:
    """Return the keys that a section declares, in the order of the file."""
    return {one.name: one.metadata[_ENTRY] for one in fields(record) if _ENTRY in one.metadata}


@dataclass(frozen=True)
class Text(Format[str]):
    """A text that is not empty."""

    def read(self, node: Node, names: SensorNames = ANY) -> str:
        return node.text()

    def schema(self) -> dict[str, Any]:
        return {"type": "string"}


@dataclass(frozen=True)
class Choice(Format[str]):
    """One of a few words."""

    options: Sequence[str]

    def read(self, node: Node, names: SensorNames = ANY) -> str:
        return node.choice(self.options)

    def schema(self) -> dict[str, Any]:
        return {"enum": list(self.options)}


@dataclass(frozen=True)
class Flag(Format[bool]):
    """``true`` or ``false``."""

    def read(self, node: Node, names: SensorNames = ANY) -> bool:
        return node.flag()

    def schema(self) -> dict[str, Any]:
        return {"type": "boolean"}


@dataclass(frozen=True)
class Number(Format[float]):
    """A finite number, at least ``minimum`` or more than ``above``."""

    unit: str = ""
    minimum: float | None = None
    above: float | None = None

    def read(self, node: Node, names: SensorNames = ANY) -> float:
        return node.number(minimum=self.minimum, above=self.above)

    def schema(self) -> dict[str, Any]:
        bounds = {"minimum": self.minimum, "exclusiveMinimum": self.above}
        return {"type": "number", **{name: bound for name, bound in bounds.items() if bound is not None}}


@dataclass(frozen=True)
class Integer(Format[int]):
    """A whole number of at least ``minimum``."""

    minimum: int | None = None

    def read(self, node: Node, names: SensorNames = ANY) -> int:
        return node.integer(minimum=self.minimum)

    def schema(self) -> dict[str, Any]:
        return {"type": "integer", **({} if self.minimum is None else {"minimum": self.minimum})}


@dataclass(frozen=True)
class Range(Format[tuple[float, float]]):
    """Two numbers ``[low, high]`` in that order."""

    unit: str = ""

    def read(self, node: Node, names: SensorNames = ANY) -> tuple[float, float]:
        return node.interval()

    def write(self, value: tuple[float, float]) -> list[float]:
        return list(value)

    def schema(self) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}


@dataclass(frozen=True)
class ListOf(Format[tuple[T, ...]]):
    """A list of values of one kind, of a bounded length.

    Attributes
    ----------
    item : Format
    least, most : int
        The bounds of the length; ``most`` may be None.
    says : str
        The message for a list of another length, in which ``{found}`` stands for its length.
    """

    item: Format[T]
    least: int = 0
    most: int | None = None
    says: str = ""

    def read(self, node: Node, names: SensorNames = ANY) -> tuple[T, ...]:
        items = node.items()
        if len(items) < self.least or (self.most is not None and len(items) > self.most):
            bounds = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            says = self.says or f"a list of {bounds} values is needed here, found {{found}}"
            raise node.error(says.format(found=len(items)))
        return tuple(self.item.read(item, names) for item in items)

    def write(self, value: tuple[T, ...]) -> list[Any]:
        return [self.item.write(one) for one in value]

    def schema(self) -> dict[str, Any]:
        bounds = {"minItems": self.least or None, "maxItems": self.most}
        kept = {name: bound for name, bound in bounds.items() if bound is not None}
        return {"type": "array", "items": self.item.schema(), **kept}


@dataclass(frozen=True)
class ByName(Format[Mapping[str, T]]):
    """A mapping whose keys are free, such as the names of positions."""

    item: Format[T]

    def read(self, node: Node, names: SensorNames = ANY) -> dict[str, T]:
        return {name: self.item.read(value, names) for name, value in node.entries().items()}

    def write(self, value: Mapping[str, T]) -> dict[str, Any]:
        return {name: self.item.write(one) for name, one in value.items()}

    def schema(self) -> dict[str, Any]:
        return {"type": "object", "additionalProperties": self.item.schema()}


@dataclass(frozen=True)
class ByKey(Format[Mapping[str, T]]):
    """A mapping with some of a few fixed keys, whose values are of one kind."""

    item: Format[T]
    keys: Sequence[str]

    def read(self, node: Node, names: SensorNames = ANY) -> dict[str, T]:
        known = node.mapping(optional=self._known(names))
        return {name: self.item.read(value, names) for name, value in known.items()}

    def write(self, value: Mapping[str, T]) -> dict[str, Any]:
        return {name: self.item.write(one) for name, one in value.items()}

    def schema(self) -> dict[str, Any]:
        item = self.item.schema()
        return {"type": "object", "properties": dict.fromkeys(self.keys, item), "additionalProperties": False}

    def _known(self, names: SensorNames) -> Sequence[str]:
        return self.keys


@dataclass(frozen=True)
class ByChannel(ByKey[T]):
    """A value for each channel, or for each axis, of the sensor.

    Attributes
    ----------
    keys : sequence of str
        The axes, and what else may be named.
    of : str
        ``channels``, ``axes``, or ``any`` where the file does not say which the sensor has.
    complete : bool
        Whether none may be left out.
    """

    keys: Sequence[str] = AXES
    of: Literal["channels", "axes", "any"] = "any"
    complete: bool = False

    def read(self, node: Node, names: SensorNames = ANY) -> dict[str, T]:
        if not self.complete:
            return super().read(node, names)
        known = node.mapping(required=self._known(names))
        return {name: self.item.read(value, names) for name, value in known.items()}

    def _known(self, names: SensorNames) -> Sequence[str]:
        extra = [key for key in self.keys if key not in AXES]
        return [*{"channels": names.channels, "axes": names.axes, "any": AXES}[self.of], *extra]


@dataclass(frozen=True)
class Section(Format[T]):
    """A mapping whose keys a dataclass declares.

    Attributes
    ----------
    record : type
        A dataclass whose fields are made by :func:`entry`.
    check : callable or None
        Judges what was read beyond its single values: takes the record and the node, and raises the node's error.
    """

    record: type[T]
    check: Callable[[T, Node], None] | None = None

    def read(self, node: Node, names: SensorNames = ANY) -> T:
        declared = entries_of(self.record)
        _refuse_former_names(node, declared)
        values = node.mapping(
            required=[name for name, one in declared.items() if one.required],
            optional=[name for name, one in declared.items() if not one.required],
        )
        found = self.record(**{name: declared[name].form.read(value, names) for name, value in values.items()})
        if self.check is not None:
            self.check(found, node)
        return found

    def write(self, value: T) -> dict[str, Any]:
        """Return the section as plain data, without the entries that have their default."""
        plain = {}
        for name, one in entries_of(self.record).items():
            content = getattr(value, name)
            if one.required or content != one.default:
                plain[name] = one.form.write(content)
        return plain

    def schema(self) -> dict[str, Any]:
        declared = entries_of(self.record)
        return {
            "type": "object",
            "properties": {name: {"description": one.text, **one.form.schema()} for name, one in declared.items()},
            "required": [name for name, one in declared.items() if one.required],
            "additionalProperties": False,
        }


def _refuse_former_names(node: Node, declared: Mapping[str, Entry]) -> None:
    """Refuse a key by its name in earlier versions, with the name that it has now."""
    former = {one.formerly: name for name, one in declared.items() if one.formerly}
    for name, value in node.entries().items():
        if name in former:
            raise value.error(f"the key {name!r} is called {former[name]!r} now; rename it")
