"""Records: the sections of a file as types, which say what is allowed and what it means.

::

    class Spin(Record):
        turns: Annotated[AboveZero, about("turns of the stage in the record")]
        frequency: Annotated[AboveZero | None, about("of the spin, Hz")] = None

:meth:`~tiltcal.files.document.Document.read` checks a document by the types and returns the record; :func:`plain` gives
it back as data for a file. The JSON Schema and the tables of the reference are made from the types too. What one
key says of another is checked by one function for each kind of file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar, dataclass_transform

from msgspec import NODEFAULT, Meta, Struct, field
from msgspec.structs import replace

from tiltcal.stated_arguments import LEAST, MOST

T = TypeVar("T")

FORMAT_VERSION = 1

KINDS = {
    "tilt": "a tilt calibration",
    "pair": "a pair calibration, as 'tiltcal match' writes it",
    "procedure": "a procedure, as 'tiltcal measure' runs it",
    "bench": "a bench, for 'tiltcal measure --bench'",
    "device": "a device by its manual, for --sensor FILE",
    "twin": "a virtual sensor, for an address such as sim:?twin=FILE",
}
"""What messages call the files of each ``kind``."""

_LARGEST, _LARGEST_COUNT = 1.7976931348623157e308, 10**18  # nanoseconds of 31 years

# What is stated has a bound, as the options have; what is computed is finite.
Number = Annotated[float, Meta(ge=-MOST, le=MOST)]
FromZero = Annotated[float, Meta(ge=0.0, le=MOST)]
AboveZero = Annotated[float, Meta(ge=LEAST, le=MOST)]
Finite = Annotated[float, Meta(ge=-_LARGEST, le=_LARGEST)]
Size = Annotated[float, Meta(ge=0.0, le=_LARGEST)]
Count = Annotated[int, Meta(ge=0, le=_LARGEST_COUNT)]
FromOne = Annotated[int, Meta(ge=1, le=_LARGEST_COUNT)]
Text = Annotated[str, Meta(pattern=r"\S")]
Identifier = Annotated[
    str, Meta(pattern=r"^[^\W\d_][\w.-]*$", extra={"says": "a letter followed by letters, digits, '-', '_' and '.'"})
]


def about(text: str, *, usual: str = "") -> Meta:
    """Return what a key means, and its default as the reference shows it."""
    return Meta(description=text, extra={"usual": usual})


def one_of(*words: str) -> Meta:
    """Return the constraint of a text that is one of a few words."""
    return Meta(pattern=f"^({'|'.join(words)})$", extra={"words": words}, extra_json_schema={"enum": list(words)})


Axis = Annotated[str, one_of("x", "y", "z")]
ByAxis = Mapping[Axis, T]  # a value for some of the axes, or of the channels of a sensor
Range = tuple[Finite, Finite]  # two numbers ``[low, high]``


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Record(Struct, frozen=True, forbid_unknown_fields=True):
    """A section of a file."""

    always_written: ClassVar[tuple[str, ...]] = ()
    """The keys that are written where they have their default, too."""

    def replaced(self, **changes: Any) -> Self:
        """Return the record with other values of some keys."""
        return replace(self, **changes)


def keys_of(record: type[Record]) -> dict[str, bool]:
    """Return the keys of a section, and whether each is required."""
    return {name: default is NODEFAULT for name, default in _defaults(record).items()}


def file_data(kind: str, record: Record, *, whole: bool = False) -> dict[str, Any]:
    """Return a file of a kind as plain data; ``whole`` is as in :func:`plain`."""
    return {"tiltcal": FORMAT_VERSION, "kind": kind, **plain(record, whole)}


def plain(value: Any, whole: bool = False) -> Any:
    """Return a record as plain data, without the keys that have their default, or ``whole``, without empty ones.

    What is False is empty: so a key that is added later changes no file that does not use it.
    """
    if isinstance(value, Record):
        usual, data = _defaults(type(value)), {}
        for name, written in zip(value.__struct_fields__, value.__struct_encode_fields__, strict=True):
            content = getattr(value, name)
            is_empty = content in (None, "") or content is False
            if content != usual[name] or name in value.always_written or (whole and not is_empty):
                data[written] = plain(content, whole)
        return data
    if isinstance(value, Mapping):
        return {name: plain(member, whole) for name, member in value.items()}
    return [plain(item, whole) for item in value] if isinstance(value, tuple) else value


def _defaults(record: type[Record]) -> dict[str, Any]:
    """Return the values of absent keys; of a required one NODEFAULT."""
    # msgspec keeps the factory of an empty mapping.
    stated = [one.factory() if hasattr(one, "factory") else one for one in record.__struct_defaults__]
    required = len(record.__struct_fields__) - len(stated)
    return dict(zip(record.__struct_fields__, [*[NODEFAULT] * required, *stated], strict=True))
