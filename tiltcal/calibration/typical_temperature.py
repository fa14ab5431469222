"""Temperature curves of a model's mean part, where a unit's own temperature run is missing.

They are a starting point: what one part does differs from the mean, and the file states by how much. A unit's own run
always wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial

from tiltcal.calibration.calibrate import Measurement
from tiltcal.core.model import Array, Thermal
from tiltcal.core.rounding import round_to, significant
from tiltcal.drivers.device import Population
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord

ROOM = 25.0
"""Where nobody measured the temperature the calibration was made at, °C."""


def with_typical_temperature(
    calibration: CalibrationRecord, measurements: Sequence[Measurement], population: Population
) -> CalibrationRecord:
    """A calibration that follows the mean part over temperature, and says so.

    Parameters
    ----------
    calibration : CalibrationRecord
        Without temperature terms of its own.
    measurements : sequence of Measurement
        Their mean temperature is the reference: there the unit was measured.
    population : Population

    Raises
    ------
    EstimateError
        The calibration has temperature terms of its own, which are better.
    """
    coefficients = calibration.coefficients
    if coefficients.thermal is not None:
        raise EstimateError("the unit's own temperature run is in this calibration: leave --typical-temperature out")
    known = [m.temperature for m in measurements if m.temperature is not None]
    reference = round(float(np.mean(known)), 3) if known else ROOM
    drift = _from(population.drift, reference)[1:]
    gain = _from(population.gain, reference)
    relative = gain[1:] / (1.0 + gain[0])
    channels = coefficients.channels
    thermal = Thermal(
        reference=reference,
        range=None,
        drift=np.tile([round_to(k, population.drift_spread / 1000) for k in drift], (len(channels), 1)),
        gain=np.tile([significant(k, 8) for k in relative], (len(channels), 1)),
    )
    doubt = {
        "offset": {c: [significant(population.drift_spread, 4), *(len(drift) - 1) * [0.0]] for c in channels},
        "sensitivity": {c: [significant(population.gain_spread, 4), *(len(relative) - 1) * [0.0]] for c in channels},
    }
    assumed = [*calibration.derived.get("assumed", []), f"temperature: {population.source}, not this unit's own"]
    return replace(
        calibration,
        coefficients=replace(coefficients, thermal=thermal),
        uncertainty={**calibration.uncertainty, "temperature": doubt},
        derived={**calibration.derived, "assumed": assumed},
    )


def _from(curve: Sequence[float], reference: float) -> Array:
    """Coefficients of a polynomial in T as one in T - reference."""
    return np.asarray(Polynomial(curve)(Polynomial([reference, 1.0])).coef, dtype=float)
