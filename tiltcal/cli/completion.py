"""What a shell completes behind a command: models, procedures, operators, serial numbers, files."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_FILES = ("FILE", "PATH", "CAL", "JOURNAL", "SEG")  # what the help of an option calls a file


class Completed(click.ParamType[Any]):
    """The type of a parameter, with the values that a shell offers for it.

    Click completes choices and paths itself; a parameter that is either, or takes what nobody can list, keeps its type.
    """

    def __init__(self, of: click.ParamType[Any]) -> None:
        self._of, self.name = of, of.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self._of.convert(value, param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        file = CompletionItem(incomplete, type="file")  # the first: it empties the list of bash
        words = [CompletionItem(word) for word in _words(ctx, param) if word.startswith(incomplete)]
        return words if param.name in ("operator", "serial") else [file, *words]


def complete(param: click.Parameter) -> None:
    """Let the shell complete a parameter where its name or the name of its value says what it takes."""
    listed = param.name in ("sensor", "model", "procedure", "operator", "serial")
    if param.type in (click.STRING, click.UNPROCESSED) and (
        listed or isinstance(param, click.Argument) or param.metavar in _FILES
    ):
        param.type = Completed(param.type)


def _words(ctx: click.Context, param: click.Parameter) -> Iterable[str]:
    match param.name:
        case "sensor" | "model":
            from tiltcal.drivers import model_names
            from tiltcal.files.device import shipped_devices

            return [*model_names(), *shipped_devices()]
        case "procedure":
            from tiltcal.files.procedure import shipped_procedures

            return shipped_procedures()
        case "operator":
            return (param.metavar or "").split("|")
        case "serial":
            named = ctx.params.get("bench")
            return [
                serial for path in ([named] if named else sorted(Path().glob("*.y*ml"))) for serial in _serials(path)
            ]
    return ()


def _serials(path: Path | str) -> list[str]:
    """Return the serial numbers of a bench file; of any other file none."""
    from tiltcal.errors import TiltcalError
    from tiltcal.files.document import read_document

    with suppress(TiltcalError):
        document = read_document(path)
        if document.kind == "bench":
            return [str(one.data) for sensor in document.at("sensors").items() if (one := sensor.at("serial")).data]
    return []
