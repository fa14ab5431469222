"""Who may use a device node, and how to become one of them."""

from __future__ import annotations

import os


def no_permission(device: str, subsystem: str) -> str:
    """What to say where the operating system lets this user have no hand on a device node.

    Parameters
    ----------
    device : str
        The node, such as ``/dev/spidev0.0``.
    subsystem : str
        What udev calls its kind, such as ``spidev``; the usual group is named so but for a trailing ``dev``.
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
