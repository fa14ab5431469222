"""The JSON Schemas of all kinds of files, for editors."""

from __future__ import annotations

from typing import Any

from msgspec.json import decode, encode, schema_components

from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import TiltFile
from tiltcal.files.device import DeviceFile
from tiltcal.files.pair import PairFile
from tiltcal.files.procedure_file import ProcedureFile, RotationFile
from tiltcal.files.record import FORMAT_VERSION, Record
from tiltcal.files.twin import StageFile, TwinFile

FILES: dict[str, tuple[type[Record], ...]] = {
    "tilt": (TiltFile,),
    "pair": (PairFile,),
    "procedure": (ProcedureFile, RotationFile),
    "bench": (BenchFile,),
    "device": (DeviceFile,),
    "twin": (TwinFile, StageFile),
}
"""By the ``kind`` that a file states."""


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file."""
    files, definitions = schema_components(FILES[kind])
    for file in FILES[kind]:
        definition = definitions[file.__name__]
        stated = {"tiltcal": {"const": FORMAT_VERSION}, "kind": {"const": kind}}
        definition["properties"] = stated | definition["properties"]
        definition["required"] = [*stated, *definition["required"]]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    schema = {
        "$schema": dialect,
        "title": f"tiltcal {kind}",
        "type": "object",
        "anyOf": list(files),
        "$defs": definitions,
    }
    plain: dict[str, Any] = decode(encode(schema))
    return plain
