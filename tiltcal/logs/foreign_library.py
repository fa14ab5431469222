"""Libraries of C that read a log, and that a damaged one may keep busy, or end with the process."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar

foreign_library: ContextVar[Callable[[str], AbstractContextManager[object]]] = ContextVar("", default=nullcontext)
"""What the command puts around the reading of a log by such a library; nothing in the library and in other threads.

It is entered when polars is imported, which then takes SIGINT for itself.
"""
