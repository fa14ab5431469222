"""How a package that is missing is added to an installation of pip, pipx, uv or uvx."""

from __future__ import annotations

import sys
from pathlib import Path


def how_to_add(package: str) -> str:
    """Return the command that adds a package, or tiltcal itself with an extra, such as ``tiltcal[report]``."""
    places, own = Path(sys.prefix).parts, package.startswith("tiltcal[")
    named = f"'{package}'" if own else package
    if "pipx" in places or Path(sys.prefix, "pipx_metadata.json").exists():  # PIPX_HOME may be anywhere
        return f"pipx install --force {named}" if own else f"pipx inject tiltcal {named}"
    if "uv" in places and "tools" in places:
        return f"uv tool install {named}" if own else f"uv tool install tiltcal --with {named}"
    if any(part.startswith("archive-v") for part in places):  # where uvx keeps what it runs
        return f"uvx --from {named} tiltcal ..." if own else f"uvx --with {named} tiltcal ..."
    return f"pip install {named}"
