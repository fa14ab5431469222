"""The calibrated tilt of sensors as they are now, without a session."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from tiltcal.bench.devices import Recorder, VirtualBench, connected, probe_devices
from tiltcal.calibration.record import compensation_of
from tiltcal.calibration.stated import stated_uncertainty
from tiltcal.core.angle_readings import DEGREES
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.flags import FLAGS, PASS, REASONS
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import EstimateError, InputError
from tiltcal.files.bench import BenchSensor
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.journal.header import THERMOMETER, BenchDevice

OTHER_SCALE = 1.4
"""A calibrated sensitivity that differs by more than this factor from the model's is of another range or scale."""


def as_calibrated(calibration: CalibrationRecord, address: str) -> str:
    """Return an address with the options of the device, such as its columns, that the calibration's own one states."""
    bench, stated = calibration.provenance.bench, parse_address(address)
    if bench is None or bench.address is None:
        return address
    filed = parse_address(bench.address)
    model = find_model(calibration.sensor.model) if calibration.device is None else calibration.device.model
    absent = [
        f"{name}={filed.options[name]}" for name in model.options if name in filed.options.keys() - stated.options
    ]
    joint = "&" if stated.options else "" if address.endswith((":", "?")) else "?"
    return f"{address}{joint if absent else ''}{'&'.join(absent)}"


def require_as_calibrated(calibration: CalibrationRecord, device: BenchSensor | BenchDevice) -> None:
    """Refuse a sensor at an address where it has other channels, another unit, range or scale than its calibration.

    InputError: the message names what differs.
    """
    identity, model, coefficients = calibration.sensor, device.wired, calibration.coefficients
    advice, of = "name the address as it was calibrated", f"the calibration of {identity.serial} is of "
    if identity.unit != model.unit or not set(identity.channels) <= set(model.channels):
        raise InputError(
            f"{of}{', '.join(identity.channels)} in {identity.unit}, and {device.address} gives "
            f"{', '.join(model.channels)} in {model.unit}: {advice}"
        )
    channel, bench = identity.channels[0], calibration.provenance.bench
    own = abs(coefficients.own_sensitivity(channel)) if channel in coefficients.axes else model.sensitivity
    filed = model if bench is None or bench.address is None else device.replaced(address=bench.address).wired
    other = (filed.sensitivity, filed.offset) != (model.sensitivity, model.offset)
    if coefficients.angles is not None and coefficients.angles.slope:  # the model's is of the tangent
        own *= coefficients.angles.slope / DEGREES
    if model.scaled and (other or max(own / model.sensitivity, model.sensitivity / own) > OTHER_SCALE):
        raise InputError(
            f"{of}another range or scale, {own:.5g} {identity.unit}/g: at {device.address} it is nominally "
            f"{model.sensitivity:.5g} {model.unit}/g; {advice}"
        )


@dataclass(frozen=True)
class LiveTilt:
    """What a calibration makes of one reading.

    ``angles`` and half of their 95 % intervals, where the file states its uncertainty, are in degrees by the names of
    the columns of ``apply``; ``temperature`` is in °C.
    """

    angles: Mapping[str, float]
    expanded: Mapping[str, float]
    temperature: float | None
    flag: int
    reason: int

    def as_data(self) -> dict[str, Any]:
        """Return the tilt as plain data, by the names of the columns of ``apply``."""
        expanded = {f"U95_{name}": half for name, half in self.expanded.items()}
        judged = {"temperature": self.temperature, "flag": self.flag, "reason": self.reason}
        return {**self.angles, **expanded, **judged}

    def in_words(self) -> list[tuple[str, str, str]]:
        """Return each angle as its name, its value and half of its 95 % interval, such as ``tilt x, +12.03°, ± 0.05°``.

        The temperature follows, and why the reading is suspect.
        """
        said = [
            (name.replace("_", " "), f"{angle:+.2f}°", f"± {self.expanded[name]:.2f}°" if self.expanded else "")
            for name, angle in self.angles.items()
        ]
        said += [] if self.temperature is None else [("", f"{self.temperature:.1f} °C", "")]
        if self.flag != PASS:
            reasons = (words for bit, words in REASONS.items() if self.reason & bit)
            said.append((FLAGS[self.flag], ", ".join(reasons), ""))
        return said

    def __str__(self) -> str:
        return "   ".join(" ".join(filter(None, part)) for part in self.in_words())

    def within(self, width: int) -> str:
        """Return what has room in so many columns, first what says most: the flag, pitch and roll of three axes."""
        parts = [" ".join(filter(None, part)) for part in self.in_words()]
        if self.flag != PASS:
            parts = [FLAGS[self.flag], *parts[:-1], parts[-1].removeprefix(FLAGS[self.flag]).strip()]
        line = ""
        for part in sorted(parts, key=lambda one: one not in FLAGS.values() and not one.startswith(("pitch", "roll"))):
            line += f"   {part}" if len(line) + 3 + len(part) <= width else ""
        return line or f"   {parts[0]}"[:width]


class TiltOfReadings:
    """Turns readings of a model, in the order of time, into tilt.

    InputError: the calibration cannot be applied, or is of other channels or another unit than the readings.
    """

    def __init__(self, calibration: CalibrationRecord, model: Model) -> None:
        coefficients = calibration.coefficients
        self._places = [model.channels.index(channel) for channel in coefficients.channels]
        self._lag = ThermalLag(0.0 if coefficients.thermal is None else coefficients.thermal.lag)
        try:
            self._compensation = compensation_of(calibration)
        except EstimateError as failure:
            raise InputError(failure.words) from failure
        self._uncertain: CompensationWithUncertainty | None = None
        try:
            stated, _ = stated_uncertainty(calibration)
            self._uncertain = CompensationWithUncertainty(self._compensation, coefficients, stated)
        except EstimateError:
            pass  # the file states no uncertainty

    def __call__(self, reading: Reading, seconds: float) -> LiveTilt:
        """Return the tilt of a reading at a time."""
        readings = np.array([[reading.values[place] for place in self._places]])
        temperature = np.array([np.nan if reading.temperature is None else reading.temperature])
        element = self._lag(np.array([seconds]), temperature)
        expanded: Mapping[str, float] = {}
        names = self._compensation.angles
        if self._uncertain is None:
            compensated = self._compensation(readings, element)
        else:
            compensated, (_, half) = self._uncertain(readings, element)
            expanded = dict(zip(names, half[:, 0].tolist(), strict=True))
        angles = dict(zip(names, compensated.angles[0].tolist(), strict=True))
        return LiveTilt(
            angles, expanded, reading.temperature, int(compensated.flag[0]), int(compensated.reason[0])
        )  # fmt: skip


@contextmanager
def live_tilts(
    devices: Sequence[BenchSensor],
    calibrations: Mapping[str, CalibrationRecord],
    thermometer: BenchSensor | None = None,
) -> Iterator[Callable[[], dict[str, LiveTilt]]]:
    """Yield a function that reads the sensors and returns the tilt of each, by serial number, in real time.

    HardwareError: a device does not answer; from the function a SensorError, after which it may be called again.
    """
    clock = session_clock(datetime.now(UTC), virtual=False)
    for device in devices:
        require_as_calibrated(calibrations[device.serial], device)
    beside = {} if thermometer is None else {THERMOMETER: thermometer}
    every = (*devices, *beside.values())
    recorder = Recorder(clock)
    kernels = {device.serial: TiltOfReadings(calibrations[device.serial], device.wired) for device in devices}
    probe_devices(every, clock)
    with connected(devices, beside, recorder, VirtualBench(clock, every)) as sensors:

        def read() -> dict[str, LiveTilt]:
            readings = sensors.read(fresh=True)
            readings.now_ns = recorder.now_ns()
            return {serial: kernels[serial](reading, readings.seconds) for serial, reading in readings.items()}

        yield read
