"""One or several logs of a sensor as one session: columns with their signs, rows behind each other, and their unit."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.column_guess import LENGTHS
from tiltcal.core.model import AXES, Array
from tiltcal.drivers.model import OF_G
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.results import LogRecord
from tiltcal.files.tables import Segment
from tiltcal.logs.columns import RecordedColumns, named_columns, read_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress

SAME_LENGTH, APART = 0.05, 30.0  # of two attitudes that show it: their lengths, relative, and the turn between, degrees
CONTRADICTED = 0.15  # largest relative difference of the length of gravity from that of the unit


@dataclass(frozen=True)
class Recordings:
    """Logs of one session, in their order; ``positions`` are the names of those that are one position each."""

    logs: Sequence[LogReader]
    positions: Sequence[str | None]

    @property
    def name(self) -> str:
        """What messages call them."""
        return self.logs[0].name if len(self.logs) == 1 else f"the {len(self.logs)} logs"

    @property
    def remarks(self) -> Sequence[str]:
        """What their readers say of them, each once."""
        return list(dict.fromkeys(remark for log in self.logs for remark in (*log.remarks, *log.clock.remarks)))

    def read(
        self, channels: Sequence[str], columns: Mapping[str, str] | str, unit: str, others: Sequence[str] = ()
    ) -> tuple[RecordedColumns, list[Segment]]:
        """Return the rows of all logs, and those of each that is a position."""
        records = [read_readings(log, channels, columns, unit, others) for log in self.logs]
        ends = np.cumsum([len(record) for record in records]).tolist()
        roles = dict.fromkeys(role for record in records for role in record.by_role)
        absent = {role: [record.name for record in records if role not in record.by_role] for role in roles}
        shared = [role for role, names in absent.items() if not names]
        lacking = ((role, ", ".join(names)) for role, names in absent.items() if names)
        self.logs[0].remarks += [f"{role} is left out of all logs: there is none in {names}" for role, names in lacking]
        by_role = {role: np.concatenate([record.by_role[role] for record in records]) for role in shared}
        joined = RecordedColumns(by_role, self.name, sum(record.faulty for record in records))
        named = zip(self.positions, [0, *ends], ends, strict=False)
        segments = [Segment(name, start, end, None, None) for name, start, end in named if name is not None]
        return (records[0] if len(records) == 1 else joined), segments

    def provenance(self, record: RecordedColumns, missing: int | None = None) -> dict[str, Any]:
        """Return what was read of files; nothing of a frame."""
        made = [
            LogRecord(name=Path(log.source.path).name, sha256=sha, rows=log.rows_read, missing=missing)
            for log in self.logs
            if (sha := log.sha256) is not None
        ]
        return {"log": made[0] if made else None} if len(self.logs) == 1 else {"logs": tuple(made)}


@contextmanager
def open_recordings(data: Any, *, skip_bad_rows: bool, progress: Progress | None) -> Iterator[Recordings]:
    """Open a log, or several of one session; ``NAME=FILE`` is a log of one position."""
    sources = [_named(source) for source in (data if are_paths(data) else [data])]
    names = [name for name, _ in sources]
    if not sources:
        raise UsageError("no log is given")
    if None in names and any(names):
        alone = sources[names.index(None)][1]
        raise UsageError(f"{alone} has no name of a position, and others have one: write NAME={alone}, or name none")
    with ExitStack() as opened:
        logs = [
            opened.enter_context(open_log(source, skip_bad_rows=skip_bad_rows, progress=progress))
            for _, source in sources
        ]
        yield Recordings(logs, names)


def are_paths(data: Any) -> bool:
    """Return whether data are several logs by their paths, or none."""
    return isinstance(data, Sequence) and not isinstance(data, str) and all(isinstance(k, str | Path) for k in data)


def _named(source: Any) -> tuple[str | None, Any]:
    """Return the position that a source names, and its log."""
    if isinstance(source, str) and "=" in source and not os.path.exists(source):
        name, _, file = source.partition("=")
        return name.strip(), file
    return None, source


def split_signs(columns: Mapping[str, str] | str, names: Sequence[str]) -> tuple[dict[str, str], dict[str, float]]:
    """Return the columns by role, and the sign of each axis that reads the other way round (``x=-NAME``).

    A column whose own name begins with a minus is that column.
    """
    named = named_columns(columns, AXES)
    turned = [axis for axis in AXES if named.get(axis, "").startswith("-") and named[axis] not in names]
    plain = {role: name[1:] if role in turned else name for role, name in named.items()}
    return plain, dict.fromkeys(turned, -1.0)


def with_signs(record: RecordedColumns, signs: Mapping[str, float]) -> RecordedColumns:
    """Return columns with their signs turned."""
    turned = {role: column * signs[role] if role in signs else column for role, column in record.by_role.items()}
    return replace(record, by_role=turned) if signs else record


def of_raw_readings(calibration: CalibrationRecord, signs: Mapping[str, float]) -> CalibrationRecord:
    """Return a calibration of readings with turned signs as that of the readings themselves."""
    if not signs:
        return calibration

    def sign(channel: str) -> float:
        return signs.get(channel, 1.0)

    found, uncertainty, fit = calibration.coefficients, calibration.uncertainty, calibration.fit
    factors = np.array([sign(channel) for channel in found.channels])
    thermal = found.thermal and replace(found.thermal, drift=found.thermal.drift * factors[:, None])
    if (covariance := uncertainty.covariance) is not None:
        each = np.array([sign(_channel_of(name)) for name in covariance.parameters])
        covariance = covariance.turned(each)
    worst = fit.worst and fit.worst.replaced(residual=fit.worst.residual * sign(fit.worst.channel))
    return replace(
        calibration,
        coefficients=replace(
            found, offset=found.offset * factors, sensitivity=found.sensitivity * factors[:, None], thermal=thermal
        ),
        uncertainty=replace(uncertainty, covariance=covariance),
        fit=fit.replaced(
            worst=worst,
            residuals={
                position: {channel: value * sign(channel) for channel, value in row.items()}
                for position, row in fit.residuals.items()
            },
        ),
        positions=tuple(
            position.replaced(mean={channel: value * sign(channel) for channel, value in position.mean.items()})
            for position in calibration.positions
        ),
    )


def _channel_of(name: str) -> str:
    """Return the channel whose sign a coefficient has; none of what a sign does not change."""
    parts = name.split(".")
    offsets = parts[1] if parts[0] in ("offset", "sensitivity") else ""
    return parts[2] if parts[:2] == ["temperature", "offset"] else offsets


def unit_of_length(means: Array, columns: Sequence[Array], *, alone: bool = False) -> str | None:
    """Return the unit in which gravity is as long as readings at rest, of three axes, (n, 3); None where none shows.

    Two attitudes must show it, or one if ``alone``; columns of whole numbers are counts, which say nothing.
    """
    if len(columns) != 3 or any(bool(np.all(column[np.isfinite(column)] % 1.0 == 0.0)) for column in columns):
        return None
    lengths = np.linalg.norm(means, axis=1)
    directions = means / np.maximum(lengths, 1e-300)[:, None]
    for unit, (low, high) in LENGTHS.items():
        near = (low <= lengths) & (lengths <= high)
        some, size = directions[near], lengths[near]
        apart = some @ some.T < np.cos(np.radians(APART))
        alike = np.abs(size[:, None] - size) <= SAME_LENGTH * size
        if near.mean() > 0.5 and (alone or bool((apart & alike).any())):
            return unit
    return None


def length_remark(means: Array | None, unit: str, columns: Sequence[Array]) -> str | None:
    """Return what speaks against a unit that is stated: the length of gravity at rest, of means (n, 3)."""
    usual = OF_G.get(unit)
    if usual is None or means is None or means.shape[1] != 3:
        return None
    length = float(np.median(np.linalg.norm(means, axis=1)))
    if abs(length / usual - 1.0) <= CONTRADICTED:
        return None
    likely = unit_of_length(means, columns)
    said = f"at rest the readings are {length:.4g} {unit} long, and gravity is {usual:g} {unit}"
    if likely is not None:
        return f"{said}: the unit is probably {likely}"
    if length < 0.3 * usual:
        return f"{said}: without gravity, as linear acceleration is, nothing can be calibrated"
    return f"{said}: is this the unit?"


def upside_down_remark(calibration: CalibrationRecord) -> str | None:
    """Return that the longest hold is upside down, as it seems where signs are reversed."""
    longest = max(calibration.positions, key=lambda one: one.n or 0, default=None)
    set_ = None if longest is None else calibration.procedure.set.get(longest.position)
    up = None if set_ is None else set_.gravity
    if longest is None or up is None or up[2] > -0.7:
        return None
    return (
        f"the longest hold, {longest.position}, is upside down: if the device lay face up there, its signs are "
        "reversed, as phones of one maker have them; then fit again with --columns x=-NAME,y=-NAME,z=-NAME"
    )


def require_no_signs(columns: Mapping[str, str] | str, names: Sequence[str]) -> None:
    """Refuse a turned sign where a calibration is applied: it belongs to the file."""
    stated = columns.values() if isinstance(columns, Mapping) else (part.split("=")[-1] for part in columns.split(","))
    if turned := [name for name in map(str.strip, map(str, stated)) if name.startswith("-") and name not in names]:
        why = f"{turned[0]} has a minus, and signs belong to the calibration"
        raise UsageError(option="columns", why=why, advice=f"name {turned[0][1:]}; the file that was fitted turns it")
