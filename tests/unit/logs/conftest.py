"""What the tests of several modules start from."""

import pytest
from support import FIXTURES

from tiltcal.library.calibration import Calibration, read


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    """A calibration in counts with a drift: offset, sensitivity and temperature of both axes."""
    found = read(FIXTURES / "mavs.yaml")
    assert isinstance(found, Calibration)
    return found
