"""The terms of noise that an Allan variance shows."""

from __future__ import annotations

import numpy as np
import pytest

import tiltcal


def test_noise_beyond_any_number_is_refused() -> None:
    """The square of 1e300 is no double."""
    readings = {"x": 1e300 * np.random.default_rng(1).normal(1.0, 1.0, 300)}
    with (
        np.errstate(all="ignore"),
        pytest.raises(tiltcal.TiltcalError, match="the Allan variance is zero or beyond any number"),
    ):
        tiltcal.noise(readings, rate=1.0, unit="count")
