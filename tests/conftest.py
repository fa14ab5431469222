"""What holds for every test."""

import os

# Workers run beside each other, so each one's linear algebra keeps to one thread; it must be said before numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# An error that nothing foresees fails a test as Python prints it.
os.environ.setdefault("TILTCAL_TRACEBACK", "1")

import atexit
import gc
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

pytest.register_assert_rewrite("support")

from hypothesis import settings
from support import html_page
from support.warm_start import WarmStart, warm_start

# The same examples on every run, so that a change is judged and not the draw; HYPOTHESIS_PROFILE=explore draws more,
# and anew.
settings.register_profile("repeatable", max_examples=40, derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# A run in the background of a shell ignores Ctrl-C, and every program that it starts inherits that; tests send Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

PROCESS = "/proc/self"
KEPT = r"\.ttf$|^anon_inode:\[event"
"""Where descriptors lead that a library keeps for the whole run."""

SHORTLY = 5.0
"""Seconds in which a thread that has been told to end has to end."""


# Tokens of pages and defaults lie in folders of the user; a session that a test stops leaves a token there.
_runtime = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
atexit.register(_runtime.cleanup)
os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_CONFIG_HOME"] = _runtime.name


gc.disable()  # while the tests are collected, which makes a million objects that stay


def pytest_collection_finish() -> None:
    """Leave what stays for the whole run out of every collection of garbage; collect seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 50)
    gc.enable()


@pytest.fixture(autouse=True)
def nothing_is_left_behind() -> Iterator[None]:
    """Fail a test that leaves a thread, a child process or an open file behind; a lock on a file is held by one.

    What a module imports or keeps for the whole run is made in a fixture of the module's or the run's scope, which is
    there before the test. Not counted are the threads and the event descriptors of the polars engine, and fonts that
    matplotlib keeps open.
    """
    if sys.platform != "linux":
        yield
        return
    threads, children, files = set(threading.enumerate()), _children(), _open_files()
    yield
    for thread in _new_threads(threads):
        thread.join(SHORTLY)
    if _open_files().keys() - files.keys():
        gc.collect()  # what a cycle of references holds is not left behind, it is only not collected yet
    left = {
        "threads": sorted(thread.name for thread in _new_threads(threads)),
        "processes": sorted(_children() - children),
        "files": sorted(target for number, target in _open_files().items() if files.get(number) != target),
    }
    assert not any(left.values()), f"left behind: {left}"


@pytest.fixture(scope="session")
def warm() -> Iterator[WarmStart]:
    """Yield a server that forks processes of the command: what they test needs a process, but no start of Python."""
    with warm_start() as server:
        yield server


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Leave the figures of a page empty where a test reads its words: to draw them takes most of a page's time."""
    with html_page.undrawn():
        yield


@pytest.fixture
def own_modules(tmp_path: Path) -> Iterator[None]:
    """Forget the modules that a test imports from its folder: the next test has another of the same name."""
    search = list(sys.path)
    yield
    sys.path[:] = search
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "/").is_relative_to(tmp_path):
            del sys.modules[name]


def _new_threads(before: set[threading.Thread]) -> set[threading.Thread]:
    """Return the threads that Python has started since; one of a library is a dummy here from its first call on."""
    return {thread for thread in set(threading.enumerate()) - before if not isinstance(thread, threading._DummyThread)}


def _children() -> set[int]:
    """Return the numbers of the child processes of Python's threads; the main one has those of threads that ended."""
    found: set[int] = set()
    for thread in threading.enumerate():
        path = f"{PROCESS}/task/{thread.native_id}/children"
        with suppress(FileNotFoundError, ProcessLookupError), open(path) as listed:  # it may end meanwhile
            found.update(map(int, listed.read().split()))
    return found


def _open_files() -> dict[str, str]:
    """Return what each file descriptor leads to."""
    found = {}
    for number in os.listdir(f"{PROCESS}/fd"):
        with suppress(FileNotFoundError):  # the descriptor of this listing
            found[number] = os.readlink(f"{PROCESS}/fd/{number}")
    return {number: target for number, target in found.items() if not re.search(KEPT, target)}
