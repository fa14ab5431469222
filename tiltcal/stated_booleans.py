"""Arguments that are true or false: the text ``"no"`` would count as true, so that nothing else is taken."""

from __future__ import annotations

from tiltcal.errors import UsageError
from tiltcal.stated_numbers import of_python


def require_boolean(option: str, value: object) -> None:
    """Refuse a value that is no boolean of Python or numpy, with a UsageError."""
    if not isinstance(of_python(value), bool):
        raise UsageError(f"{option} takes True or False, not {value!r}")
