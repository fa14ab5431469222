"""A calibration as a C99 header in single precision, without allocation.

It holds all of a calibration: temperature, nonlinearity, the third component that two channels do not measure, the
mounting.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.compensation import CLIP_LIMIT, LONGEST, SHORTEST, Compensation
from tiltcal.core.model import NEWTON_STEPS, Array, Coefficients
from tiltcal.export.affine import affine_of

SINGLE = 2.0**-24  # the largest relative error of a rounding in single precision
_ROUNDINGS = 8.0  # roundings behind those of a reading and its offset, of terms that are no larger than 1 g


def header(name: str, origin: str, text: Iterable[str]) -> str:
    """Return a header file of a name, with the lines between its guards."""
    guard = f"{name.upper()}_H"
    lines = [f"/* {origin} */", f"#ifndef {guard}", f"#define {guard}", "", *text, "", f"#endif /* {guard} */", ""]
    return "\n".join(lines)


def single_precision(coefficients: Coefficients, name: str) -> Iterator[str]:
    """Yield the lines of the functions in single precision: gravity, the tilts and, of three axes, pitch and roll."""
    compensation = Compensation(coefficients)
    channels, axes = len(coefficients.channels), len(compensation.axes)
    yield from ("#include <math.h>", "", *sizes(name, channels, axes), "")
    yield f"/* Gravity along {', '.join(compensation.axes)}, g, of readings; celsius: NAN where it is not known. */"
    yield f"static inline void {name}_g(const float u[{name}_CHANNELS], float celsius, float g[{name}_AXES])"
    yield "{"
    yield from (f"    {line}" for line in _gravity(coefficients, compensation))
    yield from ("}", "")
    yield from _degrees(name, axes)


def single_precision_rounding(coefficients: Coefficients, up: Array, readings: Array) -> Array:
    """Return how far each component of gravity may be off by the roundings of single precision, g, shape (axes,).

    ``up`` and ``readings`` are those of the calibrated range, shapes (n, 3) and (n, channels).
    """
    compensation, affine = Compensation(coefficients), affine_of(coefficients)
    rounding = SINGLE * (np.abs(affine.matrix) @ (np.abs(readings).max(axis=0) + np.abs(affine.offset)) + _ROUNDINGS)
    if compensation.solves_z:
        # The root of a small difference: its error grows towards the rim, where it is the root of the rounding.
        largest = rounding.max()
        hidden = largest / max(float(np.abs(up[:, 2]).min()), np.sqrt(largest))
        rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
        rounding = rounding + np.abs(rotation[:2, 2] - rotation[:2, :2] @ compensation.coupling) * hidden
    return np.asarray(rounding)


def sizes(name: str, channels: int, axes: int) -> list[str]:
    """Return the macros of the sizes, in capitals too, as is the custom in C."""
    macros = {"CHANNELS": channels, "AXES": axes}
    return [
        f"#define {one}_{size} {count}" for one in dict.fromkeys((name, name.upper())) for size, count in macros.items()
    ]


def _gravity(coefficients: Coefficients, compensation: Compensation) -> Iterator[str]:
    thermal, bent, angles = coefficients.thermal, coefficients.nonlinearity, coefficients.angles
    if thermal is None:
        yield "(void)celsius;"
    else:
        reference = float_constant(thermal.reference)
        yield f"const float dt = celsius == celsius ? celsius - {reference} : 0.0f; /* at {thermal.reference:g} °C */"
    for k, offset in enumerate(coefficients.offset):
        reading = f"u[{k}]"
        if angles is not None and angles.slope:
            reading = f"atanf({reading} / {float_constant(angles.slope)}) * 57.29577951f"
        line = f"{reading} - {float_constant(offset)}"
        if thermal is not None and thermal.drift[k].any():
            line += f" - {_polynomial(thermal.drift[k])}"
        if thermal is not None and thermal.gain[k].any():
            line = f"({line}) / (1.0f + {_polynomial(thermal.gain[k])})"
        straight = angles is None and (bent is None or not bent[k].any())
        yield f"{'const ' * straight}float v{k} = {line};"
        if bent is not None and bent[k].any():
            yield from _straightened(f"v{k}", coefficients.own_sensitivity(coefficients.channels[k]), bent[k])
    if angles is not None:
        yield from _components_of_angles(coefficients, angles)
    names = [f"v{k}" for k in range(len(coefficients.channels))]
    if not compensation.solves_z:
        rotation = np.eye(len(compensation.axes)) if compensation.rotation is None else compensation.rotation
        for axis, row in enumerate(rotation @ compensation.inverse):
            yield f"g[{axis}] = {_sum(row, names)};"
        return
    yield from (f"float p{k} = {_sum(row, names)};" for k, row in enumerate(compensation.inverse))
    yield from _third_component(compensation)
    rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
    for axis, row in enumerate(rotation[:2]):
        yield f"g[{axis}] = {_sum(row, ['p0', 'p1', 'z'])};"


def _components_of_angles(coefficients: Coefficients, angles: AngleReadings) -> Iterator[str]:
    """Yield the lines that make components of angles, which wrap, and are none beyond 91 degrees."""
    sizes = np.linalg.norm(coefficients.sensitivity, axis=1)
    for k, size in enumerate(sizes):
        yield f"v{k} = remainderf(v{k} / {float_constant(size)}, 360.0f);"
        yield f"v{k} = fabsf(v{k}) <= 91.0f ? fmaxf(-90.0f, fminf(90.0f, v{k})) * 0.01745329252f : NAN;"
    pitch = coefficients.channels.index("x") if angles.euler and "x" in coefficients.channels else -1
    for k in sorted(range(len(sizes)), key=lambda k: k == pitch):
        roll = f" * cosf(v{pitch})" if pitch >= 0 and coefficients.channels[k] == "y" else ""
        yield f"v{k} = {float_constant(sizes[k])} * sinf(v{k}){roll};"


def _straightened(signal: str, own: float, shares: Array) -> Iterator[str]:
    """Yield the lines that take the nonlinearity out of a signal, by Newton's method."""
    powers, slopes = _polynomial(shares, "a"), _polynomial(shares * np.arange(2, 2 + len(shares)), "a")
    yield f"{signal} /= {float_constant(own)};"
    yield f"{{ float a = {signal};"
    yield f"  for (int step = 0; step < {NEWTON_STEPS}; ++step)"
    yield f"      a -= (a * (1.0f + {powers}) - {signal}) / (1.0f + {slopes});"
    yield f"  {signal} = {float_constant(own)} * a; }}"


def _third_component(compensation: Compensation) -> Iterator[str]:
    """Yield the lines that solve for the component that two channels do not measure, by the unit length of gravity."""
    q = compensation.coupling
    curvature, side, bound = (
        float_constant(float(1.0 + q @ q)),
        "-" if compensation.upside_down else "+",
        "> 0.0f" if compensation.upside_down else "< 0.0f",
    )
    yield f"const float along = {_sum(q, ['p0', 'p1'])};"
    yield f"const float root = along * along - {curvature} * (p0 * p0 + p1 * p1 - 1.0f);"
    yield f"float z = root < 0.0f ? 0.0f : (along {side} sqrtf(root)) / {curvature};"
    yield f"if (z {bound}) z = 0.0f;"
    if q.any():
        yield from (f"p{k} -= {float_constant(q[k])} * z;" for k in range(2))


def _degrees(name: str, axes: int) -> Iterator[str]:
    readings = f"const float u[{name}_CHANNELS], float celsius"
    signature = f"static inline void {name}_degrees({readings}, float degrees[{name}_AXES])"
    if axes < 3:
        yield f"/* The tilt of each axis; an arcsine of up to {CLIP_LIMIT} gives 90 degrees, beyond it NAN. */"
        yield from (signature, "{", f"    float g[{name}_AXES];", f"    {name}_g(u, celsius, g);")
        yield f"    for (int k = 0; k < {name}_AXES; ++k)"
        clipped = "g[k] > 1.0f ? 90.0f : g[k] < -1.0f ? -90.0f : asinf(g[k]) * 57.29577951f"
        yield f"        degrees[k] = fabsf(g[k]) <= {CLIP_LIMIT}f ? ({clipped}) : NAN;"
        yield "}"
        return
    limits = f"s >= {float_constant(SHORTEST**2)} && s <= {float_constant(LONGEST**2)} ? 57.29577951f : NAN"
    yield f"/* The factor to degrees; NAN where gravity is shorter than {SHORTEST} g or longer than {LONGEST:g} g. */"
    yield f"static inline float {name}_judged(const float g[{name}_AXES])"
    yield from ("{", "    const float s = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];", f"    return {limits};", "}", "")
    begin = [f"    float g[{name}_AXES];", f"    {name}_g(u, celsius, g);", f"    const float to = {name}_judged(g);"]
    yield from ("/* The tilt of each axis. */", signature, "{", *begin)
    for k, (one, other) in enumerate(((1, 2), (0, 2), (0, 1))):
        yield f"    degrees[{k}] = to * atan2f(g[{k}], sqrtf(g[{one}] * g[{one}] + g[{other}] * g[{other}]));"
    yield from ("}", "", "/* Pitch and roll over the full circle, degrees. */")
    yield f"static inline void {name}_pitch_roll({readings}, float *pitch, float *roll)"
    yield from ("{", *begin, "    *pitch = to * atan2f(g[0], sqrtf(g[1] * g[1] + g[2] * g[2]));")
    yield from ("    *roll = to * atan2f(g[1], g[2]);", "}")


def _sum(row: Array, names: list[str]) -> str:
    """Return a sum of products as C."""
    terms = [f"{float_constant(value)} * {name}" for value, name in zip(row, names, strict=True) if value]
    return " + ".join(terms) or "0.0f"


def _polynomial(shares: Array, variable: str = "dt") -> str:
    """Return a polynomial without a constant term as C, by Horner's rule."""
    text = ""
    for value in shares[::-1]:
        text = f"{variable} * ({float_constant(value)} + {text})" if text else f"{variable} * {float_constant(value)}"
    return text


def float_constant(value: float) -> str:
    """Return a number as a constant in single precision."""
    text = f"{value:.9g}"
    return (text if set(text) & set(".e") else f"{text}.0") + "f"
