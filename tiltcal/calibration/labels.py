"""Labels of the coefficients: words, symbols and units for their dotted names."""

from __future__ import annotations

_POWERS = {"1": "", "2": "²", "3": "³"}
_SHAPES = {"2": "square", "3": "cube"}


def words(name: str) -> str:
    """Return a coefficient in words, such as ``Sensitivity of x to y`` for ``sensitivity.x.y``."""
    match name.split("."):
        case ["offset", channel]:
            return f"Offset of {channel}"
        case ["sensitivity", channel, axis] if channel == axis:
            return f"Sensitivity of {channel}"
        case ["sensitivity", channel, axis]:
            return f"Sensitivity of {channel} to {axis}"
        case ["nonlinearity", channel, power]:
            return f"Nonlinearity of {channel}, {_SHAPES.get(power, power)}"
        case ["temperature", "offset", channel, power]:
            return f"Drift of offset {channel}, ΔT{_raised(power)}"
        case ["temperature", "sensitivity", channel, power]:
            return f"Drift of sensitivity {channel}, ΔT{_raised(power)}"
        case ["mounting", "turn", axis]:
            return f"Turn of the mounting about {axis}"
    return name


def symbol(name: str) -> tuple[str, str]:
    """Return a coefficient's letter and its index, such as ``S`` and ``xy``."""
    match name.split("."):
        case ["offset", channel]:
            return "u", f"0{channel}"
        case ["sensitivity", channel, axis]:
            return "S", channel + axis
        case ["nonlinearity", channel, power]:
            return "n", channel + power
        case ["temperature", "offset", channel, power]:
            return "d", channel + power
        case ["temperature", "sensitivity", channel, power]:
            return "e", channel + power
        case ["mounting", "turn", axis]:
            return "r", axis
    return name, ""


def unit_of(name: str, unit: str) -> str:
    """Return the unit of a coefficient of a sensor whose readings have ``unit``; empty for a pure number.

    ValueError: there is no such coefficient.
    """
    match name.split("."):
        case ["offset", _]:
            return unit
        case ["sensitivity", *_]:
            return f"{unit}/g"
        case ["mounting", "turn", _]:
            return "°"
        case ["temperature", "lag"]:
            return "s"
        case ["nonlinearity", *_]:
            return ""
        case ["temperature", kind, _, power]:
            return f"{unit if kind == 'offset' else '1'}/°C{_raised(power)}"
    raise ValueError(f"there is no coefficient {name!r}")


def _raised(power: str) -> str:
    return _POWERS.get(power, f"^{power}")
