"""The pages of a calibration, of pairs and of a fleet: each one HTML file, with its style and figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.calibration.season import FleetHistory
from tiltcal.calibration.tilt_uncertainty import tilt_uncertainty
from tiltcal.calibration.wording import suppressed
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.pair import PairRecord
from tiltcal.files.results import FileRecord
from tiltcal.report import sentences, tables
from tiltcal.report.calibration_figures import residual_figure, temperature_figure, tilt_figure
from tiltcal.report.figure import require_extra
from tiltcal.report.numbers import Html, grouped, plain
from tiltcal.report.record_figures import (
    PairDrawing,
    ReportedLog,
    change_figure,
    distribution_figure,
    log_figure,
    spectra_figure,
)

if TYPE_CHECKING:
    from jinja2 import Environment


def write_page(path: str | Path, calibration: CalibrationRecord | PairRecord) -> None:
    """Write the page of a calibration in memory.

    UsageError: the libraries of the extra ``report`` are not installed, or the page cannot be written there.
    """
    require_extra()
    check_writable(path)
    if isinstance(calibration, PairRecord):
        text = pair_page(calibration, FileRecord.of_text("pairs.yaml", calibration.text))
    else:
        name = f"{calibration.sensor.serial}.yaml"
        text = tilt_page(calibration, FileRecord.of_text(name, calibration.text))
    write_whole(path, text)


def tilt_page(
    calibration: CalibrationRecord,
    source: FileRecord,
    earlier: Sequence[tuple[CalibrationRecord, str]] = (),
    logs: Sequence[ReportedLog] = (),
) -> str:
    """Return the page of a tilt calibration; the same input gives the same page.

    ``earlier`` are calibrations of the sensor, with the names of their files.
    """
    curves = tilt_uncertainty(calibration)
    return _render(
        "tilt.html.j2",
        calibration=calibration,
        notice=sentences.notice(calibration.provenance),
        result=sentences.result(calibration, curves),
        facts=sentences.facts(calibration, source),
        coefficients=tables.coefficient_table(calibration),
        budget=tables.budget_table(calibration),
        derived=tables.derived_groups(calibration),
        tilt=tilt_figure(calibration, curves),
        temperature=temperature_figure(calibration),
        procedure=sentences.procedure_facts(calibration),
        positions=tables.position_table(calibration),
        verdict=list(sentences.verdict(calibration)),
        remarks=sentences.remarks(calibration),
        residuals=residual_figure(calibration),
        covered=sentences.covered(calibration),
        not_covered=sentences.not_covered(calibration),
        changes=[
            (sentences.dated(name, before.provenance), *tables.change_table(before, calibration))
            for before, name in earlier
        ],
        logs=[_log(log, number) for number, log in enumerate(logs)],
    )


def _log(log: ReportedLog, number: int) -> dict[str, Any]:
    overview = log.overview
    any_angle = bool(np.isfinite(overview.low).any())
    return {
        "name": log.name,
        "sha256": log.sha256,
        "rows": "1 row" if overview.rows == 1 else f"{grouped(overview.rows)} rows",
        "flags": tables.flag_table(overview),
        "angles": tables.angle_table(overview) if any_angle else None,
        "figure": log_figure(log, number) if any_angle else None,
    }


def pair_page(calibration: PairRecord, source: FileRecord, spectra: Sequence[tuple[str, PairDrawing]] = ()) -> str:
    """Return the page of accelerometer pairs, with the spectra of logs; the same input gives the same page."""
    return _render(
        "pair.html.j2",
        names=[f"{matching.pair.first} and {matching.pair.second}" for matching in calibration.matchings],
        notice=sentences.notice(calibration.provenance),
        facts=sentences.pair_facts(calibration, source),
        pairs=[
            {
                "heading": f"{one.pair.first} and {one.pair.second}, orthogonal {one.pair.orthogonal}",
                "coefficients": tables.pair_coefficient_table(one),
                "suppression": f"{suppressed(one, _factor)}.".capitalize(),
                "components": tables.component_table(one),
            }
            for one in calibration.matchings
        ],
        logs=[(name, spectra_figure(name, number, drawing)) for number, (name, drawing) in enumerate(spectra)],
    )


def _factor(value: float) -> str:
    """Return a factor with three significant digits and separated thousands."""
    return grouped(int(float(f"{value:.3g}"))) if value >= 1000.0 else plain(value, 3)


def fleet_page(history: FleetHistory) -> str:
    """Return the page of a folder of calibrations: what is due, what changed, and how coefficients are distributed."""
    return _render(
        "fleet.html.j2",
        history=history,
        facts=sentences.fleet_facts(history),
        sensors=tables.sensor_table(history),
        changes=tables.fleet_change_table(history),
        models=[
            {
                "heading": f"{len(model.histories)} {model.model}"
                + ("" if model.reference is None else f", at {model.reference:g} °C"),
                "coefficients": tables.distribution_table(model),
                "figures": [distribution_figure(model, number), change_figure(model, number)],
            }
            for number, model in enumerate(history.models)
        ],
    )


def _render(template: str, **content: Any) -> str:
    """Return a page from a template; whatever it is given is escaped but :class:`Html` and figures."""
    return _environment().get_template(template).render(**content)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("tiltcal.report"), undefined=StrictUndefined, autoescape=True, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["svg"] = lambda picture: Html(picture.svg)
    return environment
