"""Formats of single values: texts, choices, numbers and ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tiltcal.files.declaration import ANY, Context, Format
from tiltcal.files.node import Node


@dataclass(frozen=True)
class Text(Format[str]):
    """A text; an empty one only where it may be ``blank``."""

    blank: bool = False

    def read(self, node: Node, context: Context = ANY) -> str:
        return "" if self.blank and node.is_blank else node.text()

    def schema(self) -> dict[str, Any]:
        return {"type": "string"}


@dataclass(frozen=True)
class Choice(Format[str]):
    """One of a few words."""

    options: Sequence[str]

    def read(self, node: Node, context: Context = ANY) -> str:
        return node.choice(self.options)

    def schema(self) -> dict[str, Any]:
        return {"enum": list(self.options)}


@dataclass(frozen=True)
class Flag(Format[bool]):
    """``true`` or ``false``."""

    def read(self, node: Node, context: Context = ANY) -> bool:
        return node.flag()

    def schema(self) -> dict[str, Any]:
        return {"type": "boolean"}


@dataclass(frozen=True)
class Number(Format[float]):
    """A finite number, at least ``minimum``, more than ``above``, and at most ``maximum``.

    ``says`` is the message for a larger number, in which ``{found}`` stands for it.
    """

    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    says: str = ""

    def read(self, node: Node, context: Context = ANY) -> float:
        found = node.number(minimum=self.minimum, above=self.above)
        _require_at_most(found, self.maximum, self.says, node)
        return found

    def schema(self) -> dict[str, Any]:
        bounds = {"minimum": self.minimum, "exclusiveMinimum": self.above, "maximum": self.maximum}
        return {"type": "number", **{name: bound for name, bound in bounds.items() if bound is not None}}


FROM_ZERO = Number(minimum=0.0)


@dataclass(frozen=True)
class Integer(Format[int]):
    """A whole number, at least ``minimum`` and at most ``maximum``; ``says`` is as in :class:`Number`."""

    minimum: int | None = None
    maximum: int | None = None
    says: str = ""

    def read(self, node: Node, context: Context = ANY) -> int:
        found = node.integer(minimum=self.minimum)
        _require_at_most(found, self.maximum, self.says, node)
        return found

    def schema(self) -> dict[str, Any]:
        bounds = {"minimum": self.minimum, "maximum": self.maximum}
        return {"type": "integer", **{name: bound for name, bound in bounds.items() if bound is not None}}


def _require_at_most(found: float, maximum: float | None, says: str, node: Node) -> None:
    if maximum is not None and found > maximum:
        raise node.error(says.format(found=found))


@dataclass(frozen=True)
class Range(Format[tuple[float, float]]):
    """Two numbers ``[low, high]`` in that order."""

    def read(self, node: Node, context: Context = ANY) -> tuple[float, float]:
        return node.interval()

    def write(self, value: tuple[float, float]) -> list[float]:
        return list(value)

    def schema(self) -> dict[str, Any]:
        return {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
