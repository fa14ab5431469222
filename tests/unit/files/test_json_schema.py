"""The JSON Schemas that editors use say what the readers say: a good file passes both, a bad one neither."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

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

TWINS = sorted(path.name for path in ROOT.glob("fixtures/twins/*.yaml"))

BENCH = """\
tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.05
thermometer: {model: thermistor, address: "sim:", uncertainty: 0.1}
sensors:
  - {serial: A-1, model: sca100t-d02, address: "sim:", axes: [-y, x]}
"""


@cache
def validator(kind: str) -> Draft202012Validator:
    return Draft202012Validator(SCHEMAS[kind])


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
        Draft202012Validator.check_schema(SCHEMAS[kind])
    for path in good_files():
        content = plain(path)
        errors = [error.message for error in Draft202012Validator(SCHEMAS[content["kind"]]).iter_errors(content)]
        assert not errors, path


def test_what_passes_one_passes_both(tmp_path: Path) -> None:
    zero_45 = (ROOT / "fixtures" / "zero-45.yaml").read_text(encoding="utf-8")
    changes = (
        (BENCH, "jig: 0.05", "jig: -1"),
        (BENCH, "serial: A-1", "serial: ../A"),
        (BENCH, "axes: [-y, x]", "axes: [w, x]"),
        (BENCH, "uncertainty: 0.1", "uncertainty: much"),
        (BENCH, "tiltcal: 1", "tiltcal: 2"),
        (BENCH, "kind: bench", "kind: bank"),
        (BENCH, "operator:", "colour:"),
        (BENCH, "serial: A-1, ", ""),
        (BENCH, "uncertainty: 0.1", "colour: 1"),
        ((ROOT / "procedures" / "zero-45.yaml").read_text(encoding="utf-8"), "axes: [x, y]", "axes: [x, x]"),
        *((zero_45, "channels: [x, y]", channels) for channels in ("channels: [x, x]", "colour: [x, y]")),
        ((ROOT / "fixtures" / "rotation.yaml").read_text(encoding="utf-8"), "turns: ", "colours: "),
        ((ROOT / "procedures" / "rotation.yaml").read_text(encoding="utf-8"), "phase: ", "face: "),
        *(((ROOT / "fixtures" / "twins" / name).read_text(encoding="utf-8"), "truth:", "lie:") for name in TWINS),
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
    assert json.loads(result.stdout) == SCHEMAS["twin"]
