"""A calibration as a module of Python without imports but ``math``, which MicroPython and CircuitPython run too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tiltcal.core.compensation import CLIP_LIMIT, LONGEST, SHORTEST, Compensation
from tiltcal.core.model import NEWTON_STEPS, Coefficients
from tiltcal.core.thermal_lag import LOG_SMOOTHING

FORMULA = (
    "v = (u - offset - drift(dT)) / (1 + gain(dT)), dT = temperature - reference; by channel a (1 + n2 a + n3 a^2) = "
    "v / own, v = own a; p = inverse v; where coupling is there, z of p - coupling z has (p - coupling z)^2 + z^2 = 1, "
    "up or, upside_down, down; g = rotation p; where it reads angles, v = size sin(v / size) before the "
    "inverse, of roll cos(pitch) times that, and u of a slope is atan(u / slope), all in degrees"
)
"""What the numbers of :func:`numbers` are for."""

_GRAVITY = """
NAN = float("nan")

def polynomial(shares, x):
    total = 0.0
    for share in reversed(shares):
        total = x * (share + total)
    return total

def g(u, celsius=None):
    dt = 0.0 if celsius is None or celsius != celsius else celsius - reference
    v = []
    for k in range(len(offset)):
        read = math.degrees(math.atan(u[k] / slope)) if slope else u[k]
        s = (read - offset[k] - polynomial(drift[k], dt)) / (1.0 + polynomial(gain[k], dt))
        if nonlinearity[k]:
            s /= own[k]
            a = s
            slopes = [(n + 2) * share for n, share in enumerate(nonlinearity[k])]
            for step in range(STEPS):
                a -= (a * (1.0 + polynomial(nonlinearity[k], a)) - s) / (1.0 + polynomial(slopes, a))
            s = own[k] * a
        v.append(s)
    if size:
        a = [(v[k] / size[k] + 180.0) % 360.0 - 180.0 for k in range(len(v))]
        if not all([abs(one) <= 91.0 for one in a]):
            return [NAN] * len(a)
        a = [math.radians(max(-90.0, min(90.0, one))) for one in a]
        v = [size[k] * math.sin(a[k]) * (math.cos(a[1 - k]) if k == roll else 1.0) for k in range(len(a))]
    p = product(inverse, v)
    if coupling:
        along = coupling[0] * p[0] + coupling[1] * p[1]
        bend = 1.0 + coupling[0] ** 2 + coupling[1] ** 2
        root = along * along - bend * (p[0] ** 2 + p[1] ** 2 - 1.0)
        side = -1.0 if upside_down else 1.0
        z = (along + side * math.sqrt(root)) / bend if root > 0.0 else 0.0
        z = z if z * side > 0.0 else 0.0
        p = [p[0] - coupling[0] * z, p[1] - coupling[1] * z, z]
    return product(rotation, p)[: len(offset)]

def product(matrix, vector):
    return [sum([row[k] * vector[k] for k in range(len(vector))]) for row in matrix]
"""

_TILTS = f"""
def degrees(u, celsius=None):  # the tilt of each axis; an arcsine of up to {CLIP_LIMIT} gives 90, beyond it NAN
    return [tilt(one) for one in g(u, celsius)]

def tilt(one):
    return math.degrees(math.asin(max(-1.0, min(1.0, one)))) if abs(one) <= {CLIP_LIMIT} else NAN
"""

_TILTS_OF_THREE = f"""
def degrees(u, celsius=None):  # the tilt of each axis; NAN where gravity is not {SHORTEST} to {LONGEST} g long
    x, y, z = judged(u, celsius)
    return [above(x, y, z), above(y, x, z), above(z, x, y)]

def pitch_roll(u, celsius=None):
    x, y, z = judged(u, celsius)
    return above(x, y, z), math.degrees(math.atan2(y, z))

def judged(u, celsius):
    one = g(u, celsius)
    return one if {SHORTEST**2} <= sum([c * c for c in one]) <= {LONGEST**2} else [NAN] * 3

def above(one, other, third):
    return math.degrees(math.atan2(one, math.sqrt(other * other + third * third)))
"""

_ELEMENT = """
last = []  # seconds and temperature of the reading before, and the temperature of the filter

def element(seconds, celsius):
    '''The temperature of the sensing element, for g(); call it for each reading, in order.'''
    filtered = celsius
    if last and seconds > last[0]:
        x = (seconds - last[0]) / CONSTANT
        decay = math.exp(-x)
        mean = (1.0 - decay) / x
        filtered = decay * last[2] + (mean - decay) * last[1] + (1.0 - mean) * celsius
    last[:] = [seconds, celsius, filtered]
    return FILTERED
"""


def numbers(coefficients: Coefficients) -> Mapping[str, Any]:
    """Return all of a calibration, by the names of :data:`FORMULA`, as plain data."""
    compensation, thermal, bent = Compensation(coefficients), coefficients.thermal, coefficients.nonlinearity
    none: list[list[float]] = [[] for _ in coefficients.channels]
    axes = 3 if compensation.solves_z else len(compensation.axes)
    rotation = np.eye(axes) if compensation.rotation is None else compensation.rotation
    angles = coefficients.angles
    sizes = [] if angles is None else np.linalg.norm(coefficients.sensitivity, axis=1).tolist()
    rolls = angles is not None and angles.euler and len(coefficients.channels) == 2
    return {
        "size": sizes,
        "slope": 0.0 if angles is None else angles.slope,
        "roll": coefficients.channels.index("y") if rolls else -1,
        "offset": coefficients.offset.tolist(),
        "reference": 0.0 if thermal is None else float(thermal.reference),
        "drift": none if thermal is None else thermal.drift.tolist(),
        "gain": none if thermal is None else thermal.gain.tolist(),
        "lag": 0.0 if thermal is None else float(thermal.lag),
        "own": [float(coefficients.own_sensitivity(channel)) for channel in coefficients.channels],
        "nonlinearity": none if bent is None else [shares.tolist() if shares.any() else [] for shares in bent],
        "inverse": compensation.inverse.tolist(),
        "coupling": compensation.coupling.tolist() if compensation.solves_z else [],
        "upside_down": bool(compensation.upside_down),
        "rotation": rotation.tolist(),
    }


def module(coefficients: Coefficients, origin: str, unit: str) -> Iterator[str]:
    """Yield the parts of the module."""
    values = dict(numbers(coefficients))
    lag = values.pop("lag")
    yield f'"""{origin}: g(u, celsius) and degrees(u, celsius) of one reading u in {unit}."""\nimport math\n\n'
    yield from (f"{name} = {value!r}\n" for name, value in values.items())
    yield _GRAVITY.replace("STEPS", str(NEWTON_STEPS))
    yield _TILTS_OF_THREE if len(coefficients.channels) == 3 else _TILTS
    if lag:
        later = f"celsius + (celsius - filtered) / {LOG_SMOOTHING}"
        constant = lag if lag > 0.0 else -LOG_SMOOTHING * lag
        yield _ELEMENT.replace("CONSTANT", repr(constant)).replace("FILTERED", "filtered" if lag > 0.0 else later)
