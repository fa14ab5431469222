"""``tiltcal replay``: repeat a recorded session without hardware."""

from __future__ import annotations

import os
from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.errors import NEGATIVE_VERDICT, UsageError, WrongPositions
from tiltcal.files.atomic import require_apart, whole_file
from tiltcal.journal.calibrations import calibrations_of, interrupted
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import read_journal
from tiltcal.journal.outputs import SessionFiles
from tiltcal.journal.playback import Playback, RecordedSample
from tiltcal.journal.samples import write_samples


@options.command(epilog="Example: tiltcal replay S-0042.journal.jsonl --golden S-0042.yaml")
@click.argument("journal", type=click.Path(path_type=Path))
@options.file_option(
    "-o", "--output", help="The calibration file to write [standard output]; for several sensors a folder."
)
@click.option(
    "--golden",
    type=click.Path(path_type=Path, exists=True),
    help="Compare with this calibration file or folder, byte for byte; exit code 1 if they differ.",
)
@options.file_option(
    "--samples",
    metavar="LOG",
    help="Write every sample of the session as a CSV log, including settling and refused ones.",
)
def command(journal: Path, output: Path | None, golden: Path | None, samples: Path | None) -> int:
    """Repeat a recorded session without hardware, and make the same calibration file, byte for byte.

    A verification makes no file: `tiltcal verify CAL --resume JOURNAL` repeats its verdict.
    """
    captured = read_journal(journal)
    if captured.torn:
        remark(f"{journal}: the last line was torn off and is dropped")
    setup = Setup.of(captured)
    files = SessionFiles(setup, journal, output)
    if captured.end is None:
        try:
            calibrations_of(captured)
        except WrongPositions as wrong:
            remark(f"{journal}: {wrong}; continue it with: {setup.resume_command(journal)}")
            return NEGATIVE_VERDICT
        raise interrupted(captured)
    if setup.verifies and (output or golden) is not None:
        raise UsageError(f"{journal} is of a verification, which makes no calibration file: leave -o and --golden out")
    if output is not None:
        files.require_writable(captured)
    if samples is not None:
        require_apart(samples, journal)
        with whole_file(samples) as stream:
            write_samples(stream, setup, (item for item in Playback(captured) if isinstance(item, RecordedSample)))
    made = calibrations_of(captured).texts()
    texts = {files.outputs[serial]: text for serial, text in made.items()}
    if golden is not None and not _gives(journal, texts, golden):
        return NEGATIVE_VERDICT
    if output is not None:
        for path in files.write(made, remark):
            remark(f"wrote {path}")
    elif setup.verifies:
        remark(f"{journal} is replayed; for its verdict: tiltcal verify CAL --resume {journal}")
    elif golden is None:
        click.echo("---\n".join(texts.values()), nl=False)
    return 0


def _gives(journal: Path, texts: Mapping[Path, str], golden: Path) -> bool:
    """Compare calibration files with golden ones; remark the first difference, or each file that is equal."""
    for path, text in zip(_targets(golden, list(texts)), texts.values(), strict=True):
        expected, made = path.read_bytes() if os.path.isfile(path) else b"", text.encode()
        if expected != made:
            lines = zip_longest(expected.decode(errors="replace").split("\n"), text.split("\n"), fillvalue="")
            number, differ = next(pair for pair in enumerate(lines, start=1) if len({*pair[1]}) > 1)
            remark(f"{journal} does not give {path}: line {number} differs\n- {differ[0]}\n+ {differ[1]}")
            return False
        remark(f"{journal} gives {path} to the byte")
    return True


def _targets(named: Path, outputs: list[Path]) -> list[Path]:
    """Return the files of one name: itself, or one per sensor in that folder."""
    if os.path.isdir(named):
        return [named / path.name for path in outputs]
    if len(outputs) > 1:
        raise UsageError(f"the session was of {len(outputs)} sensors: name a folder instead of {named}")
    return [named]
