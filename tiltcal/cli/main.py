"""The ``tiltcal`` command. Each subcommand is a module that is imported only when it is called."""

from __future__ import annotations

import errno
import sys
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING

import click

from tiltcal import __version__
from tiltcal.cli.talk import in_options, talk, versions
from tiltcal.errors import INTERRUPTED, TiltcalError, UsageError
from tiltcal.printable import printable

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

GROUPS = {
    "Commands of the bench": {
        "devices": "list the sensor models, or show one",
        "procedures": "list the procedures, or show one",
        "probe": "say what is in a log, or test the connection of a sensor",
        "plan": "predict the uncertainty that a procedure gives",
        "measure": "measure the positions of a procedure and write the calibration file",
        "verify": "compare a calibration with positions that it was not fitted to",
        "live": "show the calibrated tilt of a sensor as it is now",
        "record": "record the readings of a sensor or a bench",
    },
    "Commands for logs": {
        "fit": "calibrate from a recorded log",
        "apply": "convert a log of readings to compensated tilt",
        "noise": "characterise the noise of a sensor and recommend a number of samples",
        "match": "match accelerometer pairs on a rotary stage",
    },
    "Commands for files": {
        "show": "print the coefficients of a calibration",
        "report": "write an HTML page about a calibration",
        "export": "write a calibration as other programs hold it",
        "combine": "combine calibrations of one sensor from several sessions",
        "diff": "compare two calibrations of one sensor",
        "history": "show the calibrations of a folder: dates, changes, what is due, outliers",
        "check": "check any tiltcal file",
        "replay": "repeat a recorded session without hardware",
        "config": "show the defaults that a tiltcal.toml states",
        "demo": "measure, calibrate, apply and report on the virtual bench",
    },
}
COMMANDS = {name: line for commands in GROUPS.values() for name, line in commands.items()}
"""Every command with its one line of help, so that ``tiltcal --help`` imports none of them."""

_WAYS = """\
Begin with
  a sensor on a port   tiltcal probe --address serial:///dev/ttyUSB0
  a recorded log       tiltcal probe LOG.csv
  neither              tiltcal demo demo
"""


class Commands(click.Group):
    """A group that lists its commands by name and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"tiltcal.cli.{cmd_name}").command
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        found = [CompletionItem(name, help=line) for name, line in COMMANDS.items() if name.startswith(incomplete)]
        return [*found, *click.Command.shell_complete(self, ctx, incomplete)]

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            from difflib import get_close_matches

            near = get_close_matches(name, COMMANDS, n=1)
            ctx.fail(f"no such command {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(list(commands.items()))


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: tiltcal measure plane --sensor sca100t-d02 --address spi:///dev/spidev0.0 --serial S-0042 "
    "-o S-0042.yaml",
)
@click.option("--version", is_flag=True, help="Print the version; with --verbose also those of what tiltcal uses.")
@click.option("--verbose", is_flag=True, help="With --version.")
@click.pass_context
def group(ctx: click.Context, version: bool, verbose: bool) -> None:
    """Calibrate tilt sensors at the bench, and remove their errors from recorded logs."""
    if verbose and not version:
        raise click.UsageError("--verbose goes with --version", ctx)
    if version:
        click.echo("\n".join(versions()) if verbose else f"tiltcal, version {__version__}")
        ctx.exit()
    if ctx.invoked_subcommand is None:
        click.echo(f"{_WAYS}\n{ctx.get_help()}")
        ctx.exit(UsageError.exit_code)


def run(args: list[str] | None = None) -> int:
    """Run the command line, and return its exit code.

    0 done; 1 done with a negative verdict; 2 wrong usage or bad input; 3 hardware or bus error; 130 interrupted.
    """
    args = sys.argv[1:] if args is None else args
    try:
        result = group.main(args=args, prog_name="tiltcal", standalone_mode=False)
        return flushed(result if isinstance(result, int) else 0)
    except click.ClickException as error:
        with suppress(OSError):
            error.show()
        return error.exit_code
    except TiltcalError as error:
        # The message may quote a file.
        talk(f"tiltcal: {printable(in_options(error, group.get_command(click.Context(group), args[0])))}")
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        talk("tiltcal: interrupted")
        return INTERRUPTED
    except (BrokenPipeError, SystemExit):
        # The reader of our output has ended, as with `| head`, and click leaves; Python must not flush what remains.
        sys.stdout = None
        return 0
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise
        return _unwritten(error)


def flushed(code: int) -> int:
    """Have all output written, and return the exit code; where it cannot be written, the command has failed."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        sys.stdout = None
    except OSError as error:
        return code or _unwritten(error)
    return code


def _unwritten(error: OSError) -> int:
    sys.stdout = None
    talk(f"tiltcal: the output cannot be written: {error.strerror}")
    return UsageError.exit_code
