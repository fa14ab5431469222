"""``tiltcal check``: check calibration files, procedures, twins and journals."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np

from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.measurement import remarks_on_wiring
from tiltcal.calibration.record import record_in
from tiltcal.calibration.wording import objections, remarks_on_chance
from tiltcal.cli import options
from tiltcal.cli.talk import in_options, remark
from tiltcal.core.model import Array
from tiltcal.errors import NEGATIVE_VERDICT, EstimateError, InputError, JournalError, TiltcalError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.device import device_of
from tiltcal.files.document import Document, read_document
from tiltcal.files.json_schema import json_schema
from tiltcal.files.pair import PairRecord
from tiltcal.files.procedure import procedure_in
from tiltcal.files.record import KINDS
from tiltcal.files.twin import twin_of
from tiltcal.files.yaml_text import Place, dotted, parse
from tiltcal.journal.calibrations import calibrations_of, texts_of
from tiltcal.journal.lines import Journal
from tiltcal.journal.session import RecordedSession

_NAMED = 5  # keys of a file that a finding names
_ROUNDING = 0.01  # share of an uncertainty by which versions may differ; two digits of it are written
_ABSENT = object()
_READERS: Mapping[str, Callable[[Document], object]] = {"twin": twin_of, "device": device_of}
_NO_COEFFICIENTS = (("temperature", "reference"), ("temperature", "range"))


@options.command(epilog="Example: tiltcal check S-0042.yaml S-0042.journal.jsonl")
@click.argument("paths", metavar="FILE...", nargs=-1, type=click.Path(path_type=Path))
@click.option("--schema", type=click.Choice([*KINDS]), help="Print the JSON Schema of a kind of file, for an editor.")
@options.as_json
def command(paths: tuple[Path, ...], schema: str | None, as_json: bool) -> int:
    """Check calibration files, procedures, devices, twins, bench files and journals.

    Exit code 2 if a file is wrong; the message names file, line and key, and the other files are checked too. Exit code
    1 if a file is readable, but has a negative verdict: an interrupted journal, a calibration whose coefficients the
    journal beside it does not give, a fit whose chi-square is not credible, or positions that do not agree.
    """
    if schema is not None:
        if paths:
            raise UsageError("--schema prints the JSON Schema of a kind and checks no file: leave FILE or --schema out")
        click.echo(options.json_text(json_schema(schema), 2))
        return 0
    if not paths:
        raise UsageError("check needs a FILE, or --schema KIND; see tiltcal check --help")
    results, wrong = [], 0
    for path in paths:
        try:
            kind, findings, remarks = _checked(path)
        except TiltcalError as problem:
            if len(paths) == 1:
                raise
            remark(in_options(problem))
            wrong += 1
            continue
        results.append({"file": str(path), "kind": kind, "findings": findings, "remarks": remarks})
        if not as_json:
            options.print_judged(f"{path}: {kind}, " + ("; ".join([*findings, *remarks]) or "good"))
    if as_json:
        options.print_judged(options.json_text(results, 2))
    if wrong:
        raise InputError(f"{wrong} of {len(paths)} files are wrong")
    return NEGATIVE_VERDICT if any(result["findings"] for result in results) else 0


def _checked(path: Path) -> tuple[str, list[str], list[str]]:
    """Return the kind of a file, its negative findings, and remarks that are none."""
    if _is_journal(path):
        return "journal", _of_journal(path), []
    document = read_document(path)
    kind = document.kind
    if kind is None:
        raise document.error("the key 'kind' is missing: this is not a tiltcal file")
    if kind in ("tilt", "pair"):
        return _of_calibration(path, document)
    if kind == "bench":  # of the bench nothing else is imported here
        import_module("tiltcal.bench.setup").known_bench(document)
    else:
        _READERS.get(kind, procedure_in)(document)
    return kind, [], []


def _is_journal(path: Path) -> bool:
    if not os.path.isfile(path):
        return False
    with suppress(OSError), open(path, "rb") as stream:
        return stream.read(18) == b'{"tiltcal-journal"'
    return False


def _of_journal(path: Path) -> list[str]:
    recorded = RecordedSession(Journal(path))
    findings = ["its last line is torn off"] if recorded.journal.torn else []
    if recorded.journal.ended:
        return findings
    findings.append(str(recorded.interrupted().message))
    with suppress(JournalError):  # interrupted before its last position
        try:
            calibrations_of(recorded)
        except EstimateError as wrong:
            findings.append(str(wrong))
    return findings


def _of_calibration(path: Path, document: Document) -> tuple[str, list[str], list[str]]:
    found = record_in(document)
    findings, remarks = _of_journal_beside(path, found)
    if isinstance(found, CalibrationRecord):
        wiring = remarks_on_wiring(found.coefficients, found.sensor.fitted_unit)
        return "calibration", objections(found) + findings, [*wiring, *remarks_on_chance(found.fit), *remarks]
    return "pair calibration", findings, remarks


def _of_journal_beside(path: Path, found: CalibrationRecord | PairRecord) -> tuple[list[str], list[str]]:
    """Replay the journal beside a calibration file; where its text differs, name what no rounding explains."""
    captured = found.provenance.journal
    if captured is None or not (os.path.isfile(path) and os.path.isfile(path.parent / captured.name)):
        return [], []
    journal = path.parent / captured.name
    made = calibrations_of(RecordedSession(Journal(journal)))
    texts = texts_of(made)
    if (text := path.read_text(encoding="utf-8")) in texts.values():
        return [], []
    serial = found.sensor.serial if isinstance(found, CalibrationRecord) else ""
    serial = serial if serial in texts else next(iter(texts), "")
    if not texts:
        return [f"{journal} does not give this file"], []
    new = made[serial]
    differing = list(_differing(parse(text)[0], parse(texts[serial])[0]))
    keys = [place for place, *_ in differing]
    if isinstance(found, CalibrationRecord) and isinstance(new, CalibrationRecord):
        covariance = new.uncertainty.covariance
        errors = np.sqrt(np.diag(covariance.as_array())) if covariance else np.empty(0)
        keys = [place for place, old, other in differing if not _differs_by_rounding(place, old, other, errors)]
        if not keys and compare_records(found, new).verdict.word == "unchanged":
            return [], [f"{journal} gives other digits with this version, which agree within their uncertainty"]
    named = ", ".join(dotted(key) or "all of it" for key in keys[:_NAMED]) or "the coefficients"
    more = f" and {len(keys) - _NAMED} more" if len(keys) > _NAMED else ""
    return [f"{journal} does not give this file: {named}{more} differ"], []


def _differing(found: Any, made: Any, place: Place = ()) -> Iterator[tuple[Place, Any, Any]]:
    """Yield the places of values that differ, with both values."""
    if isinstance(found, dict) and isinstance(made, dict):
        for key in {**found, **made}:
            yield from _differing(found.get(key, _ABSENT), made.get(key, _ABSENT), (*place, key))
    elif isinstance(found, list) and isinstance(made, list) and len(found) == len(made):
        for number, pair in enumerate(zip(found, made, strict=True)):
            yield from _differing(*pair, (*place, number))
    elif found != made:
        yield place, found, made


def _differs_by_rounding(place: Place, found: Any, made: Any, errors: Array) -> bool:
    """Return whether a value may differ in its digits: a coefficient, or an uncertainty that differs by rounding."""
    if place[0] not in ("calibration", "uncertainty") or place[1:3] in _NO_COEFFICIENTS:
        return False
    try:
        old, new = float(found), float(made)
    except (TypeError, ValueError):  # text, or a key that one of them lacks
        return False
    match place:
        case ("calibration", *_):
            return True  # which the comparison of both judges
        case (_, "covariance", _, int(row), int(column)):
            scale = errors[row] * errors[column]
        case _:
            scale = abs(new)
    return bool(abs(old - new) <= _ROUNDING * scale)
