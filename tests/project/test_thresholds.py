"""Every number that decides something stands a second time in ``thresholds.yaml``: a changed one is a decision."""

import ast
from collections import defaultdict
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
TABLE: dict[str, dict[str, Any]] = yaml.safe_load(Path(__file__).with_name("thresholds.yaml").read_text("utf-8"))

NUMBERS = (ast.Constant, ast.Tuple, ast.Load, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator)


def constants(package: str) -> dict[str, list[Any]]:
    """The numbers that are assigned to names outside of functions, by name, wherever in a package it stands."""
    found = defaultdict(list)
    for path in sorted((ROOT / package).rglob("*.py")):
        for statement in ast.parse(path.read_text("utf-8")).body:
            if isinstance(statement, ast.Assign) and all(isinstance(one, NUMBERS) for one in ast.walk(statement.value)):
                names = [one.id for one in ast.walk(statement.targets[0]) if isinstance(one, ast.Name)]
                number = eval(ast.unparse(statement.value))
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
