"""The JSON Schemas that editors use say what the readers say: a good file passes both, a bad one neither."""

from __future__ import annotations

import json
import re
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator
from support import ROOT
from support.command import tiltcal
from support.pair_files import read_pair

from tiltcal.errors import InputError
from tiltcal.files.bench import BenchFile, bench_of
from tiltcal.files.calibration import read_calibration
from tiltcal.files.document import read_document
from tiltcal.files.json_schema import json_schema
from tiltcal.files.procedure import read_procedure
from tiltcal.files.record import KINDS
from tiltcal.files.twin import read_twin


def read_bench(path: Path) -> BenchFile:
    return bench_of(read_document(path))


class Loader(yaml.SafeLoader):
    """PyYAML, which alone reads 1e-6 as a text."""


Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9.]+e[-+]?[0-9]+"), list("-+0123456789."))

READERS = {
    "tilt": read_calibration,
    "pair": read_pair,
    "procedure": read_procedure,
    "bench": read_bench,
    "twin": read_twin,
}

SCHEMAS = {kind: json_schema(kind) for kind in KINDS}

SECTIONS = ("sensor", "calibration", "spin", "rotation", "truth", "soak")

BENCH = """\
tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.05
thermometer: {model: thermistor, address: "sim:", uncertainty: 0.1}
sensors:
  - {serial: A-1, model: sca100t-d02, address: "sim:", axes: [-y, x]}
"""


def schema(kind: str) -> dict[str, Any]:
    return SCHEMAS[kind]


@cache
def validator(kind: str) -> Draft202012Validator:
    return Draft202012Validator(schema(kind))


def accepted(kind: str, content: Any) -> bool:
    return validator(kind).is_valid(content)


def complaint(kind: str, path: Path) -> str:
    """What the reader says against a file; nothing where it takes it."""
    try:
        READERS[kind](path)
    except InputError as error:
        return str(error)
    return ""


@cache
def plain(path: Path) -> Any:
    """Read a file of ours, which nobody changes."""
    return yaml.load(path.read_text(encoding="utf-8"), Loader)


def good_files() -> list[Path]:
    return sorted([*ROOT.glob("procedures/*.yaml"), *ROOT.glob("fixtures/*.yaml"), *ROOT.glob("fixtures/twins/*.yaml")])


def test_every_file_of_ours_passes() -> None:
    for kind in KINDS:
        Draft202012Validator.check_schema(schema(kind))
    for path in good_files():
        content = plain(path)
        errors = [error.message for error in Draft202012Validator(schema(content["kind"])).iter_errors(content)]
        assert not errors, path


def mapping_paths(node: dict[str, Any], root: dict[str, Any], lead: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where a schema says of a mapping which keys it may have; list items count as the first one."""
    node = root["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node
    found = [lead] if node.get("additionalProperties") is False else []
    for key, value in node.get("properties", {}).items():
        found += mapping_paths(value, root, (*lead, key)) if isinstance(value, dict) else []
    if isinstance(node.get("items"), dict):
        found += mapping_paths(node["items"], root, (*lead, 0))
    for choice in node.get("anyOf", []):
        found += mapping_paths(choice, root, lead)
    return found


def reached(content: Any, path: tuple[Any, ...]) -> dict[str, Any] | None:
    """The mapping at a path, where the file has it."""
    for step in path:
        if isinstance(step, int):
            content = content[step] if isinstance(content, list) and content else None
        else:
            content = content.get(step) if isinstance(content, dict) else None
        if content is None:
            return None
    return content if isinstance(content, dict) else None


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_an_unknown_key_is_refused_by_both_wherever_it_stands(kind: str, tmp_path: Path) -> None:
    """Each place of the schema in the shortest of our files that has it."""
    (tmp_path / "bench.yaml").write_text(BENCH, encoding="utf-8")
    files = sorted([*good_files(), tmp_path / "bench.yaml"], key=lambda path: path.stat().st_size)
    contents = [whole for path in files if (whole := plain(path))["kind"] == kind]
    tried = 0
    for place in dict.fromkeys(mapping_paths(schema(kind), schema(kind))):
        content = next((deepcopy(one) for one in contents if reached(one, place) is not None), None)
        target = reached(content, place)
        if target is None:
            continue
        target["colour"] = 1
        tried += 1
        assert not accepted(kind, content), place
        (tmp_path / "bad.yaml").write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError):
            READERS[kind](tmp_path / "bad.yaml")
    assert tried


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_key_that_is_needed_is_needed_by_both(kind: str, tmp_path: Path) -> None:
    """Each key beside each set of other keys that one of our files has it beside."""
    (tmp_path / "bench.yaml").write_text(BENCH, encoding="utf-8")
    tried = {}
    for whole in map(plain, [*good_files(), tmp_path / "bench.yaml"]):
        sections = [(), *((name,) for name in SECTIONS if isinstance(whole.get(name), dict))]
        for place in sections if whole["kind"] == kind else []:
            keys = reached(whole, place) or {}
            tried.update({(place, key, frozenset(keys)): whole for key in keys})
    assert tried
    for (place, key, _), whole in tried.items():
        content = deepcopy(whole)
        del (reached(content, place) or {})[key]
        (tmp_path / "less.yaml").write_text(json.dumps(content), encoding="utf-8")
        told = complaint(kind, tmp_path / "less.yaml")
        # What hangs on another key's value no schema says.
        if not told or "missing" in told:
            assert accepted(kind, content) == (not told), (*place, key)


def test_what_passes_one_passes_both(tmp_path: Path) -> None:
    changes = (
        (BENCH, "jig: 0.05", "jig: -1"),
        (BENCH, "serial: A-1", "serial: ../A"),
        (BENCH, "axes: [-y, x]", "axes: [w, x]"),
        (BENCH, "uncertainty: 0.1", "uncertainty: much"),
        (BENCH, "tiltcal: 1", "tiltcal: 2"),
        (BENCH, "kind: bench", "kind: bank"),
        ((ROOT / "procedures" / "zero-45.yaml").read_text(encoding="utf-8"), "axes: [x, y]", "axes: [x, x]"),
        ((ROOT / "fixtures" / "zero-45.yaml").read_text(encoding="utf-8"), "channels: [x, y]", "channels: [x, x]"),
    )
    for good, old, new in changes:
        assert old in good
        kind = yaml.load(good, Loader)["kind"]
        for text, passes in ((good, True), (good.replace(old, new), False)):
            (tmp_path / "file.yaml").write_text(text, encoding="utf-8")
            assert accepted(kind, yaml.load(text, Loader)) == passes, new
            assert (not complaint(kind, tmp_path / "file.yaml")) == passes, new


def test_the_command_prints_it_alone() -> None:
    result = tiltcal("check", "--schema", "twin", "--json")
    assert result.returncode == 0
    assert json.loads(result.stdout) == schema("twin")
