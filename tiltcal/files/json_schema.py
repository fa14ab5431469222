"""The declarations of all kinds of files, and their JSON Schemas for editors."""

from __future__ import annotations

from typing import Any

from tiltcal.files.bench import BENCH
from tiltcal.files.calibration import TILT
from tiltcal.files.declaration import Format
from tiltcal.files.pair import PAIR
from tiltcal.files.procedure_file import PROCEDURE
from tiltcal.files.twin import TWIN

FORMATS: dict[str, Format[Any]] = {"tilt": TILT, "pair": PAIR, "procedure": PROCEDURE, "bench": BENCH, "twin": TWIN}
"""By the ``kind`` that a file states."""


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file."""
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, "title": f"tiltcal {kind}", **FORMATS[kind].schema()}
