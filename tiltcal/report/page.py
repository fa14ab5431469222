"""The HTML of a page: one file, with its style and figures inside."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from tiltcal.errors import UsageError

if TYPE_CHECKING:
    from jinja2 import Environment

KEPT = 16
"""Largest number of rows of a table that is kept on one page."""


def require_extra() -> None:
    """Check that the libraries of a report are installed, before anything is read.

    UsageError: one is not; the message names the extra.
    """
    from importlib.util import find_spec

    for module, name in (("jinja2", "Jinja2"), ("matplotlib", "matplotlib")):
        if find_spec(module) is None:
            raise UsageError(f"a report needs {name}, which is not installed: pip install 'tiltcal[report]'")


def render(template: str, **content: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template : str
        One of the folder ``templates``. Whatever it is given is escaped, but the figures, which are drawn here.
    content
        What the template names; a name that is missing is an error.
    """
    return _environment().get_template(template).render(**content)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("tiltcal.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["svg"] = lambda picture: Markup(picture.svg)
    environment.globals["KEPT"] = KEPT
    return environment
