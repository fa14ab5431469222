"""The summary of an applied log: rows by flag and reason, and the widths of the intervals."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiltcal.core.flags import FLAGS, REASONS, count_flags
from tiltcal.core.model import Array
from tiltcal.logs.log import Table
from tiltcal.printable import counted


class ColumnWidths:
    """Positive numbers, counted by size: by some bits of the mantissa, from one power of 2 to another; NaN is none."""

    def __init__(self, bits: int = 7, powers: tuple[int, int] = (-127, 128)) -> None:
        self._shift = 23 - bits
        self._first, end = ((127 + power) << bits for power in powers)
        self._counts = np.zeros(end - self._first, np.int64)
        self._largest = 0.0

    def add(self, widths: Array) -> None:
        """Count some more."""
        finite = np.isfinite(widths)
        known = widths if finite.all() else widths[finite]
        if len(known):
            self._largest = max(self._largest, float(known.max()))
            codes = (known.astype(np.float32).view(np.int32) >> self._shift) - self._first
            np.clip(codes, 0, len(self._counts) - 1, out=codes)
            self._counts += np.bincount(codes, minlength=len(self._counts))

    @property
    def median(self) -> float | None:
        """The median, to half the distance of neighbours; None where there is no value."""
        total = int(self._counts.sum())
        if not total:
            return None
        code = self._first + int(np.searchsorted(np.cumsum(self._counts), (total + 1) // 2))
        ends = np.array([code << self._shift, (code + 1) << self._shift], np.int32).view(np.float32)
        return min(float(ends.mean()), self._largest)

    @property
    def largest(self) -> float | None:
        """The largest value; None where there is none."""
        return self._largest if self._counts.any() else None


@dataclass(repr=False)
class ApplySummary:
    """The counts of an applied log: rows by flag and by reason.

    rows: written, every one that was read.
    flags: rows by flag.
    reasons: rows by bit of the reason; a row may have several.
    bad_rows: rows that could not be parsed and were kept as missing.
    widths: the columns that were to be watched, half widths of 95 % intervals: degrees, and of velocities their unit.
    sensors: of each sensor, by serial number, where the log has several; the whole then counts the worst flag of a row,
        and every reason of it.
    """

    rows: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    reasons: Counter[int] = field(default_factory=Counter)
    bad_rows: int = 0
    widths: dict[str, ColumnWidths] = field(default_factory=dict)
    sensors: dict[str, ApplySummary] = field(default_factory=dict)

    def add(self, table: Table, bad_rows: int = 0) -> None:
        """Count some rows, and those of them that could not be parsed."""
        for name, widths in self.widths.items():
            widths.add(np.asarray(table[name], dtype=float))
        flags, reasons = [], []
        for lead in [name.removesuffix("flag") for name in table if name.rpartition("_")[2] == "flag"]:
            flags.append(np.asarray(table[f"{lead}flag"], np.uint16))
            reasons.append(np.asarray(table[f"{lead}reason"], np.uint16))
            if lead:
                of_sensor = self.sensors.setdefault(lead.removesuffix("_"), ApplySummary())
                of_sensor.add({"flag": flags[-1], "reason": reasons[-1]})
        self.rows += len(flags[0])
        self.bad_rows += bad_rows
        count_flags(self.flags, self.reasons, np.maximum.reduce(flags), np.bitwise_or.reduce(reasons))

    def as_data(self) -> dict[str, Any]:
        """Return the counts as plain data, every flag and reason that occurred."""
        data = {"rows": self.rows, **self._counts(), "bad_rows": self.bad_rows}
        if self.widths:
            data["uncertainty"] = {n: {"median": w.median, "largest": w.largest} for n, w in self.widths.items()}
        if self.sensors:
            data["sensors"] = {serial: sensor._counts() for serial, sensor in self.sensors.items()}
        return data

    def _counts(self) -> dict[str, dict[str, int]]:
        return {
            "flags": {str(flag): self.flags[flag] for flag in FLAGS if self.flags[flag]},
            "reasons": {str(bit): self.reasons[bit] for bit in REASONS if self.reasons[bit]},
        }

    def __str__(self) -> str:
        """Return the counts in words, one line for each."""
        lines = [counted(self.rows, "row")]
        for serial, summary in (self.sensors or {"": self}).items():
            lead = f"  {serial} " if serial else "  "
            for what, names, counts in (("flag", FLAGS, summary.flags), ("reason", REASONS, summary.reasons)):
                lines += [f"{lead}{what} {code} {name}: {counts[code]}" for code, name in names.items() if counts[code]]
        if self.bad_rows:
            lines.append(f"  {counted(self.bad_rows, 'row')} could not be parsed and kept as missing")
        if self.widths:
            lines.append(f"  median (largest) {', '.join(_told(name, width) for name, width in self.widths.items())}")
        return "\n".join(lines)

    __repr__ = __str__


def _told(name: str, widths: ColumnWidths) -> str:
    if widths.median is None or widths.largest is None:
        return f"{name} none"
    unit = "" if name.startswith("U95_v_") else "°"
    return f"{name} {widths.median:.2g}{unit} ({widths.largest:.2g}{unit})"
