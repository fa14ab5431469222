"""The content of a pair file."""

from __future__ import annotations

from pathlib import Path

from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord, pair_record


def read_pair(path: str | Path) -> PairRecord:
    """Read and check a pair file."""
    return pair_record(read_document(path))
