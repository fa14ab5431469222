"""A calibration as a C99 header in integers alone: the affine map, and its drift and gain with temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, log2

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array, Coefficients, Thermal
from tiltcal.errors import UsageError
from tiltcal.export.affine import affine_of
from tiltcal.export.c_header import sizes

Whole = NDArray[np.int64]

_SIGNAL_BITS, _MATRIX_BITS, _GAIN_BITS, _STEP_BITS = 38, 22, 24, 15
"""Of a reading without its offset, an element of A, and behind the point of the gain; 327.68 °C count as 1."""

_LARGEST_TERM = 2.0**46  # a coefficient of a polynomial that is larger overflows in 64 bits


@dataclass(frozen=True)
class Integers:
    """The affine map of a calibration in integers, and its temperature terms.

    Readings are in the unit of the calibration times ``per_unit``, temperatures in 0.01 °C, gravity in µg.

    signal_bits, matrix_bits: behind the binary point of a reading without its offset, and of an element of A.
    matrix: A, µg a reading, shape (axes, channels). reference: 0.01 °C.
    offset: b and its drift by the powers of the temperature difference over 327.68 °C, shape (channels, 1 + order).
    gain: by the same powers, shape (channels, order).
    """

    per_unit: int
    signal_bits: int
    matrix_bits: int
    matrix: Whole
    offset: Whole
    gain: Whole
    reference: int

    @classmethod
    def of(cls, coefficients: Coefficients, per_unit: int, largest: float) -> Integers:
        """Return the integers of a calibration; ``largest`` is its largest reading.

        UsageError: a temperature term is too large for 64 bits.
        """
        affine = affine_of(coefficients)
        none = np.zeros((len(affine.offset), 0))
        thermal = coefficients.thermal or Thermal(0.0, None, none, none)
        reach = float(np.max(largest + np.abs(affine.offset))) * per_unit
        signal_bits = max(0, _SIGNAL_BITS - ceil(log2(reach)))
        scaled = affine.matrix * 1e6 / per_unit
        matrix_bits = _MATRIX_BITS - ceil(log2(np.abs(scaled).max()))
        powers = [(2.0**_STEP_BITS / 100.0) ** np.arange(1, one.shape[1] + 1) for one in (thermal.drift, thermal.gain)]
        terms = np.column_stack([affine.offset, thermal.drift * powers[0]]) * per_unit * 2.0**signal_bits
        gains = thermal.gain * powers[1] * 2.0**_GAIN_BITS
        if max(np.abs(terms).max(), np.abs(gains).max(initial=0.0)) > _LARGEST_TERM:
            raise UsageError("a temperature term is too large for integers of 64 bits: leave --fixed out")
        matrix, offset, gain = (np.rint(one).astype(np.int64) for one in (scaled * 2.0**matrix_bits, terms, gains))
        return cls(per_unit, signal_bits, matrix_bits, matrix, offset, gain, round(thermal.reference * 100.0))

    def __call__(self, readings: Array, temperature: Array) -> Array:
        """Return gravity, shape (n, axes), g, as the header computes it."""
        u = np.rint(readings * self.per_unit).astype(np.int64)
        dt = np.rint(temperature * 100.0).astype(np.int64) - self.reference
        signal = (u << self.signal_bits) - np.column_stack([_horner(row[1:], dt) + row[0] for row in self.offset])
        gain = np.column_stack([_horner(row, dt) for row in self.gain])
        signal = _quotient(signal << _GAIN_BITS, (1 << _GAIN_BITS) + gain)
        return np.asarray(_shifted(signal @ self.matrix.T, self.signal_bits + self.matrix_bits) * 1e-6)

    def lines(self, name: str) -> Iterator[str]:
        """Yield the lines of the header."""
        axes, channels = self.matrix.shape
        yield from ("#include <stdint.h>", "", *sizes(name, channels, axes), "")
        yield "/* v / 2^bits, rounded to the nearest. */"
        yield f"static inline int64_t {name}_shifted(int64_t v, int bits)"
        yield from ("{", "    const int64_t half = bits > 0 ? INT64_C(1) << (bits - 1) : 0;")
        yield from ("    return v < 0 ? -((half - v) >> bits) : (v + half) >> bits;", "}", "")
        unit = "in the unit of the calibration" if self.per_unit == 1 else f"in 1/{self.per_unit} of its unit"
        yield f"/* Gravity, millionths of 1 g, of readings {unit}, at a temperature in 0.01 °C. */"
        yield f"static inline void {name}_g_fixed(const int32_t u[], int16_t centicelsius, int32_t micro_g[])"
        yield "{"
        if self.offset.shape[1] > 1 or self.gain.shape[1]:
            yield f"    const int64_t dt = (int64_t)centicelsius - {self.reference};"
        else:
            yield "    (void)centicelsius;"
        for k, row in enumerate(self.offset):
            yield f"    int64_t v{k} = (int64_t)u[{k}] * (INT64_C(1) << {self.signal_bits}) - {_integer(row[0])};"
            if row[1:].any():
                yield f"    v{k} -= {_integer_polynomial(row[1:], name)};"
            if self.gain[k].any():
                one = f"(INT64_C(1) << {_GAIN_BITS})"
                yield f"    v{k} = v{k} * {one} / ({one} + {_integer_polynomial(self.gain[k], name)});"
        bits = self.signal_bits + self.matrix_bits
        for axis, row in enumerate(self.matrix):
            terms = " + ".join(f"{_integer(value)} * v{k}" for k, value in enumerate(row))
            yield f"    micro_g[{axis}] = (int32_t){name}_shifted({terms}, {bits});"
        yield "}"


def _integer(value: int) -> str:
    return f"INT64_C({value})"


def _integer_polynomial(row: Whole, name: str) -> str:
    text = ""
    for value in row[::-1]:
        inner = f"({_integer(value)} + {text})" if text else _integer(value)
        text = f"{name}_shifted(dt * {inner}, {_STEP_BITS})"
    return text


def _horner(row: Whole, dt: Whole) -> Whole:
    total = np.zeros(len(dt), np.int64)
    for value in row[::-1]:
        total = _shifted(dt * (value + total), _STEP_BITS)
    return total


def _shifted(values: Whole, bits: int) -> Whole:
    half = (1 << bits) >> 1
    return np.asarray(np.where(values < 0, -((half - values) >> bits), (values + half) >> bits))


def _quotient(dividend: Whole, divisor: Whole) -> Whole:
    """Return a quotient that is cut off towards zero, as in C."""
    return np.asarray(np.sign(dividend) * (np.abs(dividend) // divisor))
