"""``tiltcal replay``"""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.bench.operators.sim import SimOperator
from tiltcal.bench.session import Plan, Session
from tiltcal.errors import JournalError, UsageError
from tiltcal.files.journal import read_journal
from tiltcal.files.whole import check_writable, write_whole

JUDGED_FAILING = 1


@click.command(epilog="Example: tiltcal replay S-0042.journal.jsonl --golden S-0042.yaml")
@click.argument("journal", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Where to write the calibration file [standard output]."
)
@click.option(
    "--golden",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Compare with this calibration file, byte for byte; exit code 1 where they differ.",
)
def command(journal: Path, output: Path | None, golden: Path | None) -> int:
    """Run a captured session again, without hardware, and make its calibration file, identical to the byte."""
    if output is not None:
        check_writable(output)
    captured = read_journal(journal)
    if captured.torn:
        click.echo(f"{journal}: the last line was torn off and is dropped", err=True)
    if captured.end is None:
        raise JournalError(
            f"the session was interrupted; go on with it: tiltcal measure --resume {journal}",
            file=journal,
            line=len(captured.events) + 2,
        )
    session = Session(Plan.from_journal(captured), journal, captured)
    texts = session.replay(SimOperator(lambda line: None))
    if len(texts) != 1:
        raise UsageError(f"{journal} is of {len(texts)} sensors")
    if golden is not None:
        if texts[0].encode() != golden.read_bytes():
            click.echo(f"{journal} does not give {golden}", err=True)
            return JUDGED_FAILING
        click.echo(f"{journal} gives {golden} to the byte", err=True)
    if output is not None:
        write_whole(output, texts[0])
        click.echo(f"wrote {output}", err=True)
    elif golden is None:
        click.echo(texts[0], nl=False)
    return 0
