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


def sensitivity_from_pair(reading_tilt1: float, reading_tilt2: float, tilt1: float, tilt2: float) -> float:
    """Sensitivity along the axis that is tilted up in one position and down in the other.

    Parameters
    ----------
    reading_tilt1, reading_tilt2 : float
        With the axis tilted up, and down.
    tilt1, tilt2 : float
        How far it is tilted in each position, both as magnitudes.

    Raises
    ------
    EstimateError
        A magnitude outside 0 to 90°, or both zero.

    Notes
    -----
    Cross-axis Compensation, eq. 2: ``S = (u_tilt1 - u_tilt2) / (sin tilt1 + sin tilt2)``.
    """
    return (reading_tilt1 - reading_tilt2) / _span(tilt1, tilt2)


def offset_from_pair(reading_tilt1: float, reading_tilt2: float, tilt1: float, tilt2: float) -> float:
    """Reading at 0 g that goes with :func:`sensitivity_from_pair`, of the same arguments (or, at ±90°, with eq. 3).

    Raises
    ------
    EstimateError
        A magnitude outside 0 to 90°, or both zero.

    Notes
    -----
    The document leaves the offset to the reader: it is what remains when the sensitivity of eq. 2 is put back into
    ``u = offset + S sin tilt`` at either position. With equal tilts it is the mean of the two readings.
    """
    return (reading_tilt1 * sin(tilt2) + reading_tilt2 * sin(tilt1)) / _span(tilt1, tilt2)


def sensitivity_from_upright_pair(reading_up: float, reading_down: float) -> float:
    """Sensitivity along an axis that points straight up (+90°), then straight down (-90°).

    Notes
    -----
    Cross-axis Compensation, eq. 3: ``S = (u_tilt1 - u_tilt2) / 2 g``.
    """
    return (reading_up - reading_down) / 2.0


def cross_axis_sensitivity(own: float, cross_1: float, cross_2: float) -> float:
    """Cross-axis sensitivity of one channel, percent; negative where ``own`` is.

    Parameters
    ----------
    own : float
        Sensitivity in the measuring direction.
    cross_1, cross_2 : float
        Sensitivities of the same channel in the two perpendicular directions.

    Raises
    ------
    EstimateError
        ``own`` is zero.

    Notes
    -----
    Cross-axis Compensation, eq. 1: ``CrSens = sqrt(S_Y² + S_Z²) / S_X * 100 %``.
    """
    if own == 0.0:
        raise EstimateError("a sensitivity of 0 in the measuring direction has no cross-axis ratio: is the axis wired?")
    return hypot(cross_1, cross_2) / own * 100.0


def tilt_from_channel(reading: float, offset: float, sensitivity: float) -> float:
    """Tilt of the axis that one channel measures; NaN where the argument of the arcsine is beyond ±1.

    Notes
    -----
    Cross-axis Compensation, eq. 4: ``tilt = asin((u - offset) / S)``.
    """
    return _trapped_arcsine((reading - offset) / sensitivity)


def first_order_compensation(
    reading_x: float, reading_y: float, offset_y: float, sensitivity_xy: float, sensitivity_yy: float
) -> float:
    """Reading of channel X freed from what the Y axis couples into it, to first order.

    Parameters
    ----------
    sensitivity_xy, sensitivity_yy : float
        Of channel X and of channel Y along the Y axis, from :func:`sensitivity_from_pair` in the same two positions.

    Notes
    -----
    Cross-axis Compensation, eq. 6, with a MINUS: ``u_X - S_XY (u_Y - offset_Y) / S_YY``.

    The document prints a plus, and the plus is wrong. The channel reads ``offset_X + S_XX g_x + S_XY g_y``, and
    ``(u_Y - offset_Y) / S_YY`` is g_y, so the coupled part is there once and must be taken away. No convention for
    the two positions saves the plus: calling the other one tilt1 changes the sign of S_XY and of S_YY together, and
    their ratio stays. With S_XX = 2 V/g, S_XY = 0.04 V/g and g_y = 0.4 the error of g_x is 0.0080 g before
    compensation, 0.0159 g after adding and 0.0001 g after subtracting.
    """
    return reading_x - sensitivity_xy * (reading_y - offset_y) / sensitivity_yy


def first_order_compensation_from_tilt(reading_x: float, tilt_y: float, sensitivity_xy: float) -> float:
    """:func:`first_order_compensation` where the tilt of Y is known already.

    Parameters
    ----------
    tilt_y : float
        From :func:`tilt_from_channel`.

    Notes
    -----
    Cross-axis Compensation, eq. 5, with a MINUS as in eq. 6: ``u_X - S_XY sin(tilt_Y)``.
    """
    return reading_x - sensitivity_xy * sin(tilt_y)


def scale_from_tilt(reading_tilted: float, reading_level: float, tilt: float) -> float:
    """Scale factor from level and one tilt of about 45°.

    Parameters
    ----------
    tilt : float
        The angle actually set, with its sign.

    Raises
    ------
    EstimateError
        The angle is zero.

    Notes
    -----
    A Solid State Tilt Meter, section A: the difference is divided by the sine of the tilt angle.
    """
    if sin(tilt) == 0.0:
        raise EstimateError("two level positions cannot determine a scale factor: tilt the second one, to about 45°")
    return (reading_tilted - reading_level) / sin(tilt)


def tempco_from_two_temperatures(
    reading_1: float, reading_2: float, temperature_1: float, temperature_2: float
) -> float:
    """Temperature coefficient of the zero offset from level readings at two temperatures.

    Raises
    ------
    EstimateError
        The temperatures are equal.

    Notes
    -----
    A Solid State Tilt Meter, section C: a linear fit to two points, typically 24 °C and 5.5 °C.
    """
    if temperature_1 == temperature_2:
        raise EstimateError(
            f"two readings at the same temperature ({temperature_1} °C) cannot determine a temperature coefficient"
        )
    return (reading_1 - reading_2) / (temperature_1 - temperature_2)


def referenced_reading(reading: float, temperature: float, tempco: float, reference: float = 0.0) -> float:
    """Return what a reading would be at the reference temperature.

    Notes
    -----
    A Solid State Tilt Meter, section C, whose reference is 0 °C.
    """
    return reading - tempco * (temperature - reference)


def referenced_tilt(
    reading: float, temperature: float, offset: float, scale: float, tempco: float, reference: float = 0.0
) -> float:
    """Tilt of one axis from the paper's coefficients: two per axis, four per sensor, and the offset at level.

    NaN where the argument of the arcsine is beyond ±1.

    Parameters
    ----------
    offset : float
        Reading at level, itself referenced to the reference temperature.
    scale, tempco : float
        From :func:`scale_from_tilt` and :func:`tempco_from_two_temperatures`.

    Notes
    -----
    A Solid State Tilt Meter, section C: the reading is referenced to 0 °C, the offset is subtracted, the scale factor
    applied and the arcsine run. Its section A asks that the arcsine be trapped near 90°.
    """
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
