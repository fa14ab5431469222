"""The unknowns of a fit, and the priors of those that no position determines.

They come from the sensor's data sheet, from its nominal sensitivity, or from the calibration that it has.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, radians, sin

import numpy as np

from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.core.angle_readings import DEGREES
from tiltcal.core.estimation.positions import Design, Prior
from tiltcal.core.model import AXES, values
from tiltcal.drivers.model import OF_TILT, Model, deviation_within
from tiltcal.errors import Argument, EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import PositionProcedure

SENSITIVITY_FROM = (
    "name a ", Argument("sensor"), " model whose nominal one may stand in, state it in the address (sensitivity=..., "
    "unit per g), or name the sensor's own calibration with ", Argument("base"),
)  # fmt: skip


LEAN_OF_CHANNELS = radians(0.5)  # standard uncertainty of where a channel that prints angles points, radians


def design_of(
    sensor: SensorIdentity,
    procedure: PositionProcedure,
    bench: BenchUncertainty,
    *,
    nominal: Model | None = None,
    base: CalibrationRecord | None = None,
) -> Design:
    """Return what a procedure determines of a sensor, and how well the bench sets what it sets."""
    channels = tuple(c for c in sensor.channels if not procedure.axes or c in procedure.axes)
    if not channels:
        axes = ", ".join(procedure.axes)
        raise EstimateError(f"{procedure.name} determines the axes {axes}; {sensor.model} has none of them")
    angles = sensor.angle_readings
    design = Design(
        channels,
        procedure.axes or channels,
        procedure.drift,
        procedure.gain,
        procedure.reference or 0.0,
        bench.jig if procedure.known else inf,
        table_lean=bench.table_lean,
        heading=bench.heading or 0.0,
        instrument=bench.instrument,
        thermometer=bench.thermometer,
        nonlinearity=0 if angles else procedure.nonlinearity,
        angles=angles,
    )
    if procedure.axes and angles is not None:
        usual = OF_TILT.get(sensor.unit, 0.0) if not angles.slope else DEGREES
        return _with_lean(design, nominal, usual, radians(procedure.alignment) or LEAN_OF_CHANNELS)
    if procedure.axes:
        return design if design.free or nominal is None else _with_data_sheet(design, nominal)
    if base is not None:
        return _with_base(design, base, whole=procedure.renews)
    if nominal is None or not nominal.scaled:
        raise EstimateError(f"{procedure.name} determines no sensitivity, and none is known", advice=SENSITIVITY_FROM)
    own, cross = Prior(nominal.sensitivity, nominal.sensitivity * nominal.sensitivity_spread), Prior(0.0)
    if angles is not None:  # of slopes in degrees
        size = angles.per_degree(nominal.sensitivity)
        own = Prior(size, abs(size) * nominal.sensitivity_spread)
    priors = {f"sensitivity.{c}.{axis}": own if axis == c else cross for c in channels for axis in design.axes}
    return replace(design, priors=priors)


def _with_data_sheet(design: Design, model: Model) -> Design:
    """Return the design with what no position determines, and what the data sheet of the model states of it."""
    own, channels = design.axes, design.channels
    two_of_three = len(channels) == 2 and set(channels) <= set(AXES) and model.cross_axis_limit > 0.0
    u = model.sensitivity * deviation_within(model.cross_axis_limit)
    axes = (*own, *(axis for axis in AXES if axis not in own)) if two_of_three else own
    order = max(design.nonlinearity, len(model.nonlinearity)) if set(channels) <= set(axes) else 0
    priors = {f"sensitivity.{c}.{axis}": Prior(0.0, u) for c in channels for axis in axes if axis not in own}
    for k in range(design.nonlinearity, order):
        priors |= {f"nonlinearity.{c}.{k + 2}": Prior(0.0, model.nonlinearity[k]) for c in channels}
    scale = model.sensitivity if model.scaled else 0.0
    return replace(design, axes=axes, nonlinearity=order, priors=priors, nominal=scale)


def _with_lean(design: Design, model: Model | None, usual: float, lean: float) -> Design:
    """Return the design of channels that print angles, with what no position determines of where they point."""
    size = usual if model is None or not model.scaled or (design.angles and design.angles.slope) else model.sensitivity
    axes = design.axes
    if len(design.channels) <= 2 and "z" not in axes:
        axes = (*axes, "z")
    u = abs(size) / DEGREES * sin(lean)
    priors = {f"sensitivity.{c}.z": Prior(0.0, u) for c in design.channels if "z" not in design.axes}
    if design.angles is not None and design.angles.euler and "y" in design.channels:
        priors["sensitivity.y.z"] = Prior(0.0)  # a turn about x is an offset of the roll, exactly
    return replace(design, axes=axes, priors=priors, nominal=size)


def _with_base(design: Design, base: CalibrationRecord, *, whole: bool) -> Design:
    """Return the design with the sensitivity of the sensor's own calibration, ``whole`` with temperature terms."""
    coefficients, u = base.coefficients, base.uncertainty
    order = 0 if coefficients.nonlinearity is None else coefficients.nonlinearity.shape[1]
    kept = ("sensitivity.", "nonlinearity.", *(["temperature."] if whole else []))
    priors = {
        name: Prior(value, u.get(name, 0.0)) for name, value in values(coefficients).items() if name.startswith(kept)
    }
    design = replace(design, axes=coefficients.axes, nonlinearity=order, angles=coefficients.angles)
    uncertain = base.uncertain.named([name for name, prior in priors.items() if prior.u > 0.0])
    if not whole and not np.allclose(uncertain.covariance, np.diag(uncertain.u**2)):
        # As of all sensitivities together: an error of a reference, such as its alignment, is in all of them alike.
        value = np.array([priors[name].value for name in uncertain.names])
        priors |= {name: Prior(priors[name].value, inf) for name in uncertain.names}
        rows = np.array([[name == other for other in design.names] for name in uncertain.names], dtype=float)
        design = replace(design, stated=((rows, replace(uncertain, value=value)),))
    design = replace(design, priors=priors)
    thermal = coefficients.thermal if whole else None
    if thermal is None:
        return design
    return replace(design, drift=thermal.drift.shape[1], gain=thermal.gain.shape[1], reference=thermal.reference)
