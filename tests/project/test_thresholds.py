"""Every number that decides something stands a second time in ``thresholds.yaml``: a changed one is a decision."""

import ast
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import yaml

from tiltcal.files.json_schema import FILES, json_schema

ROOT = Path(__file__).resolve().parents[2]
TABLE: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_name("thresholds.yaml").read_text("utf-8"))
KEYS: dict[str, dict[str, Any]] = TABLE.pop("keys")

NUMBERS = (ast.Constant, ast.Tuple, ast.Load, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.Call)


def is_number(node: ast.AST) -> bool:
    return isinstance(node, NUMBERS) or (isinstance(node, ast.Name) and node.id in vars(math))


def constants(package: str) -> dict[str, list[Any]]:
    """The numbers that are assigned to names outside of functions, by name, wherever in a package it stands."""
    found = defaultdict(list)
    for path in sorted((ROOT / package).rglob("*.py")):
        for statement in ast.parse(path.read_text("utf-8")).body:
            if isinstance(statement, ast.Assign) and all(map(is_number, ast.walk(statement.value))):
                names = [one.id for one in ast.walk(statement.targets[0]) if isinstance(one, ast.Name)]
                number = eval(ast.unparse(statement.value), vars(math))
                for name, one in zip(names, number if len(names) > 1 else [number], strict=True):
                    found[name].append(list(one) if isinstance(one, tuple) else one)
    return found


def test_every_threshold_has_its_value() -> None:
    for package, table in TABLE.items():
        found = constants(package)
        for name, value in table.items():
            values, there = value["each"] if isinstance(value, dict) else [value], found[name]
            assert all(one in there for one in values), (package, name, there)
            assert all(one in values for one in there if isinstance(one, float | int)), (package, name, there)


def numbers(schema: Any) -> list[float]:
    """The limits and the default in the schema of a key, without those that every size has."""
    if isinstance(schema, list):
        return [number for part in schema for number in numbers(part)]
    if not isinstance(schema, dict):
        return []
    stated = (schema.get(name) for name in ("minimum", "maximum", "minItems", "maxItems", "minLength"))
    limits = [one for one in stated if (one is not None and 1e-9 < abs(one) < 1e9) or one == 0]
    default = [schema["default"]] if isinstance(schema.get("default"), int | float) else []
    return [*limits, *default, *(number for part in schema.values() for number in numbers(part))]


def test_every_key_of_a_file_has_its_limits() -> None:
    found: dict[str, dict[str, list[float]]] = {}
    for kind in FILES:
        for name, record in json_schema(kind)["$defs"].items():
            limits = {key: numbers(part) for key, part in record.get("properties", {}).items()}
            found |= {name: limited} if (limited := {key: some for key, some in limits.items() if any(some)}) else {}
    assert found == KEYS


CHANGING = {"AcceptedPosition", "AcceptedSensor", "ApplySummary", "LogWriter", "PlayedLink", "Written"}
"""What counts, holds what is open, or is read from a line at once."""


def test_values_are_frozen() -> None:
    paths = (path for name in ("tiltcal", "drivers") for path in (ROOT / name).rglob("*.py"))
    nodes = (node for path in paths for node in ast.walk(ast.parse(path.read_text("utf-8"))))
    classes = [node for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    heads = {one.name: " ".join(map(ast.unparse, (*one.decorator_list, *one.bases, *one.keywords))) for one in classes}
    values = {name: head for name, head in heads.items() if head.startswith(("dataclass", "Struct"))}
    assert {name for name, head in values.items() if "frozen=True" not in head} == CHANGING
