"""A mounting that the user states: what the compensation makes of it, and what stays of the file."""

import numpy as np
import pytest
from support import FIXTURES

import tiltcal

MOUNTED = FIXTURES / "mounting.yaml"


def test_a_mounting_of_the_file_is_replaced_and_no_longer_uncertain() -> None:
    mounted = tiltcal.read(MOUNTED)
    turned = mounted.with_mounting("roll=180")
    assert np.degrees(turned.coefficients.mounting.roll) == pytest.approx(180.0)
    assert turned.coefficients.mounting.pitch == 0.0
    assert not [name for name in (*turned.uncertainty, *turned.uncertainty.covariance.parameters) if "mounting" in name]
    own = mounted.uncertainty.covariance
    left = turned.uncertainty.covariance
    kept = [own.parameters.index(name) for name in left.parameters]
    np.testing.assert_array_equal(np.array(own.matrix)[np.ix_(kept, kept)], left.matrix)
    assert turned.fit.mounting is None
    assert len(turned.positions) < len(mounted.positions)


def test_angles_that_are_none_are_refused() -> None:
    for angles, why in (
        ({"heading": 3.0}, "has no angle 'heading'"),
        ("pitch=91", "between -90 and 90 for pitch"),
        ("roll", "takes pairs, not 'roll'"),
        ("roll=1,roll=2", "names roll twice"),
        ({"yaw": float("nan")}, "between -180 and 180 for yaw"),
    ):
        with pytest.raises(tiltcal.UsageError, match=why):
            tiltcal.read(MOUNTED).with_mounting(angles)
