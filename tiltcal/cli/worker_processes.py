"""Processes that work through the tasks of a command, and end with it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process

_PATIENCE = 1.0  # seconds in which the processes must leave


@contextmanager
def worker_processes(number: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes, whose tasks are ended and dropped where the block raises.

    They share the processor's cores: each has its part of the engine's threads. Ctrl-C is left to this process.
    """
    threads = max(processor_cores() // number, 1)
    # A fork would copy the threads' locks of the libraries that this process has loaded.
    pool = ProcessPoolExecutor(number, get_context("spawn"), _begin, (threads,))
    try:
        yield pool
    except BaseException:
        _end()
        # Waits for the thread of the pool, whose semaphores would otherwise be left to the system, with a warning.
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def processor_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _begin(threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["POLARS_MAX_THREADS"] = str(threads)
    threading.Thread(target=_end_with_the_command, daemon=True).start()


def _end_with_the_command() -> None:
    """End this process when the one that started it has ended, however that came."""
    command = parent_process()
    if command is not None:
        command.join()
        os._exit(1)


def _end() -> None:
    """End all processes; what they were writing has no name yet."""
    latest = time.monotonic() + _PATIENCE
    for process in active_children():
        process.terminate()
    for process in active_children():
        process.join(max(latest - time.monotonic(), 0.0))
        process.kill()
