"""Calibrate tilt sensors at the bench, and remove their errors from recorded logs.

The names below are the library; each is imported when it is first used, so that ``import tiltcal`` is instant.
"""

from __future__ import annotations

TYPE_CHECKING = False
"""Not that of ``typing``: until ``tiltcal.__main__`` runs, Ctrl-C is Python's, so nothing slow is imported."""

if TYPE_CHECKING:
    from tiltcal.bench.devices import open_sensor
    from tiltcal.errors import (
        BusError,
        DeviceFault,
        EstimateError,
        HardwareError,
        InputError,
        JournalError,
        SensorError,
        Stopped,
        TiltcalError,
        UsageError,
    )
    from tiltcal.library.calibration import Calibration, PairCalibration, combine, compare, read
    from tiltcal.library.measure import measure, plan
    from tiltcal.library.recorded import CalibrationLibrary, apply_log, fit, match, noise, open_calibrations
    from tiltcal.library.replay import Replay, replay

__version__ = "0.1.0"

# fmt: off
__all__ = [
    "BusError", "Calibration", "CalibrationLibrary", "DeviceFault", "EstimateError", "HardwareError", "InputError",
    "JournalError", "PairCalibration", "Replay", "SensorError", "Stopped", "TiltcalError", "UsageError", "__version__",
    "apply_log", "combine", "compare", "fit", "match", "measure", "noise", "open_calibrations", "open_sensor", "plan",
    "read", "replay",
]
# fmt: on

_HOME = {
    "bench.devices": "open_sensor",
    "library.calibration": "Calibration PairCalibration combine compare read",
    "library.measure": "measure plan",
    "library.recorded": "CalibrationLibrary apply_log fit match noise open_calibrations",
    "library.replay": "Replay replay",
}
"""The names that each module defines; all others are errors."""


def __getattr__(name: str) -> object:
    """Import a name of the library on its first use (PEP 562)."""
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = next((module for module, names in _HOME.items() if name in names.split()), "errors")
    value: object = getattr(import_module(f"tiltcal.{home}"), name)
    if callable(value) and not isinstance(value, type):
        value.__module__ = __name__  # where pickle looks for it
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
