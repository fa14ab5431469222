"""The page of a tilt calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import CalibrationRecord, dump_calibration
from tiltcal.files.results import FileRecord
from tiltcal.report.coefficients_section import (
    SOURCES,
    budget,
    change_section,
    coefficient_table,
    correlations,
    derived_groups,
    sources_of,
)
from tiltcal.report.fit_section import position_table, remarks, verdict
from tiltcal.report.log_section import ReportedLog, log_section
from tiltcal.report.page import render, require_extra
from tiltcal.report.provenance import facts, notice, procedure_facts
from tiltcal.report.residual_figure import residual_figure
from tiltcal.report.temperature_figure import temperature_figure
from tiltcal.report.tilt_figure import tilt_figure
from tiltcal.report.validity import covered, not_covered


def write_tilt_page(path: str | Path, calibration: CalibrationRecord) -> None:
    """Write the page of a calibration in memory.

    UsageError: the libraries of the extra ``report`` are not installed, or the page cannot be written there.
    """
    require_extra()
    check_writable(path)
    name = f"{calibration.sensor.serial}.yaml"
    write_whole(path, tilt_page(calibration, FileRecord.of_text(name, dump_calibration(calibration))))


def tilt_page(
    calibration: CalibrationRecord,
    source: FileRecord,
    earlier: Sequence[tuple[CalibrationRecord, str]] = (),
    logs: Sequence[ReportedLog] = (),
) -> str:
    """Return one HTML page that needs no other file; the same input gives the same page.

    Parameters
    ----------
    earlier : sequence of (CalibrationRecord, str)
        Earlier calibrations of the sensor, with the names of their files.
    """
    shares = budget(calibration)
    return render(
        "tilt.html.j2",
        calibration=calibration,
        sensor=calibration.sensor,
        channels=calibration.coefficients.channels,
        notice=notice(calibration.provenance),
        facts=facts(calibration, source),
        procedure=procedure_facts(calibration),
        coefficients=coefficient_table(calibration),
        budget=shares,
        sources={name: SOURCES.get(name, name) for name in sources_of(shares)},
        shaded=tuple(SOURCES),
        derived=derived_groups(calibration),
        positions=position_table(calibration),
        verdict=list(verdict(calibration)),
        remarks=remarks(calibration),
        correlations=correlations(calibration),
        covered=covered(calibration),
        not_covered=not_covered(calibration),
        drifts=[change_section(calibration_, name, calibration) for calibration_, name in earlier],
        logs=[log_section(log, number) for number, log in enumerate(logs, start=1)],
        residuals=residual_figure(calibration),
        temperature=temperature_figure(calibration),
        tilt=tilt_figure(calibration),
    )
