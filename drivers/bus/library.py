"""The Python packages behind the buses: each is imported when an address names its bus."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from tiltcal.errors import HardwareError


def import_library(module: str, needed: str, install: str) -> Any:
    """Import a module of a package that one bus needs.

    Parameters
    ----------
    needed : str
        What needs which package, for the message: ``SPI needs the Python package spidev, for Linux only``.
    install : str
        What pip installs.

    HardwareError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as cause:
        raise HardwareError(f"{needed}: install it with  pip install {install}") from cause
