"""The formulas of the source documents, by name.

Each is one procedure's solution in closed form; the estimator that serves all procedures is checked against them.
Readings and offsets are in the sensor's unit (V, count, duty), sensitivities and scale factors in unit/g, temperature
coefficients in unit/°C, angles in radians, temperatures in °C, unless a function states something else.

Sources: *Cross-axis Compensation* (VTI Technologies, 2005) and *A Solid State Tilt Meter for Current Meter Attitude
Determination* (A. J. Williams 3rd, Woods Hole Oceanographic Institution).
"""

from __future__ import annotations

from math import asin, hypot, nan, pi, sin

from tiltcal.errors import EstimateError

# Cross-axis Compensation


def sensitivity_from_pair(reading_tilt1: float, reading_tilt2: float, tilt1: float, tilt2: float) -> float:
    """Eq. 2: sensitivity by the magnitudes of a tilt up and one down, (u_tilt1 - u_tilt2) / (sin tilt1 + sin tilt2)."""
    return (reading_tilt1 - reading_tilt2) / _span(tilt1, tilt2)


def offset_from_pair(reading_tilt1: float, reading_tilt2: float, tilt1: float, tilt2: float) -> float:
    """Reading at 0 g that goes with eq. 2 or 3: what remains of ``u = offset + S sin tilt`` at either position."""
    return (reading_tilt1 * sin(tilt2) + reading_tilt2 * sin(tilt1)) / _span(tilt1, tilt2)


def sensitivity_from_upright_pair(reading_up: float, reading_down: float) -> float:
    """Eq. 3: sensitivity along an axis that points straight up, then straight down, ``(u_tilt1 - u_tilt2) / 2 g``."""
    return (reading_up - reading_down) / 2.0


def cross_axis_sensitivity(own: float, cross_1: float, cross_2: float) -> float:
    """Eq. 1: cross-axis sensitivity of one channel, ``sqrt(S_Y² + S_Z²) / S_X * 100 %``; negative where ``own`` is."""
    if own == 0.0:
        raise EstimateError("a sensitivity of 0 in the measuring direction has no cross-axis ratio: is the axis wired?")
    return hypot(cross_1, cross_2) / own * 100.0


def tilt_from_channel(reading: float, offset: float, sensitivity: float) -> float:
    """Eq. 4: tilt of the axis that one channel measures, ``asin((u - offset) / S)``; NaN beyond ±1."""
    return _trapped_arcsine((reading - offset) / sensitivity)


def first_order_compensation(
    reading_x: float, reading_y: float, offset_y: float, sensitivity_xy: float, sensitivity_yy: float
) -> float:
    """Eq. 6 with a MINUS: ``u_X - S_XY (u_Y - offset_Y) / S_YY``, X freed from what the Y axis couples into it.

    The document prints a plus, and the plus is wrong. The channel reads ``offset_X + S_XX g_x + S_XY g_y``, and
    ``(u_Y - offset_Y) / S_YY`` is g_y, so the coupled part is there once and must be taken away. No convention for
    the two positions saves the plus: calling the other one tilt1 changes the sign of S_XY and of S_YY together, and
    their ratio stays. With S_XX = 2 V/g, S_XY = 0.04 V/g and g_y = 0.4 the error of g_x is 0.0080 g before
    compensation, 0.0159 g after adding and 0.0001 g after subtracting.
    """
    return reading_x - sensitivity_xy * (reading_y - offset_y) / sensitivity_yy


def first_order_compensation_from_tilt(reading_x: float, tilt_y: float, sensitivity_xy: float) -> float:
    """Eq. 5 with a MINUS as in eq. 6: ``u_X - S_XY sin(tilt_Y)``, where the tilt of Y is known already."""
    return reading_x - sensitivity_xy * sin(tilt_y)


# A Solid State Tilt Meter


def scale_from_tilt(reading_tilted: float, reading_level: float, tilt: float) -> float:
    """Section A: scale factor from level and one tilt of about 45°, the angle actually set, with its sign."""
    if sin(tilt) == 0.0:
        raise EstimateError("two level positions cannot determine a scale factor: tilt the second one, to about 45°")
    return (reading_tilted - reading_level) / sin(tilt)


def tempco_from_two_temperatures(
    reading_1: float, reading_2: float, temperature_1: float, temperature_2: float
) -> float:
    """Section C: temperature coefficient of the offset from level readings at two temperatures, such as 24 and 5.5."""
    if temperature_1 == temperature_2:
        raise EstimateError(
            f"two readings at the same temperature ({temperature_1} °C) cannot determine a temperature coefficient"
        )
    return (reading_1 - reading_2) / (temperature_1 - temperature_2)


def referenced_reading(reading: float, temperature: float, tempco: float, reference: float) -> float:
    """Section C: what a reading would be at the reference temperature, 0 °C in the paper."""
    return reading - tempco * (temperature - reference)


def referenced_tilt(
    reading: float, temperature: float, offset: float, scale: float, tempco: float, reference: float
) -> float:
    """Section C: tilt of one axis from the reading at the reference temperature; NaN beyond ±1, as section A asks."""
    return _trapped_arcsine((referenced_reading(reading, temperature, tempco, reference) - offset) / scale)


def _span(tilt1: float, tilt2: float) -> float:
    """Acceleration between a tilt up and a tilt down, both magnitudes in radians, in g."""
    if not (0.0 <= tilt1 <= pi / 2 and 0.0 <= tilt2 <= pi / 2):
        raise EstimateError("eq. 2 takes the magnitudes of the two tilts, each between 0 and 90°")
    span = sin(tilt1) + sin(tilt2)
    if span == 0.0:
        raise EstimateError("two level positions cannot determine a sensitivity: tilt the axis up, then down")
    return span


def _trapped_arcsine(argument: float) -> float:
    return asin(argument) if -1.0 <= argument <= 1.0 else nan
