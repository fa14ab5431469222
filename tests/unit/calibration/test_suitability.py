"""A procedure that a sensor cannot serve is refused before anything is measured."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tiltcal.calibration.suitability import require_suitable
from tiltcal.drivers import find_model
from tiltcal.errors import UsageError
from tiltcal.files.procedure import find_procedure

INCLINOMETER = find_model("sca100t-d01")
"""1024 count and 1638 count/g, and a word below 102 is none."""


def test_an_angle_beyond_the_lower_rail_is_refused() -> None:
    """1024 - 1638 sin 34° is 108, and 1024 - 1638 sin 35° is 84.5."""
    require_suitable(find_procedure("plane", 34.0), INCLINOMETER)
    with pytest.raises(UsageError, match=r"would read about 84\.482 count, .* a smaller --tilt brings it in range"):
        require_suitable(find_procedure("plane", 35.0), INCLINOMETER)


def test_a_sensitivity_has_to_come_from_somewhere() -> None:
    unknown, procedure = replace(INCLINOMETER, scaled=False), find_procedure("two-temperature")
    with pytest.raises(UsageError, match=r"that of sca100t-d01 is not known: state it in the address"):
        require_suitable(procedure, unknown)
    require_suitable(procedure, unknown, based=True)
    require_suitable(find_procedure("plane", 20.0), unknown)


def test_what_reads_no_gravity_is_refused() -> None:
    with pytest.raises(UsageError, match="plane takes tilt sensors"):
        require_suitable(find_procedure("plane", 20.0), find_model("gradiometer"))
