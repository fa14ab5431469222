"""The flag of a row, by QARTOD, and its reasons: what they mean, and how rows are marked and counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Reasons = NDArray[np.uint16]
Mask = NDArray[np.bool_]

PASS, SUSPECT, FAIL, MISSING = 1, 3, 4, 9  # QARTOD flags, worst last

CLIPPED, TEMPERATURE_RANGE, RAIL, TILT_RANGE, NO_TEMPERATURE, NOT_A_NUMBER = 1, 2, 4, 8, 16, 32
OUTSIDE_TIME, NO_DIRECTION, GRAVITY_LENGTH = 64, 128, 256  # bits of a reason

FLAGS = {PASS: "pass", SUSPECT: "suspect", FAIL: "fail", MISSING: "missing"}
REASONS = {
    CLIPPED: "arcsine argument beyond ±1",
    TEMPERATURE_RANGE: "temperature outside the calibrated range",
    RAIL: "reading at the rail",
    TILT_RANGE: "tilt outside the calibrated range",
    NO_TEMPERATURE: "temperature missing",
    NOT_A_NUMBER: "not a number",
    OUTSIDE_TIME: "outside the time of the calibrations",
    NO_DIRECTION: "no direction or its sign unknown, or a magnetic field of unusual length",
    GRAVITY_LENGTH: "length of gravity is not 1 g",
}


class FlaggedRows(Protocol):
    """Rows with a flag and its reasons."""

    @property
    def flag(self) -> Bytes: ...

    @property
    def reason(self) -> Reasons: ...


def mark(out: FlaggedRows, rows: Mask, flag: int, reason: int) -> None:
    """Add a reason to ``rows``, and raise their flag to ``flag`` where it is lower."""
    if rows.any():
        out.reason[rows] |= np.uint16(reason)
        out.flag[rows] = np.maximum(out.flag[rows], np.uint8(flag))


def mark_columns(
    table: Mapping[str, NDArray[Any]], rows: Mask | np.bool_, flag: int | Bytes, reason: int | Reasons
) -> dict[str, Any]:
    """Return the columns of a result in which some rows are marked; rows that are missing stay as they are.

    The table has ``flag`` and ``reason``, of several sensors ``S_flag`` and ``S_reason``.
    """
    found = dict(table)
    if rows.any():
        for lead in [name.removesuffix("flag") for name in table if name.rpartition("_")[2] == "flag"]:
            flags, reasons = table[f"{lead}flag"], np.asarray(table[f"{lead}reason"], np.uint16)
            marked = rows & (flags != MISSING)
            found[f"{lead}flag"] = np.where(marked, np.maximum(flags, flag), flags).astype(np.uint8)
            found[f"{lead}reason"] = np.where(marked, reasons | reason, reasons).astype(np.uint16)
    return found


def count_flags(flags: Counter[int], reasons: Counter[int], flag: NDArray[Any], reason: NDArray[Any]) -> None:
    """Add some rows to the rows by flag, and to those by bit of the reason, of which a row may have several."""
    for code in FLAGS:
        if count := int(np.count_nonzero(flag == code)):
            flags[code] += count
    for bit in REASONS:
        if count := int(np.count_nonzero(reason & np.uint16(bit))):
            reasons[bit] += count
