"""What a terminal shows while a command runs, and how a command ends where its streams or the system fail."""

import errno
import io
import signal
from collections.abc import Callable, Mapping
from contextlib import nullcontext, redirect_stderr
from pathlib import Path
from typing import Any

import pytest
from support import FIXTURES
from support.command import called, tiltcal

from tiltcal.bench.live import LiveTilt
from tiltcal.cli.main import run
from tiltcal.cli.talk import ForeignLibrary, progress_bar, wrapped
from tiltcal.errors import BusError

CLEAR = "\r\x1b[2K"


class Terminal(io.StringIO):
    """A stream of a terminal."""

    def isatty(self) -> bool:
        return True


class Clock:
    """A clock that goes on where somebody sleeps, or by a step at each look."""

    def __init__(self, step: float = 0.0) -> None:
        self.now, self._step, self.slept = 100.0, step, []  # type: ignore[var-annotated]

    def monotonic(self) -> float:
        self.now += self._step
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(round(seconds, 9))
        self.now += seconds


TILT = LiveTilt({"tilt_x": 1.0, "tilt_y": -2.0}, {}, None, 1, 0)
FAILS = BusError("no answer")
GAP, LINES = "no reading: no answer\n", "S-1   tilt x +1.00°   tilt y -2.00°"


@pytest.mark.parametrize(
    ("terminal", "options", "script", "code", "out", "err", "slept"),
    [
        # A reading takes 0.1 s, every 0.25 s is one due; a late one is not caught up.
        (False, "", [TILT, 0.9, FAILS, TILT], 0, f"{LINES}\n{LINES}\n", GAP, [0.15, 0, 0.15]),
        (False, "--rate 2", [TILT], 0, f"{LINES}\n", "", [0.4]),
        (False, "--for 9", [TILT], 130, f"{LINES}\n", "", [0.15]),
        (False, "--for 0.6", [TILT] * 9, 0, f"{LINES}\n" * 3, "", [0.15] * 3),
        (False, "", [FAILS, *[FAILS] * 9], 3, "", GAP * 4 + "tiltcal: no answer\n", [0.15] * 4),
        (False, "", [*[FAILS] * 4, TILT, FAILS], 0, f"{LINES}\n", GAP * 5, [0.15] * 6),
        (True, "", [TILT, FAILS, TILT], 0, f"{CLEAR}{LINES}{CLEAR}{LINES}\n", f"{CLEAR}{GAP}", [0.15] * 3),
    ],
)  # fmt: skip
def test_live_shows_each_reading_and_goes_on_after_one_that_fails(
    terminal: bool, options: str, script: list[Any], code: int, out: str, err: str, slept: list[float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A number in the script is a delay; behind its end comes Ctrl-C."""
    clock, steps = Clock(), iter(script)

    def read() -> Mapping[str, LiveTilt]:
        clock.now += 0.1
        step = next(steps, KeyboardInterrupt())
        if isinstance(step, float):
            clock.now += step
            step = next(steps)
        if isinstance(step, BaseException):
            raise step
        return {"SIM-42": step}

    monkeypatch.setattr("tiltcal.bench.live.live_tilts", lambda *_: nullcontext(read))
    monkeypatch.setattr("tiltcal.cli.live.time", clock)
    monkeypatch.setenv("COLUMNS", "42")
    stdout, stderr = Terminal() if terminal else io.StringIO(), io.StringIO()
    words = ("live", FIXTURES / "plane.yaml", "--address", "sim:", *options.split())
    assert called(words, None, io.StringIO(), stdout, stderr) == code
    said = (stdout.getvalue().replace("SIM-42", "S-1"), stderr.getvalue(), clock.slept)
    assert said == (out, err, pytest.approx(slept))


def test_on_a_narrow_terminal_live_shows_what_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.bench.live.live_tilts", lambda *_: nullcontext(lambda: {"SIM-42": TILT}))
    monkeypatch.setattr("tiltcal.cli.live.time", Clock())
    words = ("live", FIXTURES / "plane.yaml", "--address", "sim:", "--for", "0.2")
    for columns, shown in (("39", "   tilt x +1.00°   tilt y -2.00°"), ("38", "   tilt x +1.00°")):
        monkeypatch.setenv("COLUMNS", columns)
        stdout = Terminal()
        assert called(words, None, io.StringIO(), stdout, io.StringIO()) == 0
        assert stdout.getvalue() == f"{CLEAR}SIM-42{shown}\n"


def test_a_recording_shows_its_rows_four_times_a_second_and_clears_the_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiltcal.cli.record.time", Clock(step=0.125))
    stderr = Terminal()
    words = ("record", "--sensor", "sca100t-d02", "--address", "sim:", "--rows", "5", "-o", "log.csv")
    assert called(words, tmp_path, io.StringIO(), io.StringIO(), stderr) == 0
    lines = "".join(f"{CLEAR}{row} rows   Ctrl-C stops" for row in (1, 3, 5))
    assert stderr.getvalue() == f"{lines}{CLEAR}5 rows in log.csv\n"


def test_a_bar_shows_the_share_of_a_log_of_known_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    for size, shown in ((200, True), (None, False)):
        with redirect_stderr(Terminal()) as stderr, progress_bar("apply") as progress:
            assert progress is not None
            progress(50, size)
        said = stderr.getvalue()
        assert ("25%" in said, "apply" in said, "\x1b[?25l" in said) == (shown, shown, False)
    with redirect_stderr(io.StringIO()), progress_bar("apply") as progress:
        assert progress is None


def test_remarks_break_between_words_at_the_width_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    text = "S-7: state the lean of a table (--table-lean), or measure again\n  a line that fits stays  as it is -----\n"
    lines = ["S-7: state the lean of a table", "    (--table-lean), or measure again", text.splitlines()[1], "a" * 50]
    assert wrapped(f"{text}{'a' * 50}").split("\n") == lines
    stderr = Terminal()
    assert called(("procedures", "plain"), None, io.StringIO(), io.StringIO(), stderr) == 2  # an error is as it is
    assert stderr.getvalue().count("\n") == 1


def test_a_library_that_reads_a_log_is_announced_once_and_left_to_ctrl_c(capsys: pytest.CaptureFixture[str]) -> None:
    library, before = ForeignLibrary(), signal.getsignal(signal.SIGINT)
    for log, inside in (("a\x1b.nc", signal.SIG_DFL), ("a\x1b.nc", signal.SIG_DFL), ("b.nc", signal.SIG_IGN)):
        if inside is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        with library(log):
            assert signal.getsignal(signal.SIGINT) is inside
        assert signal.getsignal(signal.SIGINT) is (before if inside is signal.SIG_DFL else inside)
    signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "reading a?.nc\nreading b.nc\n"


def raising(error: BaseException) -> Callable[..., None]:
    def fail(*_words: Any, **_options: Any) -> None:
        raise error

    return fail


FULL = "tiltcal: the output cannot be written: full\n"
ENDS = [(KeyboardInterrupt(), 130, "\ntiltcal: interrupted\n"), (BrokenPipeError(), 0, ""), (SystemExit(), 0, "")]
ENDS += [(OSError(number, "full"), 2, FULL) for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)]


@pytest.mark.parametrize(("error", "code", "said"), ENDS)
def test_a_command_ends_with_a_code_and_a_message(
    error: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiltcal.cli.procedures.find_procedure", raising(error))
    assert tiltcal("procedures", code=code).stderr == said
    monkeypatch.setattr("tiltcal.cli.procedures.find_procedure", raising(OSError(errno.EACCES, "denied")))
    with pytest.raises(OSError, match="denied"):
        tiltcal("procedures")


def test_output_that_cannot_be_flushed_fails_a_command_and_changes_no_verdict() -> None:
    for error, code, said in ((OSError(errno.ENOSPC, "full"), 2, FULL), (BrokenPipeError(), 0, "")):
        for words, verdict in ((("procedures",), code), (("diff", "plane.yaml", "free.yaml"), 2)):
            stdout, stderr = io.StringIO(), io.StringIO()
            stdout.flush = raising(error)  # type: ignore[method-assign]
            assert called(words, FIXTURES, io.StringIO(), stdout, stderr) == verdict
            assert (stderr.getvalue() == said) is (words == ("procedures",))
    assert run(["procedures"]) == 0
