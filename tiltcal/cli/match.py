"""``tiltcal match``: match accelerometer pairs by a recorded log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar, remark
from tiltcal.core.pair.matching import Matching
from tiltcal.errors import UsageError
from tiltcal.files.atomic import check_writable
from tiltcal.files.calibration_output import require_replaceable
from tiltcal.library.calibration import PairCalibration
from tiltcal.logs.match import PairLog, match_log, pairs_of
from tiltcal.report.record_figures import PairDrawing, draw_matching

_EXAMPLES = """\b
Examples:
  tiltcal match disk.csv --pair a1,a2 --orthogonal a4 --phase theta -o disk.yaml
  tiltcal match disk.csv --pair a1,a2 --orthogonal a4 --pair a3,a4 --orthogonal a1 --phase theta -o disk.yaml
  tail -n +1 -f disk.csv | tiltcal match - --pair a1,a2 --orthogonal a4 --phase theta --online -o disk.yaml
"""


@options.command(epilog=_EXAMPLES)
@click.argument("log")
@click.option("--pair", "pairs", multiple=True, required=True, metavar="FIRST,SECOND", help="Columns of a pair.")
@click.option(
    "--orthogonal",
    "orthogonals",
    multiple=True,
    required=True,
    metavar="NAME",
    help="Column of an accelerometer a quarter turn away; one per --pair, in the same order.",
)
@click.option(
    "--phase",
    metavar="NAME",
    help="Column of the stage angle, degrees. Without it, the spin is estimated from the readings and the column time.",
)
@click.option(
    "--online",
    is_flag=True,
    help="Estimate once a turn, as on a live stream, and report a standing stage and gaps; needs --phase.",
)
@click.option(
    "--loops", is_flag=True, help="With --online: p and q from the two PID loops instead of the recursive estimator."
)
@click.option("--skip-bad-rows", is_flag=True, help="Leave out rows that cannot be parsed, instead of an error.")
@options.file_option(
    "--figure",
    metavar="SVG",
    help="Draw the spectra of the first pair before and after, and with --online the course of the estimates.",
)
@options.as_json
@options.file_option("-o", "--output", metavar="PAIR.yaml", help="The pair file to write.")
def command(
    log: str, pairs: tuple[str, ...], orthogonals: tuple[str, ...], figure: Path | None, as_json: bool,
    output: Path | None, **settings: Any,
) -> None:  # fmt: skip
    """Match accelerometer pairs on a rotary stage: scale factor p and misalignment q.

    LOG is CSV with a header, Parquet, NetCDF-4, or - for CSV on standard input; it is read once, whatever its size. The
    matched sum FIRST + (SECOND + q ORTHOGONAL) / (1 - p) is free of the acceleration that is common to all of them;
    `tiltcal apply` adds it to a log. Two pairs also give the gradient signal. A column time is in seconds or ISO 8601.

    With --online, Ctrl-C ends the stream, and the estimates until then are the result.
    """
    wanted = pairs_of(_triples(pairs, orthogonals))
    if figure:
        check_writable(figure, log)
    if output:
        require_replaceable(output, None, log)
    with progress_bar("match") as progress:
        record, read, course = match_log(log, wanted, say=remark, progress=progress, **settings)
    calibration = PairCalibration(record)
    first = calibration.matchings[0]
    drawing = spectra_of(first, read) if figure else None
    if output:
        calibration.save(output, remark)
    if figure and drawing:
        draw_matching(figure, replace(drawing, course=course, uncertainty=max(first.u_p, first.u_q)))
    if as_json:
        shown = [_as_data(matching) for matching in calibration.matchings]
        click.echo(options.json_text(shown[0] if len(shown) == 1 else {"pairs": shown}))
    else:
        click.echo(str(calibration))


def spectra_of(matching: Matching, log: PairLog) -> PairDrawing:
    """Return the spectra of a pair in a log, before and after.

    Raises
    ------
    EstimateError
        The record is too short for them.
    """
    frequency, densities = log.densities(matching)
    return PairDrawing(frequency, densities, log.frequency, "Hz" if log.timed else "1/row")


def _triples(pairs: tuple[str, ...], orthogonals: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """Return the columns of each pair and its orthogonal."""
    if len(pairs) != len(orthogonals):
        raise UsageError(f"{len(pairs)} --pair and {len(orthogonals)} --orthogonal: each pair needs one orthogonal")
    found = []
    for text, orthogonal in zip(pairs, orthogonals, strict=True):
        names = [name.strip() for name in text.split(",")]
        if len(names) != 2 or not all(names):
            raise UsageError(f"--pair {text!r} is not a pair; write two columns, such as a1,a2")
        found.append((names[0], names[1], orthogonal))
    return found


def _as_data(matching: Matching) -> dict[str, Any]:
    return {
        "p": matching.p,
        "q": matching.q,
        "u_p": matching.u_p,
        "u_q": matching.u_q,
        "suppression": matching.suppression,
        "components": {
            stage: {name: [component.sin, component.cos] for name, component in row.items()}
            for stage, row in matching.components.items()
        },
    }
