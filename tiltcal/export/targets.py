"""The programs that a calibration is exported to: what each holds of it, and the text that it reads."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from tiltcal import __version__
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits, vector_of, with_vector
from tiltcal.core.uncertain import central_differences
from tiltcal.drivers.model import OF_G
from tiltcal.errors import UsageError
from tiltcal.export.affine import Affine, affine_of
from tiltcal.export.c_header import float_constant, header, single_precision, single_precision_rounding
from tiltcal.export.c_integers import Integers
from tiltcal.export.loss import Formula, calibrated_range, largest_error
from tiltcal.export.python_module import FORMULA, module, numbers
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import CoefficientsSection
from tiltcal.files.record import plain

STANDARD_GRAVITY = OF_G["m/s2"]
ROUNDING_IN_INTEGERS = 2e-6  # g: that of the result in micro-g, and as much of the terms before it
ROUNDING_IN_DOUBLES = 1e-12  # g, with a reserve for the sums of another processor
STEP = 1e-6  # of a coefficient, relative, by which the noise at level is differentiated


@dataclass(frozen=True)
class Source:
    """A calibration that is exported, its limits with the rails of the model, and the name of the functions in C."""

    record: CalibrationRecord
    limits: Limits
    name: str = "tilt"

    @property
    def coefficients(self) -> Coefficients:
        """The coefficients of the calibration."""
        return self.record.coefficients

    @property
    def gravity(self) -> float:
        """Gravity where the calibration was made, or the standard one, m/s²."""
        return self.record.derived.gravity_m_s2 or STANDARD_GRAVITY

    @property
    def origin(self) -> str:
        """A line on where the numbers come from, in ASCII."""
        sensor, ended = self.record.sensor, self.record.provenance.ended
        dated = f" of {ended[:10]}" if ended else ""
        text = f"Calibration{dated} of {sensor.model} {sensor.serial}, made by tiltcal {__version__}"
        return text.encode("ascii", "replace").decode().replace("*/", "* /")

    @cached_property
    def affine(self) -> Affine:
        """The affine map at the reference temperature."""
        return affine_of(self.coefficients)

    def require_three_axes(self, target: str) -> None:
        """Refuse a sensor that does not measure x, y and z, with a UsageError."""
        if len(self.affine.matrix) < 3:
            raise UsageError(f"{target} takes three axes, and {self.record.sensor.serial} has fewer: export to c")


@dataclass(frozen=True)
class Export:
    """A calibration as a program reads it.

    text: returns what is written, with the bound. formula: gravity as the program computes it.
    holds: the terms of a calibration that the program holds beside offsets and own sensitivities.
    rounding: how far each component may be off beside the formula, g, shape (axes,).
    step: that of readings which the program takes in whole numbers, unit; 0 where it takes any.
    """

    text: Callable[[float], str]
    formula: Formula
    holds: tuple[str, ...]
    rounding: Array
    step: float = 0.0


CROSS_AXIS, TEMPERATURE, NONLINEARITY = "cross-axis sensitivity and mounting", "drift with temperature", "non-linearity"
THIRD, LAG = "the third component of gravity away from level", "thermal lag"


def terms(coefficients: Coefficients) -> list[str]:
    """Return the terms of a calibration beside offsets and own sensitivities."""
    matrix, thermal, bent = affine_of(coefficients).matrix, coefficients.thermal, coefficients.nonlinearity
    there = {
        CROSS_AXIS: bool((matrix - np.diag(np.diag(matrix))).any()),
        TEMPERATURE: thermal is not None and bool(thermal.drift.any() or thermal.gain.any()),
        NONLINEARITY: bent is not None and bool(bent.any()),
        THIRD: Compensation(coefficients).solves_z,
        LAG: thermal is not None and thermal.lag != 0.0,
    }
    return [term for term, is_there in there.items() if is_there]


@dataclass(frozen=True)
class Exported:
    """What is written, the terms that are left out, and the largest error of an angle that this costs, degrees."""

    text: str
    left_out: tuple[str, ...]
    bound: float


def exported(source: Source, target: str) -> Exported:
    """Return a calibration as a target reads it; a UsageError where it cannot hold such a calibration at all."""
    if Compensation(source.coefficients).on_edge:
        raise UsageError(
            "the mounting is on edge, where two channels leave the sign of the third open: only apply says which rows "
            "have one; export the calibration without its mounting"
        )
    if source.coefficients.angles is not None and target not in ("c", "python", "json"):
        sensor = source.record.sensor
        why = f"{sensor.serial} prints {sensor.unit}, and {target} takes components of gravity"
        raise UsageError(f"{why}: export to c, python or json")
    export = TARGETS[target](source)
    bound = largest_error(source.coefficients, source.limits, export.formula, export.rounding, export.step)
    left_out = tuple(term for term in terms(source.coefficients) if term not in export.holds)
    return Exported(export.text(bound), left_out, bound)


def _stated(source: Source, bound: float) -> str:
    limit = f"Angles differ from those of tiltcal apply by at most {bound:.2g} degrees in the calibrated range."
    return f"{source.origin}.\n   {limit}"


def _of_affine(lines: Sequence[str], affine: Affine, *holds: str) -> Export:
    """Return the export to a program that holds an affine map alone."""
    text = "\n".join(lines) + "\n"
    return Export(lambda _: text, lambda readings, _: affine(readings), holds, np.zeros(len(affine.matrix)))


def _c(source: Source) -> Export:
    up, temperature = calibrated_range(source.coefficients, source.limits)
    rounding = single_precision_rounding(source.coefficients, up, source.coefficients.predict(up, temperature))

    def text(bound: float) -> str:
        return header(source.name, _stated(source, bound), single_precision(source.coefficients, source.name))

    return _whole(source, text, rounding)


def _c_fixed(source: Source) -> Export:
    readings = source.coefficients.predict(*calibrated_range(source.coefficients, source.limits))
    per_unit = 1 if source.record.sensor.unit == "count" else 1_000_000
    integers = Integers.of(source.coefficients, per_unit, float(np.abs(readings).max()))

    def text(bound: float) -> str:
        return header(source.name, _stated(source, bound), integers.lines(source.name))

    return Export(
        text,
        integers,
        (CROSS_AXIS, TEMPERATURE),
        np.full(len(source.affine.matrix), ROUNDING_IN_INTEGERS),
        1.0 / per_unit,
    )


def _fusion(source: Source) -> Export:
    """``FusionCalibrationInertial`` of x-io Fusion: matrix * (sensitivity * (u - offset)), g."""
    source.require_three_axes("fusion")
    affine = source.affine
    sensitivity = np.diag(affine.matrix)
    vectors = {"Sensitivity": sensitivity, "Offset": affine.offset}
    lines = [f"/* {source.origin}: readings in {source.record.sensor.unit}, result in g. */"]
    rows = ", ".join(_floats(row) for row in affine.matrix / sensitivity)
    lines.append(f"const FusionMatrix accelerometerMisalignment = {{{rows}}};")
    lines += [f"const FusionVector accelerometer{name} = {{{_floats(row)}}};" for name, row in vectors.items()]
    return _of_affine(lines, affine, CROSS_AXIS)


def _ros(source: Source) -> Export:
    """``imu_calib``: SM a - bias, m/s², and the covariance of ``sensor_msgs/Imu``."""
    source.require_three_axes("ros")
    matrix = source.affine.matrix * source.gravity
    numbers = {
        "SM": matrix.ravel(),
        "bias": matrix @ source.affine.offset,
        "linear_acceleration_covariance": (_covariance(source) * source.gravity**2).ravel(),
    }
    lines = [f"# {source.origin}: readings in {source.record.sensor.unit}, result in m/s2."]
    lines += [f"{name}: [{', '.join(_number(value) for value in values)}]" for name, values in numbers.items()]
    return _of_affine(lines, source.affine, CROSS_AXIS)


def _of_autopilot(target: str, remark: str, lines: str, source: Source) -> Export:
    """Return the parameters of an autopilot, which corrects each axis for itself: (a - offset) scale, m/s²."""
    source.require_three_axes(target)
    unit, affine = source.record.sensor.unit, source.affine
    if unit not in ("m/s2", "g"):
        raise UsageError(
            f"{target} corrects readings in m/s2, and this calibration is of readings in {unit}",
            advice="record what the autopilot's own driver gives, and fit that with --unit m/s2",
        )
    to_metres, per_g = (1.0, source.gravity) if unit == "m/s2" else (source.gravity, 1.0)
    axes = zip("XYZ", affine.offset * to_metres, np.diag(affine.matrix) * per_g, strict=True)
    parameters = [lines.format(axis=axis, offset=_number(offset), scale=_number(scale)) for axis, offset, scale in axes]
    return _of_affine([f"# {source.origin}", remark, *parameters], _diagonal(affine))


def _iio(source: Source) -> Export:
    """Linux IIO: ``calibbias`` in whole counts and ``calibscale``, each axis for itself."""
    record = source.record
    if record.sensor.unit != "count" or len(source.affine.matrix) != len(record.sensor.channels):
        raise UsageError(f"iio corrects raw counts, and this calibration is of readings in {record.sensor.unit}")
    affine = _diagonal(source.affine)
    whole = Affine(affine.matrix, np.rint(affine.offset))
    lines = [
        "#!/bin/sh",
        f"# {source.origin}.",
        "# Sets calibbias (counts) and calibscale where the driver has them. Use: sh FILE [iio:device0]",
        "device=/sys/bus/iio/devices/${1:-iio:device0}",
        "set_value() {",
        '    if [ -e "$device/$1" ]; then echo "$2" > "$device/$1"; else echo "the driver has no $1" >&2; fi',
        "}",
        'scale=$(cat "$device/in_accel_scale") || exit 1',
    ]
    for axis, per_count, bias in zip(record.sensor.channels, np.diag(whole.matrix), whole.offset, strict=True):
        metres = _number(per_count * STANDARD_GRAVITY)
        lines.append(f"set_value in_accel_{axis}_calibbias {-round(bias)}")
        lines.append(f'set_value in_accel_{axis}_calibscale "$(awk "BEGIN {{ print {metres} / $scale }}")"')
    return _of_affine(lines, whole)


def _python(source: Source) -> Export:
    text = "".join(module(source.coefficients, source.origin, source.record.sensor.unit))
    return _whole(source, lambda _: text, np.full(len(source.affine.matrix), ROUNDING_IN_DOUBLES), LAG)


def _json(source: Source) -> Export:
    about = {"A": source.affine.matrix.tolist(), "b": source.affine.offset.tolist(), "unit": source.record.sensor.unit}

    if source.record.sensor.reads is not None:
        about["reads"] = source.record.sensor.reads
    thermal = CoefficientsSection.of(source.coefficients).temperature
    of = {"offset": plain(thermal.offset), "sensitivity": plain(thermal.sensitivity)} if thermal is not None else {}
    drift = {"drift": of, "reference": None if thermal is None else thermal.reference}

    def text(bound: float) -> str:
        data = {**about, "bound": bound, "formula": FORMULA, **numbers(source.coefficients), **drift}
        return json.dumps(data, indent=1) + "\n"

    return _whole(source, text, np.full(len(source.affine.matrix), ROUNDING_IN_DOUBLES), LAG)


def _whole(source: Source, text: Callable[[float], str], rounding: Array, *more: str) -> Export:
    """Return the export to a program that holds all of a calibration but the thermal lag, and ``more``."""
    compensation, holds = Compensation(source.coefficients), (CROSS_AXIS, TEMPERATURE, NONLINEARITY, THIRD, *more)
    return Export(text, lambda u, celsius: np.array(compensation(u, celsius).gravity), holds, rounding)


PX4 = (
    "# For the accelerometer whose CAL_ACC0_ID is set. Columns: vehicle, component, name, value, type",
    "1\t1\tCAL_ACC0_{axis}OFF\t{offset}\t9\n1\t1\tCAL_ACC0_{axis}SCALE\t{scale}\t9",
)
ARDUPILOT = "# NAME,VALUE", "INS_ACCOFFS_{axis},{offset}\nINS_ACCSCAL_{axis},{scale}"
"""The remark and the lines of an axis in a file of parameters, as QGroundControl and Mission Planner load it."""

TARGETS: dict[str, Callable[[Source], Export]] = {
    "c": _c,
    "c-fixed": _c_fixed,
    "fusion": _fusion,
    "ros": _ros,
    "px4": partial(_of_autopilot, "px4", *PX4),
    "ardupilot": partial(_of_autopilot, "ardupilot", *ARDUPILOT),
    "iio": _iio,
    "python": _python,
    "json": _json,
}
"""By name; ``c-fixed`` is ``c`` with ``--fixed``."""


def _diagonal(affine: Affine) -> Affine:
    return Affine(np.diag(np.diag(affine.matrix)), affine.offset)


def _covariance(source: Source) -> Array:
    """Return the covariance of gravity at level, of a single reading and of the coefficients, g², shape (3, 3)."""
    uncertainty, coefficients = source.record.uncertainty, source.coefficients
    noise = [uncertainty.single_reading.get(channel, 0.0) for channel in coefficients.channels]
    total = np.diag(np.square(noise))
    stated = uncertainty.covariance
    if stated is not None:
        stated = stated.without_turn()
        vector = vector_of(coefficients, stated.parameters)

        def level(values: Array) -> Array:
            up = np.array([[0.0, 0.0, 1.0]])
            return np.asarray(with_vector(coefficients, stated.parameters, values).predict(up)[0])

        jacobian = central_differences(level, vector, STEP * np.maximum(1.0, np.abs(vector)))
        total = total + jacobian @ stated.as_array() @ jacobian.T
    return np.asarray(source.affine.matrix @ total @ source.affine.matrix.T)


def _number(value: float) -> str:
    return f"{value:.9g}"


def _floats(row: Array) -> str:
    return ", ".join(map(float_constant, row))
