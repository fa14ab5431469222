"""Calibrate tilt sensors at the bench, and remove their errors from recorded logs.

The names below are the library; each is imported when it is first used, so that ``import tiltcal`` is instant.
"""

from __future__ import annotations

TYPE_CHECKING = False
"""Not that of ``typing``: until ``tiltcal.__main__`` runs, Ctrl-C is Python's, so nothing slow is imported."""

if TYPE_CHECKING:
    from tiltcal.bench.measure import measure
    from tiltcal.bench.plan import plan
    from tiltcal.bench.sensors import open_sensor
    from tiltcal.calibration.calibration import Calibration, read
    from tiltcal.calibration.calibration_library import CalibrationLibrary, open_calibrations
    from tiltcal.calibration.combine import combine
    from tiltcal.calibration.comparison import compare
    from tiltcal.calibration.pair_calibration import PairCalibration
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
    from tiltcal.logs.apply import apply_log
    from tiltcal.logs.fit import fit
    from tiltcal.logs.match import match
    from tiltcal.logs.noise import noise

__version__ = "0.1.0"

_HOME = {
    "BusError": "tiltcal.errors",
    "Calibration": "tiltcal.calibration.calibration",
    "CalibrationLibrary": "tiltcal.calibration.calibration_library",
    "DeviceFault": "tiltcal.errors",
    "EstimateError": "tiltcal.errors",
    "HardwareError": "tiltcal.errors",
    "InputError": "tiltcal.errors",
    "JournalError": "tiltcal.errors",
    "PairCalibration": "tiltcal.calibration.pair_calibration",
    "SensorError": "tiltcal.errors",
    "Stopped": "tiltcal.errors",
    "TiltcalError": "tiltcal.errors",
    "UsageError": "tiltcal.errors",
    "apply_log": "tiltcal.logs.apply",
    "combine": "tiltcal.calibration.combine",
    "compare": "tiltcal.calibration.comparison",
    "fit": "tiltcal.logs.fit",
    "match": "tiltcal.logs.match",
    "measure": "tiltcal.bench.measure",
    "noise": "tiltcal.logs.noise",
    "open_calibrations": "tiltcal.calibration.calibration_library",
    "open_sensor": "tiltcal.bench.sensors",
    "plan": "tiltcal.bench.plan",
    "read": "tiltcal.calibration.calibration",
}
"""Where each name of the library is defined."""

__all__ = [
    "BusError",
    "Calibration",
    "CalibrationLibrary",
    "DeviceFault",
    "EstimateError",
    "HardwareError",
    "InputError",
    "JournalError",
    "PairCalibration",
    "SensorError",
    "Stopped",
    "TiltcalError",
    "UsageError",
    "__version__",
    "apply_log",
    "combine",
    "compare",
    "fit",
    "match",
    "measure",
    "noise",
    "open_calibrations",
    "open_sensor",
    "plan",
    "read",
]


def __getattr__(name: str) -> object:
    """Import a name of the library on its first use (PEP 562)."""
    from importlib import import_module

    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(_HOME[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
