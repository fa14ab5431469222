"""``tiltcal match``"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import tiltcal
from tiltcal.errors import EstimateError, InputError, Stopped, UsageError

if TYPE_CHECKING:
    from tiltcal.core.pair.matching import Matching
    from tiltcal.core.pair.model import Pair
    from tiltcal.files.pair import PairRecord
    from tiltcal.logs.log import LogReader
    from tiltcal.logs.pair_matching import Demodulated
    from tiltcal.logs.pair_observers import PairObserver, SpectrumObserver
    from tiltcal.report.pair_figures import PairDrawing

_EXAMPLES = """\b
Examples:
  tiltcal match disk.csv --pair a1,a2 --orthogonal a4 --phase theta -o disk.yaml
  tiltcal match disk.csv --pair a1,a2 --orthogonal a4 --pair a3,a4 --orthogonal a1 --phase theta -o disk.yaml
  tail -n +1 -f disk.csv | tiltcal match - --pair a1,a2 --orthogonal a4 --phase theta --online -o disk.yaml
"""


@click.command(epilog=_EXAMPLES)
@click.argument("log")
@click.option("--pair", "pairs", multiple=True, required=True, metavar="FIRST,SECOND", help="Columns of a pair.")
@click.option(
    "--orthogonal",
    "orthogonals",
    multiple=True,
    required=True,
    metavar="NAME",
    help="Column of an accelerometer a quarter turn away; one for each --pair, in order.",
)
@click.option(
    "--phase",
    metavar="NAME",
    help="Column of the stage angle, degrees. Without it the spin is estimated from the readings and the column time.",
)
@click.option(
    "--online",
    is_flag=True,
    help="Estimate sample by sample, as on a live stream, and say where the stage stops or the stream has a gap.",
)
@click.option(
    "--loops", is_flag=True, help="With --online: p and q from the two PID loops, not the recursive estimator."
)
@click.option("--skip-bad-rows", is_flag=True, help="Leave out rows that cannot be parsed, instead of stopping.")
@click.option(
    "--figure",
    type=click.Path(path_type=Path),
    metavar="SVG",
    help="Draw the spectra of the first pair before and after, and with --online how the estimators settled.",
)
@click.option("--json", "as_json", is_flag=True, help="Print an object for a program.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="PAIR.yaml", help="The pair file to write.")
def command(
    log: str,
    pairs: tuple[str, ...],
    orthogonals: tuple[str, ...],
    phase: str | None,
    online: bool,
    loops: bool,
    skip_bad_rows: bool,
    figure: Path | None,
    as_json: bool,
    output: Path | None,
) -> None:
    """Match accelerometer pairs on a turning stage: scale factor p and misalignment q.

    LOG is CSV with a header, Parquet, NetCDF-4, or - for CSV on standard input; it is read once, whatever its size. The
    sum FIRST + (SECOND + q ORTHOGONAL) / (1 - p) is free of the acceleration that all of them feel; `tiltcal apply`
    adds it to a log. Two pairs give the gradient signal as well. A column called time is in seconds or ISO 8601.

    With --online, Ctrl-C ends a stream that has no end of its own, and what was found until then is the result.
    """
    from tiltcal.calibration.pair_calibration import pair_summary
    from tiltcal.cli.progress import progress_bar
    from tiltcal.files.pair import write_pair
    from tiltcal.files.whole import check_writable
    from tiltcal.logs.formats import open_log
    from tiltcal.logs.pair_matching import demodulate_log
    from tiltcal.logs.pair_observers import PairObserver, SpectrumObserver
    from tiltcal.report.pair_figures import draw_matching

    if loops and not online:
        raise UsageError("--loops says which of the --online estimators is meant; give --online too")
    wanted = _pairs(pairs, orthogonals)
    channels = tuple(dict.fromkeys(channel for pair in wanted for channel in pair.channels))
    for path in filter(None, (output, figure)):
        check_writable(path)
    say = partial(click.echo, err=True)
    watch = PairObserver(wanted, channels, say) if online else None
    spectra = SpectrumObserver(channels) if figure else None
    with (
        progress_bar("match") as progress,
        open_log(log, skip_bad_rows=skip_bad_rows, digest=True, live=online, progress=progress) as rows,
        _explained(rows),
    ):
        observers = [observer for observer in (watch, spectra) if observer is not None]
        found = demodulate_log(rows, channels, phase, observers=observers, say=say, live=online)
        matchings = [_matched(found, pair, watch, loops) for pair in wanted]
        drawing = _drawing(spectra, found, matchings[0], watch) if spectra else None
    if found.missing:
        say(f"{found.missing} of {found.rows + found.missing} rows have a missing value and are left out")
    if output:
        write_pair(
            output, _calibration(matchings, found, phase, online, {"name": Path(rows.name).name, "sha256": rows.sha256})
        )
    if figure and drawing:
        draw_matching(figure, drawing)
    if as_json:
        shown = [_as_data(matching) for matching in matchings]
        click.echo(json.dumps(shown[0] if len(shown) == 1 else {"pairs": shown}))
    else:
        click.echo("\n\n".join(pair_summary(matching) for matching in matchings))


@contextmanager
def _explained(log: LogReader) -> Iterator[None]:
    """Put the log's name in front of why it cannot be matched, and what to do where Ctrl-C came too early."""
    try:
        yield
    except (EstimateError, InputError) as refusal:
        why = str(refusal) if isinstance(refusal, InputError) else f"{log.name}: {refusal}"
        if log.interrupted:
            raise Stopped(f"interrupted, and nothing is written: {why}; let the stream run for longer") from None
        if isinstance(refusal, EstimateError):
            raise EstimateError(why) from refusal
        raise


def _matched(found: Demodulated, pair: Pair, watch: PairObserver | None, loops: bool) -> Matching:
    """A pair, matched by the whole record or by what the online estimators ended with."""
    from tiltcal.core.pair.matching import match, matching_with

    if watch is None:
        return match(found.demodulation, pair)
    return matching_with(found.demodulation, pair, watch.coefficients(pair, loops=loops))


def _calibration(
    matchings: Sequence[Matching], found: Demodulated, phase: str | None, online: bool, log: Mapping[str, str]
) -> PairRecord:
    from tiltcal.files.pair import PairRecord
    from tiltcal.files.records import LogRecord, PairProvenance

    provenance = PairProvenance(
        made_by="match of a recorded log",
        software=f"tiltcal {tiltcal.__version__}",
        log=LogRecord(**log, rows=found.rows + found.missing, missing=found.missing),
        stage_angle=None if found.spin is None else "estimated from the readings",
    )
    return PairRecord(tuple(matchings), phase, found.turns, found.frequency, online, provenance)


def _drawing(
    spectra: SpectrumObserver, found: Demodulated, matching: Matching, watch: PairObserver | None
) -> PairDrawing:
    from tiltcal.report.pair_figures import PairDrawing

    frequency, densities = spectra.densities(matching.pair, matching.p, matching.q, found)
    return PairDrawing(
        frequency,
        densities,
        found.frequency or found.turns / (found.rows + found.missing),
        "Hz" if found.rate else "1/row",
        watch.course(matching.pair) if watch else (),
        max(matching.u_p, matching.u_q),
    )


def _pairs(pairs: tuple[str, ...], orthogonals: tuple[str, ...]) -> list[Pair]:
    from tiltcal.core.pair.model import Pair

    if len(pairs) != len(orthogonals):
        raise UsageError(f"{len(pairs)} --pair and {len(orthogonals)} --orthogonal: each pair needs one orthogonal")
    if len(pairs) > 2:
        raise UsageError("at most two pairs are matched at once: those of one disk")
    found = []
    for text, orthogonal in zip(pairs, orthogonals, strict=True):
        names = [name.strip() for name in text.split(",")]
        if len(names) != 2 or not all(names):
            raise UsageError(f"--pair {text!r} is no pair; write two columns, such as a1,a2")
        if len({*names, orthogonal}) < 3:
            raise UsageError(f"--pair {text} --orthogonal {orthogonal}: these are to be three different columns")
        found.append(Pair(names[0], names[1], orthogonal))
    if len({pair.name for pair in found}) < len(found):
        raise UsageError(f"--pair {pairs[0]} is given twice")
    return found


def _as_data(matching: Matching) -> dict[str, Any]:
    return {
        "p": matching.p,
        "q": matching.q,
        "u_p": matching.u_p,
        "u_q": matching.u_q,
        "suppression": matching.suppression,
        "components": {
            stage: {name: [one.sin, one.cos] for name, one in row.items()} for stage, row in matching.components.items()
        },
    }
