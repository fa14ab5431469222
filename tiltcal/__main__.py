"""``python -m tiltcal`` is the ``tiltcal`` command, and so is the installed one.

Ctrl-C ends it with exit code 130 and a message whenever it comes, while modules are imported too: all of them but this
one and those of Python are imported within :func:`main`.
"""

from __future__ import annotations

import os
import sys

_AGAIN = 1e-3  # seconds after which a Ctrl-C that was dropped comes again


def main(args: list[str] | None = None) -> None:
    """Run the command line and leave with the documented exit code."""
    args = sys.argv[1:] if args is None else args
    if sys.stderr is None:  # closed: nobody reads the remarks
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        _keep_ctrl_c()
        signals = _NotedSignals()
        _settle_libraries()
        _collect_seldom()
        code = _run(args, signals)
    except KeyboardInterrupt:
        code = _interrupted()
    # Without waiting for the engine's threads: one that asks for the interpreter while it shuts down aborts.
    os._exit(code)


def _settle_libraries() -> None:
    """State in the environment what libraries read there when they are imported, so that none fails on it.

    The threads of OpenBLAS wait busily, which is 60 of the 160 ms that the import of numpy takes, and no matrix here is
    large enough to need them. Figures are files, whatever window another program of the user draws in. An engine of 0
    threads, which polars does not start, is one of as many as there are cores.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ["MPLBACKEND"] = "svg"
    if os.environ.get("POLARS_MAX_THREADS") == "0":
        del os.environ["POLARS_MAX_THREADS"]


def _collect_seldom() -> None:
    """Let Python look for cycles of garbage a hundredth as often: that took a tenth of the start of `fit`."""
    import gc

    gc.set_threshold(70_000)


def _keep_ctrl_c() -> None:
    """Raise a Ctrl-C again that meets a finaliser or a weak reference: Python prints it there and goes on."""
    import signal

    def unraisable(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)
        else:
            sys.__unraisablehook__(dropped)

    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        sys.unraisablehook = unraisable


class _NotedSignals:
    """The signals that came, which the system writes to a pipe.

    A library that Ctrl-C meets in a callback may end in an error of its own, in which nothing is left of it.
    """

    def __init__(self) -> None:
        from signal import set_wakeup_fd

        self._noted = None
        if hasattr(os, "pipe2"):
            self._noted, written = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
            set_wakeup_fd(written, warn_on_full_buffer=False)

    def ctrl_c(self) -> bool:
        """Return whether Ctrl-C is among them."""
        from signal import SIGINT

        try:
            return self._noted is not None and SIGINT in os.read(self._noted, 1 << 16)
        except BlockingIOError:
            return False


def _run(args: list[str], signals: _NotedSignals) -> int:
    """Run a command, and return its exit code when all that it printed is out."""
    try:
        from tiltcal.cli.main import run

        code = run(args)
        _deaf()
    except BaseException as failure:
        if _comes_from_ctrl_c(failure) or signals.ctrl_c():
            return _interrupted()
        from tiltcal.cli.unforeseen import report

        code = report(failure, args)
    return _flushed(code)


def _comes_from_ctrl_c(failure: BaseException | None) -> bool:
    """Whether Ctrl-C is behind a failure: libraries that are interrupted while they are imported call it their own."""
    while failure is not None:
        if isinstance(failure, KeyboardInterrupt):
            return True
        failure = failure.__cause__ or failure.__context__
    return False


def _interrupted() -> int:
    _deaf()
    from tiltcal.cli.talk import talk
    from tiltcal.errors import INTERRUPTED

    talk("tiltcal: interrupted")
    return INTERRUPTED


def _deaf() -> None:
    """Let no further Ctrl-C interrupt the way out."""
    from signal import SIG_IGN, SIGINT, signal

    signal(SIGINT, SIG_IGN)


def _flushed(code: int) -> int:
    """Have all output written; where it cannot be, the command has failed."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        return code
    except OSError as failure:
        from tiltcal.cli.talk import talk
        from tiltcal.errors import UsageError

        talk(f"tiltcal: the output cannot be written: {failure.strerror}")
        return code or UsageError.exit_code
    return code


if __name__ == "__main__":
    main()
