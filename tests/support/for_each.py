"""A test of many small cases as one test, which names every case that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from inspect import signature
from typing import Any

import pytest


def for_each(names: str, cases: Iterable[Any], say: Callable[[Any], str] = str) -> Callable[[Any], Any]:
    """Run a test for each case, and raise what failed in all of them.

    ``names`` are the arguments of a case, as ``pytest.mark.parametrize`` takes them; ``say`` names it in the message.
    """
    arguments = [name.strip() for name in names.split(",")]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @wraps(test)
        def run(**fixtures: Any) -> None:
            failed: list[tuple[str, BaseException]] = []
            number = 0
            for case in cases:
                number += 1
                values = (case,) if len(arguments) == 1 else case
                try:
                    test(**dict(zip(arguments, values, strict=True)), **fixtures)
                except (Exception, pytest.fail.Exception) as failure:
                    failed.append((say(case), failure))
            assert number, "there is no case"
            if failed:
                lines = "\n".join(f"{case}: {type(failure).__name__}: {failure}" for case, failure in failed)
                raise AssertionError(f"{len(failed)} of {number} cases fail\n{lines}") from failed[0][1]

        whole = signature(test)
        run.__signature__ = whole.replace(  # type: ignore[attr-defined]
            parameters=[one for name, one in whole.parameters.items() if name not in arguments]
        )
        return run

    return decorate
