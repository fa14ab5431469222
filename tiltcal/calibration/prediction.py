"""The uncertainty that a procedure will leave, predicted before the operator starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import degrees, hypot, radians, sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.fit import covered_tilts, design_of
from tiltcal.calibration.measurement import BenchUncertainty, require_tilt
from tiltcal.calibration.record import half_widths, tilt_lines
from tiltcal.calibration.schedule import better_order, least_seconds, way
from tiltcal.calibration.wording import symbol, unit_of, words
from tiltcal.core.attitude import STRAIGHT, Orientation, angle_uncertainty, solve_mounting
from tiltcal.core.estimation.design import PlannedPosition, Prediction, predict_uncertainty
from tiltcal.core.estimation.positions import Design
from tiltcal.core.model import Array, Limits
from tiltcal.core.samples import rounding_of_means
from tiltcal.drivers.model import Model
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.procedure import Procedure
from tiltcal.printable import in_html

PARTS = 8  # positions that stand for a leg of a ramp

LEAN = (
    "If the table is not level, its tilt is in the offsets: turn the fixture by 180° and repeat one position, or state "
    "--table-lean."
)

SHOWN = 3  # correlations and positions that are named


@dataclass(frozen=True)
class PredictedUncertainty:
    """The uncertainty that a procedure of positions leaves."""

    design: Design
    prediction: Prediction
    noise: float  # the standard deviation of one sample, unit
    drift: float  # of the offset of a usual part, unit/°C
    unit: str
    tilt: Mapping[str, tuple[Array, Array]]  # by axis tilts, and half the 95 % interval of each, degrees
    seconds: float  # that readings hold still and are sampled
    order: tuple[str, ...] = ()  # the positions as a table moves much less; empty where they stand so
    ways: tuple[float, float] = (0.0, 0.0)  # by how much a table turns in the procedure's order and in this, degrees
    closing: str = ""  # what a closing visit to the first position takes and brings
    not_covered: str = ""  # what no position shows

    @property
    def uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each coefficient by its dotted name, in its unit."""
        return self.prediction.uncertainty()

    def as_data(self) -> dict[str, Any]:
        """Return the prediction as plain data."""
        return {
            "noise": self.noise,
            "jig": None if self.design.free else self.design.jig,
            "uncertainty": self.uncertainty,
            "degrees_of_freedom": self.prediction.dof,
            "tilt": {
                axis: [[round(float(tilt[k]), 6), float(half[k])] for k in (0, int(np.argmin(np.abs(tilt))), -1)]
                for axis, (tilt, half) in self.tilt.items()
            },
            "seconds": self.seconds,
            "order": list(self.order),
            "degrees_turned": list(self.ways),
            "correlations": [list(pair) for pair in self.prediction.correlations],
            "worth_adding": [list(position) for position in self.prediction.worth_adding],
            "closing": self.closing or None,
            "not_covered": self.not_covered or None,
        }

    def __str__(self) -> str:
        prediction, design = self.prediction, self.design
        jig = "positions that are not set" if design.free else _jig_in_words(design.jig)
        lines = [f"predicted standard uncertainty, with {self.noise:.2g} {self.unit} of noise a sample and {jig}:"]
        if design.thermal and design.thermometer:
            lines.append(
                f"  and temperatures that are known to {design.thermometer:.2g} °C, for a part that drifts by "
                f"{self.drift:.2g} {self.unit}/°C"
            )
        for name, u in self.uncertainty.items():
            # What unit gravity leaves open is the choice of a frame, in which these are 0.
            if u > 0.0 or not design.free:
                lines.append(f"  {name:<28} {u:.2g} {unit_of(name, self.unit)}")
        lines += tilt_lines(self.tilt)
        unchecked = "" if prediction.dof else ": no residuals are left to check the result"
        lines.append(f"  degrees of freedom {prediction.dof}{unchecked}")
        for first, second, correlation in prediction.correlations[:SHOWN]:
            lines.append(f"  {first} and {second} are hardly separated (correlation {correlation:+.2f})")
        for name, coefficient, share in prediction.worth_adding[:SHOWN]:
            cut = f"would cut the uncertainty of {_in_words(coefficient)} by {100 * (1 - share):.0f} %"
            lines.append(f"  One more position, {name}, {cut}")
        held = duration(self.seconds)
        lines.append(f"  readings are held still and sampled for {held}; setting and changing temperatures on top")
        if self.order:
            ways = "{1:.0f}° in place of {0:.0f}°".format(*self.ways)
            lines.append(f"  a table turns by {ways} in the order {', '.join(self.order)}")
        return "\n".join([*lines, *(f"  {sentence}" for sentence in (self.closing, self.not_covered) if sentence)])

    __repr__ = __str__
    _repr_html_ = in_html


def _in_words(coefficient: str) -> str:
    """Return the symbol of a sensitivity, and another coefficient by its name."""
    letter, index = symbol(coefficient)
    name = words(coefficient)
    return f"S_{index}" if letter == "S" else f"the {name[:1].lower()}{name[1:]}"


def duration(seconds: float) -> str:
    """Return a time in words, such as ``12 min`` or ``3 h 20 min``."""
    minutes = round(seconds / 60.0)
    if minutes < 2:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


@dataclass(frozen=True)
class PredictedMounting:
    """The uncertainty that a mounting leaves beside that of the calibration, of a sensor that sits straight."""

    angles: dict[str, float]  # standard uncertainty of roll, pitch and yaw, degrees
    jig: float | None  # degrees; not stated, it counts as perfect

    @property
    def uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each angle by its dotted name, degrees."""
        return {f"mounting.{angle}": u for angle, u in self.angles.items()}

    def as_data(self) -> dict[str, Any]:
        """Return the prediction as plain data."""
        return {"jig": self.jig, "uncertainty": self.uncertainty}

    def __str__(self) -> str:
        with_what = f"with its noise and {_jig_in_words(self.jig)}"
        lines = [f"predicted standard uncertainty of a sensor that is mounted straight, {with_what}:"]
        lines += [f"  {angle:<6} {u:.2g}°" for angle, u in self.angles.items()]
        return "\n".join([*lines, "  that of its calibration comes on top"])

    __repr__ = __str__
    _repr_html_ = in_html


def predict_mounting(
    procedure: Procedure, model: Model, *, jig: float | None, noise: float | None, samples: int | None
) -> PredictedMounting:
    """Predict the uncertainty of a mounting; the arguments and errors are those of :func:`predict`."""
    require_tilt(procedure, model)
    scatter = _usual_noise(model) if noise is None else noise
    read = scatter / sqrt(samples or procedure.samples) / model.sensitivity
    known = np.array([position.gravity for position in procedure.positions])
    found = solve_mounting(known, known, np.full(len(known), hypot(radians(jig or 0.0), read)))
    straight = angle_uncertainty(np.eye(3), found.covariance)
    return PredictedMounting({name: degrees(getattr(straight, name)) for name in ANGLES}, jig)


def _along_ramp(procedure: Procedure) -> Procedure:
    """Return a ramp as positions on the way between its turning points, by which its uncertainty is predicted."""
    turns = [position.temperature or 0.0 for position in procedure.positions]
    ways = pairwise([procedure.reference or turns[-1], *turns])
    positions = tuple(
        replace(procedure.positions[0], name=f"leg-{leg}-{part + 1}", temperature=start + (end - start) * part / PARTS)
        for leg, (start, end) in enumerate(ways, start=1)
        for part in range(PARTS)
    )
    return procedure.replaced(positions=positions)


def predict(
    procedure: Procedure,
    model: Model,
    *,
    jig: float | None = None,
    thermometer: float | None = None,
    table_lean: float | None = None,
    noise: float | None = None,
    samples: int | None = None,
    settle: float | None = None,
    orientation: Orientation = STRAIGHT,
    sensors: int = 1,
    base: CalibrationRecord | None = None,
) -> PredictedUncertainty:
    """Predict the standard uncertainty of every coefficient equal sensors reach; no stated jig is a perfect one."""
    require_tilt(procedure, model)
    windows = [
        one * (settle or procedure.settle) / procedure.settle for one in (procedure.settle, procedure.soak.seconds)
    ]
    seconds = least_seconds(procedure, model, samples or procedure.samples, *windows)
    order = None if procedure.determines.free else better_order(procedure.positions)
    if procedure.ramp is not None:
        procedure = _along_ramp(procedure)
    identity = SensorIdentity(model.name, "", model.unit, model.channels)
    bench = BenchUncertainty(jig, model.thermometer_rounding if thermometer is None else thermometer, table_lean)
    design = design_of(identity, procedure, bench, nominal=model, base=base)
    scatter = _usual_noise(model) if noise is None else noise
    drift, positions = _usual_drift(model, base), procedure.positions
    settings = [None, *((position.gravity, position.heading) for position in positions)]
    planned = [
        PlannedPosition(
            one.name,
            orientation.seen(one.gravity),
            design.reference if one.temperature is None else one.temperature,
            one.heading,
            held=setting == before,
        )
        for one, (before, setting) in zip(positions, pairwise(settings), strict=True)
    ]
    prediction = predict_uncertainty(
        design,
        planned,
        scatter / sqrt(samples or procedure.samples),
        sensitivity=model.sensitivity,
        drift=drift,
        adc=rounding_of_means(scatter**2, model.resolution, len(positions)) if model.resolution else 0.0,
        sensors=sensors,
        level=procedure.determines.level,
    )
    limits = Limits(covered_tilts(design.channels, [position.gravity for position in planned]))
    one_heading = len({(position.heading or 0.0) % 360.0 for position in positions}) == 1
    uncovered = LEAN if one_heading and table_lean is None and not design.free else ""
    return PredictedUncertainty(
        design,
        prediction,
        scatter,
        drift,
        model.unit,
        half_widths(prediction.coefficients, prediction.uncertain, limits),
        seconds,
        () if order is None else tuple(position.name for position in order),
        (way(positions), way(order or positions)),
        not_covered=uncovered,
    )


def _jig_in_words(jig: float | None) -> str:
    return "a perfect jig (none is stated)" if jig is None else f"a jig of {jig:g}°"


def _usual_noise(model: Model) -> float:
    """Return the noise of a sample of the model's virtual part, at least that of rounding, unit."""
    known = max(model.default_truth(0).noise.values(), default=0.0) if model.default_truth else 0.0
    return hypot(known, model.resolution / sqrt(12))


def _usual_drift(model: Model, base: CalibrationRecord | None) -> float:
    """Return the drift of the offset, root mean square of the channels: the base's, or the virtual part's, unit/°C."""
    thermal = None if base is None else base.coefficients.thermal
    if thermal is not None and thermal.drift.size:
        slopes = thermal.drift[:, 0]
    else:
        usual = model.default_truth(0).drift.values() if model.default_truth else ()
        slopes = np.array([terms[0] for terms in usual if terms] or [0.0])
    return float(np.sqrt(np.mean(slopes**2)))
