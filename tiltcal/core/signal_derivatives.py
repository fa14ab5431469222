"""The derivatives of the signals of all channels by their coefficients, at a given reading.

The reading of a channel is ``u = offset + drift(dT) + (1 + gain(dT)) s B(s / s_own)`` with the signal ``s = S g`` and
the nonlinearity ``B(a) = 1 + n_2 a + n_3 a² + ...``. With the slope w, one over the derivative of the reading by s,
errors of the coefficients change the signal that belongs to a reading by::

    -ds = w (d offset + dT^k d drift_k + s B dT^k d gain_k + s_own (1 + gain) a^k d n_k) + g_j dS_j

where dS of the channel's own axis, in place of g, has what the nonlinearity adds. Channels share most of these
derivatives: without gain and nonlinearity w is 1. Each different one is a row of a table, and is computed once.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tiltcal.core.model import Array, ChannelModel, Coefficients, nonlinearity_slope, polynomial

_Key = tuple[str, str, str]
"""What a row holds, of which channel (empty for all alike), and of which axis or power."""


class SignalDerivatives:
    """The table of derivatives of a sensor's signals.

    Parameters
    ----------
    names : collection of str
        Dotted names of the coefficients whose derivatives are needed; those of other things do not matter.

    Attributes
    ----------
    rows : mapping of str to int
        The row of each coefficient that is needed.
    slopes : list of int
        The row of the slope w of each channel.
    count : int
        Number of rows.
    """

    def __init__(self, coefficients: Coefficients, names: Collection[str]) -> None:
        self._coefficients = coefficients
        places: dict[_Key, int] = {}
        self.rows: dict[str, int] = {}
        self.slopes: list[int] = []
        self._own: list[list[tuple[_Key, int]]] = []
        for model in coefficients.models:
            first = len(places)
            self.slopes.append(places.setdefault(_key(model, model.coefficients[0]), len(places)))
            for name in model.coefficients:
                if name in names:
                    self.rows[name] = places.setdefault(_key(model, name), len(places))
            self._own.append(list(places.items())[first:])
        self.count = len(places)

    def __call__(self, along: Array, linear: Array, dt: Array | None, table: Array) -> list[Array]:
        """Fill the table, and return the signal of each channel with its nonlinearity.

        Parameters
        ----------
        along : ndarray, shape (axes, n)
            Gravity along the axes of the coefficients, g.
        linear : ndarray, shape (channels, n)
            The signals S g without nonlinearity, unit.
        dt : ndarray, shape (n,), or None
            Temperature from the reference, °C; None for 0.
        table : ndarray, shape (count, n)
        """
        coefficients = self._coefficients
        powers: Array | float = 0.0 if dt is None else dt
        return [
            _fill(model, theta, own, along, signal, powers, table)
            for model, theta, own, signal in zip(
                coefficients.models, coefficients.vectors, self._own, linear, strict=True
            )
        ]


def _key(model: ChannelModel, name: str) -> _Key:
    """Return what distinguishes the row of a coefficient from others; the same for channels that share it."""
    own = model.name if model.gain or model.nonlinearity else ""
    match name.split("."):
        case ["offset", _]:
            return "slope", own, ""
        case ["sensitivity", channel, axis]:
            return "along", channel if model.nonlinearity and axis == channel else "", axis
        case ["temperature", "offset", _, power]:
            return "drift", own, power
        case ["temperature", _, channel, power]:
            return "gain", channel, power
        case [kind, channel, power]:
            return kind, channel, power
    raise ValueError(name)


def _fill(
    model: ChannelModel,
    theta: Array,
    own: list[tuple[_Key, int]],
    along: Array,
    signal: Array,
    dt: Array | float,
    table: Array,
) -> Array:
    """Fill the rows that a channel is the first to have; return its signal with its nonlinearity."""
    sensitivity, _, gain, shares = model.split(theta)
    scale = 1.0 + polynomial(gain, np.asarray(dt)) if model.gain else 1.0
    a, own_signal = signal, 1.0
    bend: Array | float = 1.0
    steepness: Array | float = 1.0
    if model.nonlinearity:
        own_signal = sensitivity[model.axes.index(model.name)]
        a = signal / own_signal if own_signal else np.zeros_like(signal)
        bend, steepness = 1.0 + polynomial(shares, a), nonlinearity_slope(shares, a)
        signal = signal * bend
    slope = 1.0 / (scale * steepness)
    for (kind, _, detail), row in own:
        out = table[row]
        match kind:
            case "slope":
                out[...] = slope
            case "along":
                out[...] = along[model.axes.index(detail)]
                if model.nonlinearity and detail == model.name:
                    out += a * (bend - steepness) / steepness
            case "drift":
                np.multiply(slope, _power(dt, int(detail)), out=out)
            case "gain":
                np.multiply(slope, _power(dt, int(detail)), out=out)
                out *= signal
            case _:
                np.multiply(_power(a, int(detail)), own_signal / steepness, out=out)
    return signal


def _power(base: Array | float, exponent: int) -> Array | float:
    """Return a power by multiplication, which takes a tenth of the time of ``**`` beyond the square."""
    power = base
    for _ in range(exponent - 1):
        power = power * base
    return power
