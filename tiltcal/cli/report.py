"""``tiltcal report``: write a page about a calibration, a log or a folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.cli.history import read_history
from tiltcal.cli.match import spectra_of
from tiltcal.cli.talk import progress_bar, remark
from tiltcal.column_names import TIME
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import CalibrationRecord, tilt_record
from tiltcal.files.calibration_folder import SUFFIXES
from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord, pair_record
from tiltcal.files.results import FileRecord
from tiltcal.logs.apply import look_over
from tiltcal.logs.columns import named_columns
from tiltcal.logs.formats import open_log
from tiltcal.logs.kernel import prepare
from tiltcal.logs.match import read_pair_log
from tiltcal.logs.options import ApplyOptions
from tiltcal.logs.streams import sha256_of
from tiltcal.options import complete
from tiltcal.report.figure import require_extra
from tiltcal.report.page import fleet_page, pair_page, tilt_page
from tiltcal.report.record_figures import PairDrawing, ReportedLog

_EXAMPLES = """\b
Examples:
  tiltcal report S-0042.yaml -o S-0042.html
  tiltcal report S-0042.yaml night-tilt.csv -o S-0042.html
  tiltcal report S-0042-spring.yaml S-0042-autumn.yaml -o S-0042.html
  tiltcal report calibrations -o fleet.html
"""


@options.command(epilog=_EXAMPLES)
@click.argument("files", nargs=-1, required=True, metavar="CAL.yaml [LOG]...")
@options.file_option("-o", "--output", required=True, metavar="REPORT.html", help="The page to write.")
@click.option(
    "--columns",
    default="",
    metavar="ROLE=NAME,…",
    help="The column of each reading in a LOG, such as x=VoutX,y=VoutY,temperature=T.",
)
@click.option("--skip-bad-rows", is_flag=True, help="Count rows of a LOG that cannot be parsed, instead of an error.")
def command(files: tuple[str, ...], output: Path, columns: str, skip_bad_rows: bool) -> None:
    """Write one HTML page about a calibration, to read, print and file with the sensor.

    The page needs no other file and prints on A4. It shows what was calibrated and how, the coefficients with their
    uncertainty and its sources, the residuals, and the range in which the calibration holds. A LOG, raw or as `tiltcal
    apply` wrote it, adds its flags and its tilt over time. With several calibrations of one sensor, oldest first, the
    page is about the last one and shows the changes since each of the others. For pairs (from `tiltcal match`) it shows
    the components before and after, and with the LOG their spectra. For a folder it shows what `tiltcal history`
    prints, with figures of the distributions.
    """
    write_report(files, output, columns=columns, skip_bad_rows=skip_bad_rows)
    remark(f"wrote {output}")


def write_report(files: Sequence[str], output: Path, *, columns: str = "", skip_bad_rows: bool = False) -> None:
    """Write the page; the arguments and errors are those of the command."""
    require_extra()
    check_writable(output, *files)
    if len(files) == 1 and os.path.isdir(files[0]):
        write_whole(output, fleet_page(read_history(Path(files[0]))))
        return
    calibrations = [name for name in files if name.lower().endswith(SUFFIXES)]
    logs = [name for name in files if name not in calibrations]
    if not calibrations:
        raise UsageError("no calibration file is given: name a CAL.yaml")
    write_whole(output, _page(calibrations, logs, columns, skip_bad_rows))


def _page(names: Sequence[str], logs: Sequence[str], columns: str, skip_bad_rows: bool) -> str:
    documents = [read_document(name) for name in names]
    if "pair" in [document.kind for document in documents]:
        if len(documents) > 1:
            raise UsageError("a report of pairs is about one file; give it alone, with its LOG if there is one")
        if columns:
            raise UsageError("--columns is for tilt calibrations; the columns of pairs are named in their file")
        pairs = pair_record(documents[0])
        return pair_page(pairs, _source(names[0]), [_spectra(log, pairs, skip_bad_rows) for log in logs])
    calibrations = [tilt_record(document) for document in documents]
    last, file = calibrations[-1], Path(names[-1])
    before = [(calibration, Path(name).name) for calibration, name in zip(calibrations[:-1], names, strict=False)]
    reported = [_look_over(log, last, file, columns, skip_bad_rows) for log in logs]
    return tilt_page(last, _source(names[-1]), before, reported)


def _look_over(log: str, calibration: CalibrationRecord, file: Path, columns: str, skip_bad_rows: bool) -> ReportedLog:
    """Return the overview of a log, to whose readings the calibration is applied."""
    stated = complete(ApplyOptions, {"columns": columns})
    prepared = prepare(calibration, stated, file=file)
    with progress_bar("report") as progress, open_log(log, skip_bad_rows=skip_bad_rows, progress=progress) as rows:
        timed = named_columns(columns, prepared.channels).get(TIME, TIME) in rows.names
        overview = look_over(rows, replace(prepared, roles=(TIME,)) if timed else prepared, stated)
        return ReportedLog(Path(rows.name).name, str(rows.sha256), overview, timed)


def _spectra(log: str, calibration: PairRecord, skip_bad_rows: bool) -> tuple[str, PairDrawing]:
    """Return the name of a log, and the spectra of the first pair in it."""
    matching = calibration.matchings[0]
    with progress_bar("report") as progress, open_log(log, skip_bad_rows=skip_bad_rows, progress=progress) as rows:
        try:
            read = read_pair_log(rows, matching.pair.channels, calibration.spin.phase)
            return Path(rows.name).name, spectra_of(matching, read)
        except EstimateError as refusal:
            raise EstimateError((f"{rows.name}: ", *refusal.words)) from refusal


def _source(name: str) -> FileRecord:
    return FileRecord(name=Path(name).name, sha256=sha256_of(name))
