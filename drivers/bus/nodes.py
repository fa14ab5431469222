"""What the buses of an operating system share: their Python packages, and the errors of their device nodes."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from tiltcal.errors import HardwareError


def import_library(module: str, needed: str, install: str) -> Any:
    """Import a module of a package that one bus needs.

    needed: what needs which package, for the message: ``SPI needs the Python package spidev, for Linux only``.
    install: what pip installs.

    HardwareError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as cause:
        raise HardwareError(f"{needed}: install it with  pip install {install}") from cause


def no_permission(device: str, subsystem: str) -> str:
    """Return the message for a device node that this user may not open.

    device: the node, such as ``/dev/spidev0.0``.
    subsystem: its name in udev, such as ``spidev``; the usual group has this name without a trailing ``dev``.
    """
    import grp

    try:
        group = grp.getgrgid(os.stat(device).st_gid).gr_name
    except (KeyError, OSError):
        return f"no permission to use {device}: ask the owner of this machine for it"
    if group == "root":
        usual = subsystem.removesuffix("dev").removesuffix("-")
        return (
            f"no permission to use {device}, which belongs to root alone: give it to a group with the udev rule  "
            f'SUBSYSTEM=="{subsystem}", GROUP="{usual}", MODE="0660"  and join that group'
        )
    return (
        f"no permission to use {device}, which belongs to group {group}: add yourself to group {group} with  "
        f"sudo usermod -aG {group} $USER  and log in again"
    )


def no_serial_port(place: str) -> str:
    """Return the message for a serial port that does not exist."""
    return missing_node(place, ("ttyUSB*", "ttyACM*"), "no USB serial port is present; is the cable plugged in?")


def missing_node(device: str, patterns: Sequence[str], otherwise: str) -> str:
    """Return the message for a device node that does not exist, with those of its kind that do.

    patterns: the names of such nodes in ``/dev``, such as ``spidev*``.
    otherwise: what the message says if there is no such node.
    """
    present = ", ".join(sorted(str(path) for pattern in patterns for path in Path("/dev").glob(pattern)))
    return f"{device} does not exist ({f'present: {present}' if present else otherwise})"


def node_error(device: str, cause: OSError, bus: str, *, subsystem: str, pattern: str, example: str) -> str | None:
    """Return the message for an error that every bus node has in common; None for another error.

    device: the node, such as ``/dev/spidev0.0``.
    cause: what the operating system reported.
    bus: the bus with its article, such as ``an SPI device``.
    subsystem: its name in udev, for :func:`no_permission`.
    pattern: the names of such nodes in ``/dev``, such as ``spidev*``.
    example: a node of this kind.
    """
    name = bus.split()[1]
    if cause.errno == errno.ENOENT:
        kind = bus.partition(" ")[2]
        return missing_node(device, [pattern], f"no {kind} is present; switch {name} on in the board's settings")
    if cause.errno in (errno.EACCES, errno.EPERM):
        return no_permission(device, subsystem)
    if cause.errno in (errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN):
        return f"{device} is gone: plug the {name} adapter in again, then resume"
    if cause.errno in (errno.ENOTTY, errno.EINVAL):
        return f"{device} refuses an {name} request ({os.strerror(cause.errno)}): is it {bus}, as {example} is?"
    return None
