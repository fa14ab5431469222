"""A machine of the bench file that moves by itself: a tilt table or a chamber."""

from __future__ import annotations

from collections.abc import Mapping
from string import Formatter
from typing import Annotated

from msgspec import Meta

from tiltcal.drivers.text_device import LINE_ENDS
from tiltcal.files.device import require_pattern
from tiltcal.files.document import Document
from tiltcal.files.record import AboveZero, Number, Range, Record, Text, about, one_of

TILTS = ("x", "y")
TABLE_AXES = (*TILTS, "heading", "stage")
CHAMBER_AXES = ("temperature",)

MachineAxis = Annotated[str, one_of(*TABLE_AXES, *CHAMBER_AXES)]


class Registers(Record):
    """The Modbus registers of one axis, as `register:type*factor`, such as `100:int16*0.01`."""

    set: Annotated[Text, about("the registers that take what is to be set, such as `100:int16*0.01`")]
    read: Annotated[Text, about("those that tell where it is")]


class MachineObject(Record):
    """The Python object of one axis."""

    address: Annotated[Text, about("`python:MODULE:FACTORY` makes an object with bluesky's `set` and `read`")]
    reading: Annotated[Text | None, about("which of its readings counts", usual="the one of its name")] = None


class Machine(Record):
    """A table or a chamber that moves by itself, and tells where it is."""

    kind: Annotated[str, one_of("text", "modbus", "object"), about("how it is driven: `text`, `modbus` or `object`")]
    limits: Annotated[
        Mapping[MachineAxis, Range],
        Meta(min_length=1),
        about("its axes and how far each may go: `x`, `y` (tilts), `heading`, `stage`, degrees; `temperature`, °C"),
    ]
    tolerance: Annotated[AboveZero, about("how far what is read back may be from what was set, degrees or °C")]
    approach: Annotated[
        Number, about("every angle is approached from so many degrees below it, or above where this is negative")
    ] = 0.0
    timeout: Annotated[AboveZero | None, about("seconds to get there", usual="120, of a chamber 14400")] = None
    outer: Annotated[str, one_of(*TILTS), about("of two tilts, the axis that carries the other")] = "x"
    address: Annotated[Text | None, about("of `text` any `serial:`, of `modbus` any `modbus:`")] = None
    greeting: Annotated[Text | None, about("`text`: the pattern that it sends when it is opened")] = None
    start: Annotated[tuple[Text, ...], about("`text`: the lines that are sent first, such as `$H`")] = ()
    set: Annotated[tuple[Text, ...], about('`text`: the lines that set it, such as `["G0 X{x:.3f} Y{y:.3f}"]`')] = ()
    accepted: Annotated[Text | None, about("`text`: the pattern that answers each of these lines, such as `^ok`")] = (
        None
    )
    failed: Annotated[Text | None, about("`text`: the pattern of an answer that refuses, such as `error|ALARM`")] = None
    read: Annotated[Text | None, about("`text`: the line that asks where it is")] = None
    read_alone: Annotated[bool, about("`text`: `read` is sent without a line end, as GRBL takes its `?`")] = False
    pattern: Annotated[
        Text | None, about("`text`: the answer to it, with a group for each axis, such as `X(?P<x>[-0-9.]+)`")
    ] = None
    done: Annotated[Text | None, about("`text`: the pattern in that answer that says it is at rest")] = None
    stop: Annotated[Text | None, about("`text`: the line that stops it")] = None
    line_end: Annotated[str, one_of(*LINE_ENDS), about("`text`: what ends a line")] = "lf"
    registers: Annotated[Mapping[MachineAxis, Registers], about("`modbus`: the registers of each axis")] = {}
    objects: Annotated[Mapping[MachineAxis, MachineObject], about("`object`: the object of each axis")] = {}

    @property
    def carrier(self) -> str:
        """The tilt that counts from the horizontal: the outer one, or the only one."""
        match [axis for axis in TILTS if axis in self.limits]:
            case [alone]:
                return alone
        return self.outer


NEEDED = {"text": ("address", "set", "read", "pattern"), "modbus": ("address", "registers"), "object": ("objects",)}
"""The keys that a kind needs."""
OPTIONAL = ("greeting", "start", "accepted", "failed", "read_alone", "done", "stop")  # the kind text may have them


def check_machine(machine: Machine, place: Document, axes: tuple[str, ...]) -> None:
    """Refuse what one key of a machine with some of these axes says against another; an InputError names the key."""
    place.require_keys(machine.limits, axes, "limits")
    for axis, limits in machine.limits.items():
        place.require_order(limits, "limits", axis)
    for kind, keys in {**NEEDED, "text": (*NEEDED["text"], *OPTIONAL)}.items():
        for key in keys if kind != machine.kind else ():
            if key not in NEEDED[machine.kind] and getattr(machine, key):
                raise place.error(f"a machine of kind {machine.kind} has no {key}: that is one of kind {kind}", key)
    for key in NEEDED[machine.kind]:
        if not getattr(machine, key):
            raise place.error(f"the key {key!r} is missing; a machine of kind {machine.kind} needs it")
    for key in ("registers", "objects"):
        if getattr(machine, key):
            place.require_keys(getattr(machine, key), list(machine.limits), key, complete=True)
    if machine.kind == "text":
        _check_text(machine, place)


def _check_text(machine: Machine, place: Document) -> None:
    """Refuse templates that do not set every axis, and patterns that are none or find no axis."""
    used = set()
    for number, line in enumerate(machine.set):
        try:
            used |= {name for _, name, _, _ in Formatter().parse(line) if name is not None}
            line.format(**dict.fromkeys(machine.limits, 1.0))
        except (ValueError, LookupError, AttributeError) as error:
            why = f"{line!r} is no template of {', '.join(machine.limits)} ({error}); write {{x:.3f}}"
            raise place.error(why, "set", number) from None
    for axis in machine.limits:
        if axis not in used:
            raise place.error(f"nothing sets {axis}: write {{{axis}}} where its number belongs", "set")
    for key in ("greeting", "accepted", "failed", "pattern", "done"):
        require_pattern(place, key, getattr(machine, key), tuple(machine.limits) if key == "pattern" else ())
