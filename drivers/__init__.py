"""Sensor drivers: bytes in, readings out. They contain nothing about calibration, prompts or files.

A module holds a sensor or converter and its virtual part; ``parts`` and ``accelerometers`` have register parts, a row
of facts each. What they share is in ``model`` (the interfaces), ``bus/`` (addresses and links), ``registers`` (what
makes a driver and a virtual part of a row), ``converters`` and ``analog`` (analog sensors), and ``virtual`` (virtual
parts and their truth).

The user selects a model by name. The built-in models are in a table and are imported only when used. A third party adds
a model by an entry point in the group ``tiltcal.devices``, with the name of the model, that loads a
:class:`~tiltcal.drivers.model.Model`. A plug-in never replaces a built-in model.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, cast

from tiltcal.errors import UsageError
from tiltcal.stated_arguments import require_text

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from tiltcal.drivers.model import Model

__all__ = ["find_model", "model_names", "models"]

PLUG_INS = "tiltcal.devices"

_BUILT_IN = {
    **dict.fromkeys(("sca100t-d01", "sca100t-d02"), "sca100t"),
    **dict.fromkeys(("sca100t-d01-analog", "sca100t-d02-analog"), "analog"),
    **dict.fromkeys(("adxl202-analog", "adxl202e-analog", "adxl210-analog", "thermistor"), "analog"),
    **dict.fromkeys(("adxl202", "adxl202e", "adxl210"), "adxl202"),
    "serial-columns": "columns",
    "modbus-columns": "modbus",
    "gradiometer": "stage",
    "witmotion": "witmotion",
    **dict.fromkeys(("iio", "python"), "attributes"),
    **dict.fromkeys(("sca3000-d01", "sca3000-e02", "sca3000-e04", "sca3000-e05", "sca3000-i2c"), "parts"),
    **dict.fromkeys(("scl3300", "sca3300-d01"), "scl3300"),
    "adxl355": "parts",
    **dict.fromkeys(("sca103t-d04", "sca103t-d05", "sca61t-fahh1g", "sca61t-fa1h1g"), "sca100t"),
    "iis2iclx": "parts",
    **dict.fromkeys(("adxl345", "mpu6050", "mpu6500", "mpu9250", "icm20948", "lis3dh"), "accelerometers"),
    **dict.fromkeys(("lsm6ds3", "lsm6ds3tr-c", "lsm6dsox", "mma8451", "bmi160", "msa311"), "accelerometers"),
}
"""The module of each model, whose ``MODELS`` has it by its name; in the order of the list of devices."""


def find_model(name: str) -> Model:
    """Return the sensor model with this name, as the user types it, such as ``sca100t-d02``.

    UsageError: no model has this name (near names are offered), a plug-in claims the name of another model, or a
        plug-in cannot be loaded.
    """
    require_text("sensor", name)
    plug_ins = _plug_ins(tuple(sys.path))
    claims = plug_ins.get(name, [])
    _refuse_rivals(name, claims)
    if name in _BUILT_IN:
        return _built_in(name)
    if claims:
        return _loaded(claims[0])
    near = get_close_matches(name.lower(), [*_BUILT_IN, *plug_ins], n=3)
    advice = f"did you mean {' or '.join(map(repr, near))}?" if near else "'tiltcal devices' lists them"
    raise UsageError(f"no sensor model is called {name!r} ({advice}); is it of a package that is not installed here?")


def models() -> Iterator[Model]:
    """Iterate over every sensor model: the built-in ones first, then those of plug-ins by name.

    UsageError: a plug-in claims the name of another model, or cannot be loaded.
    """
    plug_ins = _plug_ins(tuple(sys.path))
    for name, claims in plug_ins.items():
        _refuse_rivals(name, claims)
    for name in _BUILT_IN:
        yield _built_in(name)
    for _, (entry,) in sorted(plug_ins.items()):
        yield _loaded(entry)


def model_names() -> list[str]:
    """Return the name of every sensor model, none of which is imported."""
    return [*_BUILT_IN, *sorted(_plug_ins(tuple(sys.path)))]


def _built_in(name: str) -> Model:
    return cast("Model", import_module(f"tiltcal.drivers.{_BUILT_IN[name]}").MODELS[name])


@cache
def _plug_ins(path: tuple[str, ...]) -> Mapping[str, list[EntryPoint]]:
    """Return the entry points of each name of all packages on a path, whose search takes long."""
    from importlib.metadata import entry_points

    by_name: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=PLUG_INS):
        by_name.setdefault(entry.name, []).append(entry)
    return by_name


def _refuse_rivals(name: str, claims: list[EntryPoint]) -> None:
    """Refuse a name that two packages claim, so that the order of installation does not matter."""
    owners = ["tiltcal"] * (name in _BUILT_IN) + sorted(map(_package, claims))
    if len(owners) > 1:
        packages = " and ".join(map(repr, owners))
        raise UsageError(f"packages {packages} both have a sensor model called {name!r}: uninstall one or rename it")


def _loaded(entry: EntryPoint) -> Model:
    """Load the model of an entry point, and turn every failure of its import into a UsageError."""
    from tiltcal.drivers.model import Model

    where = f"sensor model {entry.name!r} of package {_package(entry)!r}"
    try:
        model = entry.load()
    except Exception as cause:
        raise UsageError(f"{where}: loading {entry.value!r} failed with {type(cause).__name__}: {cause}") from cause
    if not isinstance(model, Model):
        kind = type(model).__name__
        raise UsageError(f"{where}: {entry.value!r} is a {kind}, not a tiltcal.drivers.model.Model")
    if model.name != entry.name:
        raise UsageError(
            f"{where}: {entry.value!r} is named {model.name!r}; the entry point must have the model's own name"
        )
    return model


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.module
