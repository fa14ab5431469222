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
        ctrl_c = _CtrlC()
        _prepare_libraries()
        code = _run(args, ctrl_c)
    except KeyboardInterrupt:
        code = _interrupted()
    # Without waiting for the engine's threads: one that asks for the interpreter while it shuts down aborts.
    os._exit(code)


def _prepare_libraries() -> None:
    """State in the environment what libraries read there when they are imported, so that none fails on it.

    The threads of OpenBLAS wait busily, which is 60 of the 160 ms that the import of numpy takes, and no matrix here is
    large enough to need them. Figures are files, whatever window another program of the user draws in. An engine of 0
    threads, which polars does not start, is one of as many as there are cores. Python looks for cycles of garbage a
    hundredth as often: that took a tenth of the start of `fit`.
    """
    import gc

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ["MPLBACKEND"] = "svg"
    if os.environ.get("POLARS_MAX_THREADS") == "0":
        del os.environ["POLARS_MAX_THREADS"]
    gc.set_threshold(70_000)


class _CtrlC:
    """Ctrl-C, which is not lost in a library.

    It is remembered, because a library that it meets in a callback or an import may end in an error of its own. Where
    it meets a finaliser or a weak reference, after which Python goes on, it comes again.
    """

    came = False

    def __init__(self) -> None:
        from signal import SIGINT, default_int_handler, getsignal, signal

        if getsignal(SIGINT) is default_int_handler:
            signal(SIGINT, self._raise)
        if sys.platform != "win32":
            from signal import SIGALRM

            signal(SIGALRM, self._raise)
        sys.unraisablehook = self._raise_again

    def _raise(self, *_: object) -> None:
        self.came = True
        raise KeyboardInterrupt

    def _raise_again(self, dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt) and sys.platform != "win32":
            from signal import ITIMER_REAL, setitimer

            setitimer(ITIMER_REAL, _AGAIN)
        elif "TILTCAL_TRACEBACK" in os.environ:  # else what a library fails on while it cleans up helps nobody
            sys.__unraisablehook__(dropped)


def _run(args: list[str], ctrl_c: _CtrlC) -> int:
    """Run a command, and return its exit code when all that it printed is out."""
    try:
        from tiltcal.cli.main import flushed, run
        from tiltcal.cli.talk import ForeignLibrary
        from tiltcal.logs.foreign_library import foreign_library

        foreign_library.set(ForeignLibrary())
        code = run(args)
        _ignore_ctrl_c()
    except BaseException as failure:
        if ctrl_c.came or isinstance(failure, KeyboardInterrupt):
            return _interrupted()
        from tiltcal.cli.main import flushed
        from tiltcal.cli.talk import end_unforeseen

        code = end_unforeseen(failure, args)
    return flushed(code)


def _interrupted() -> int:
    _ignore_ctrl_c()
    from tiltcal.cli.talk import talk
    from tiltcal.errors import INTERRUPTED

    talk("tiltcal: interrupted")
    return INTERRUPTED


def _ignore_ctrl_c() -> None:
    """Let no further Ctrl-C interrupt the way out."""
    from signal import SIG_IGN, SIGINT, signal

    signal(SIGINT, SIG_IGN)


if __name__ == "__main__":
    main()
