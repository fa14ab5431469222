"""``tiltcal replay``: repeat a recorded session without hardware."""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.cli.talk import in_options, remark
from tiltcal.errors import NEGATIVE_VERDICT, InputError, TiltcalError, UsageError, WrongPositions
from tiltcal.files.atomic import require_apart, whole_file
from tiltcal.journal.calibrations import calibrations_of, texts_of
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import Journal
from tiltcal.journal.outputs import SessionFiles
from tiltcal.journal.samples import samples_into
from tiltcal.journal.session import RecordedSession
from tiltcal.library.replay import Replay, journals_in, replay, surplus


@options.command(epilog="Example: tiltcal replay journals --golden journals")
@click.argument("journals", metavar="JOURNAL...", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.file_option(
    "-o", "--output", help="The calibration file to write [standard output]; for several sensors a folder."
)
@click.option(
    "--golden",
    type=click.Path(path_type=Path, exists=True),
    help="Compare with this calibration file, or with those of a folder, byte for byte; exit code 1 if they differ.",
)
@options.file_option(
    "--samples",
    metavar="LOG",
    help="Write every sample of the session as a CSV log, including settling and refused ones.",
)
def command(journals: tuple[Path, ...], output: Path | None, golden: Path | None, samples: Path | None) -> int:
    """Repeat recorded sessions without hardware, and make the same calibration files, byte for byte.

    JOURNAL may be a folder: all journals in it and below. Of several, each file name that a journal gives must be in
    the folder --golden, and no other calibration may be there. A verification makes no file: `tiltcal verify CAL
    --resume JOURNAL` repeats its verdict.
    """
    several = len(journals) > 1 or journals[0].is_dir()
    if several:
        if output is not None or samples is not None or (golden is not None and not golden.is_dir()):
            raise UsageError("several journals are compared with a folder, --golden DIR: leave -o and --samples out")
        return _compared(journals_in(journals), golden)
    (journal,) = journals
    captured = Journal(journal)
    setup = Setup.of(captured)
    files = SessionFiles(setup, journal, output)
    if setup.verifies and (output or golden) is not None:
        raise UsageError(f"{journal} is of a verification, which makes no calibration file: leave -o and --golden out")
    if samples is None:
        recorded = RecordedSession(captured, setup)
    else:
        require_apart(samples, journal)
        with whole_file(samples) as stream:
            recorded = RecordedSession(captured, setup, samples_into(stream, setup))
    if captured.torn:
        remark(f"{journal}: the last line was torn off and is dropped")
    if output is not None:
        files.require_writable(recorded)
    try:
        made = texts_of(calibrations_of(recorded))
    except WrongPositions as wrong:
        if captured.ended:
            raise
        remark(f"{journal}: {wrong}; continue it with: {setup.resume_command(journal)}")
        return NEGATIVE_VERDICT
    if not captured.ended:
        remark(f"{journal}: its end line is missing, and all positions are there")
    if golden is not None:
        found = Replay(journal, {files.outputs[serial].name: text for serial, text in made.items()})
        differences = found.differences(golden)
        remark("\n".join(differences or [f"{journal} gives {golden} to the byte"]))
        if differences:
            return NEGATIVE_VERDICT
    if output is not None:
        for path in files.write(made, remark):
            remark(f"wrote {path}")
    elif setup.verifies:
        remark(f"{journal} is replayed; for its verdict: tiltcal verify CAL --resume {journal}")
    elif golden is None:
        click.echo("---\n".join(made.values()), nl=False)
    return 0


def _compared(journals: list[Path], golden: Path | None) -> int:
    """Replay journals and compare them with a folder, and print all differences and one summary."""
    replays, wrong, differences = [], 0, []
    for journal in journals:
        try:
            replays.append(replay(journal))
        except TiltcalError as error:
            remark(str(in_options(error)) if str(journal) in str(error) else f"{journal}: {in_options(error)}")
            wrong += 1
            continue
        differences += [] if golden is None else replays[-1].differences(golden)
    if golden is not None and not wrong:
        differences += surplus(golden, replays)
    for difference in differences:
        remark(difference)
    if wrong:
        raise InputError(f"{wrong} of {len(journals)} journals cannot be replayed")
    compared = "" if golden is None else f", {len(differences) or 'no'} calibration files differ from those in {golden}"
    options.print_judged(f"{len(journals)} journals are replayed{compared}")
    return NEGATIVE_VERDICT if differences else 0
