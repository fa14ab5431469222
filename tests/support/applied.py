"""The command ``apply`` on a two-axis sensor of 2 V/g: its result, its rows, and how it refuses."""

import csv
from math import nan

from click.testing import CliRunner, Result

from tiltcal.cli.apply import command
from tiltcal.cli.talk import in_options
from tiltcal.errors import TiltcalError

PLAIN = """\
tiltcal: 1
kind: tilt
sensor: {model: bench-built, serial: S-1, unit: V, channels: [x, y]}
calibration:
  offset: {x: 2.5, y: 2.5}
  sensitivity: {x: {x: 2.0, y: 0.0}, y: {x: 0.0, y: 2.0}}
"""
"""A calibration file."""


def apply(*arguments: str, stdin: bytes | str | None = None) -> Result:
    """Call the command; an exception that is not ours leaves this function as it is."""
    result = CliRunner().invoke(command, list(arguments), input=stdin)
    if result.exception is not None and not isinstance(result.exception, TiltcalError):
        raise result.exception
    return result


def refused(result: Result, kind: type[TiltcalError]) -> str:
    """Return why a command of one's own refused, which prints no row then."""
    assert isinstance(result.exception, kind), (result.exception, result.output)
    assert result.exception.exit_code == 2
    assert result.stdout == ""
    return in_options(result.exception, command)


def rows(text: str) -> list[dict[str, float]]:
    """Return the rows of a CSV log of numbers; an empty cell is NaN."""
    return [{name: float(cell or nan) for name, cell in row.items()} for row in csv.DictReader(text.splitlines())]
