"""The JSON Schemas that editors use say what the readers say: a good file passes both, a bad one neither."""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator
from support import ROOT
from support.refused import require_refused

from tiltcal.errors import InputError
from tiltcal.files.bench import bench_of
from tiltcal.files.calibration import read_calibration
from tiltcal.files.device import device_of
from tiltcal.files.document import parse_document, read_document
from tiltcal.files.json_schema import json_schema
from tiltcal.files.pair import pair_record
from tiltcal.files.procedure import read_procedure
from tiltcal.files.record import KINDS
from tiltcal.files.twin import read_twin


class Loader(yaml.SafeLoader):
    """PyYAML, which alone reads 1e-6 as a text."""


Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9.]+e[-+]?[0-9]+"), list("-+0123456789."))

READERS: dict[str, Any] = {
    "tilt": read_calibration,
    "pair": lambda path: pair_record(read_document(path)),
    "procedure": read_procedure,
    "device": lambda path: device_of(read_document(path)),
    "bench": lambda path: bench_of(read_document(path)),
    "twin": read_twin,
}

SCHEMAS = {kind: json_schema(kind) for kind in KINDS}
GOOD = {path: path.read_text(encoding="utf-8") for path in ROOT.glob("fixtures/*.yaml")}
GOOD |= {
    path: path.read_text(encoding="utf-8")
    for pattern in ("procedures/*.yaml", "fixtures/twins/*", "drivers/text_devices/*")
    for path in ROOT.glob(pattern)
}

BENCH = """\
tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.05
thermometer: {model: thermistor, address: "sim:", uncertainty: 0.1}
sensors:
  - {serial: A-1, model: sca100t-d02, address: "sim:", axes: [-y, x]}
  - {serial: A-2, model: sca100t-d02, address: "sim:"}
table: {kind: text, address: "serial:x", limits: {x: [-60, 60], y: [-30, 30]}, tolerance: 0.1, read: "?",
  set: ["G0 X{x:.3f} Y{y:.3f}"], pattern: "X(?P<x>[-0-9.]+) Y(?P<y>[-0-9.]+)"}
"""
DEVICE = """\
tiltcal: 1
kind: device
name: own-2
title: A text device
unit: °
ask: "R"
answer: '(?P<x>[-+0-9.]+),(?P<y>[-+0-9.]+)'
ends: "\\r\\n"
angles: inclination
"""


def passes(kind: str, text: str, path: Path) -> tuple[bool, bool]:
    """Whether a text passes the schema of a kind, and its reader."""
    path.write_text(text, encoding="utf-8")
    with suppress(InputError):
        READERS[kind](path)
        return Draft202012Validator(SCHEMAS[kind]).is_valid(yaml.load(text, Loader)), True
    return Draft202012Validator(SCHEMAS[kind]).is_valid(yaml.load(text, Loader)), False


def test_what_is_wrong_is_told_with_line_and_key() -> None:
    readers = {"pair": pair_record, "bench": bench_of, "device": device_of}
    pair = GOOD[ROOT / "fixtures" / "rotation.yaml"]
    for (kind, read), text in zip(readers.items(), (pair, BENCH, DEVICE), strict=True):
        require_refused(kind, text, lambda text, read=read: read(parse_document(text)))


def test_every_file_of_ours_passes() -> None:
    for kind in KINDS:
        Draft202012Validator.check_schema(SCHEMAS[kind])
    for path, text in GOOD.items():
        content = yaml.load(text, Loader)
        errors = [error.message for error in Draft202012Validator(SCHEMAS[content["kind"]]).iter_errors(content)]
        assert not errors, path


def test_what_passes_one_passes_both(tmp_path: Path) -> None:
    zero_45 = GOOD[ROOT / "fixtures" / "zero-45.yaml"]
    changes = (
        (BENCH, "jig: 0.05", "jig: -1"),
        (BENCH, "serial: A-1", "serial: ../A"),
        (BENCH, "axes: [-y, x]", "axes: [w, x]"),
        (BENCH, "uncertainty: 0.1", "uncertainty: much"),
        (BENCH, "tiltcal: 1", "tiltcal: 2"),
        (BENCH, "kind: bench", "kind: bank"),
        (BENCH, "operator:", "colour:"),
        (BENCH, "serial: A-1, ", ""),
        (GOOD[ROOT / "procedures" / "zero-45.yaml"], "axes: [x, y]", "axes: [x, x]"),
        *((zero_45, 'channels: [x, "y"]', channels) for channels in ("channels: [x, x]", "colour: [x, y]")),
        (GOOD[ROOT / "fixtures" / "rotation.yaml"], "turns: ", "colours: "),
        (GOOD[ROOT / "procedures" / "rotation.yaml"], "phase: ", "face: "),
        *((text, "truth:", "lie:") for path, text in GOOD.items() if path.parent.name == "twins"),
    )
    for good, old, new in changes:
        kind = yaml.load(good, Loader)["kind"]
        assert passes(kind, good, tmp_path / "file.yaml") == (True, True)
        assert passes(kind, good.replace(old, new), tmp_path / "file.yaml") == (False, False), new
