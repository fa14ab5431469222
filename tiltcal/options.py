"""Options that are declared once: of a command, of the function of the library that it calls, and of its reference.

A declaration is a ``TypedDict`` whose fields are annotated with an :class:`Option`. A function of the library takes
``**options: Unpack[Declaration]``, so that a type checker reads the same list.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, get_type_hints

from tiltcal.printable import did_you_mean

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Option:
    """An option.

    Attributes
    ----------
    help : str
        What it states, its unit, and what holds without it.
    metavar : str or None
        What the help of the command shows for its value; None of one that the library alone has.
    group : str
        The heading that it stands below in the help of the command.
    default : object
        What it is where it is left out.
    check : callable or None
        Raises UsageError for a value that cannot be one; called with the name of the argument and the value.
    name, short : str
        Of the option where it differs from that of the argument, and its letter, such as ``-o``.
    """

    help: str
    metavar: str | None = None
    group: str = ""
    default: Any = None
    check: Callable[[str, Any], None] | None = None
    name: str = ""
    short: str = ""


def options_of(declaration: type) -> dict[str, tuple[Option, Any]]:
    """Return the options of a declaration and their types, by the name of the argument."""
    hints = get_type_hints(declaration, include_extras=True)
    return {name: (hint.__metadata__[0], hint.__origin__) for name, hint in hints.items()}


def flag_of(name: str, option: Option) -> str:
    """Return an option as the command line and messages write it, such as ``--reading-noise``."""
    return f"--{option.name or name.replace('_', '-')}"


def complete(declaration: type[T], given: Mapping[str, Any]) -> T:
    """Return options with the defaults of those that are left out; a value that cannot be one is a UsageError."""
    options = options_of(declaration)
    for name in given.keys() - options.keys():
        near = did_you_mean(name, options)
        raise TypeError(f"there is no option {name!r}{near}; the options are {', '.join(options)}")
    for name, value in given.items():
        if (check := options[name][0].check) is not None:
            check(name, value)
    return declaration(**{name: given.get(name, option.default) for name, (option, _) in options.items()})


def takes(declaration: type) -> Callable[[F], F]:
    """Give a function with ``**options`` the signature and the documentation of a declaration's options."""

    def documented(function: F) -> F:
        signature = inspect.signature(function)
        options = options_of(declaration)
        keywords = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=option.default, annotation=_written(kind))
            for name, (option, kind) in options.items()
        ]
        kept = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
        vars(function)["__signature__"] = signature.replace(
            parameters=sorted([*kept, *keywords], key=lambda one: one.kind)
        )
        text = inspect.getdoc(function)
        if text is not None:
            entries = []
            for name, (option, kind) in options.items():
                entries.append(f"{name} : {_written(kind).replace(' | ', ' or ')}\n    {option.help}\n")
            function.__doc__ = text.replace("**options\n", "".join(entries))
        return function

    return documented


def _written(kind: Any) -> str:
    """Return a type as an annotation, without the modules of Python's own types."""
    return re.sub(r"\b(?:collections\.abc|datetime|pathlib(?:\._local)?)\.", "", inspect.formatannotation(kind))
