"""What a calibration makes of one reading, at which address, and for which sensor."""

from dataclasses import replace
from math import radians, sin

import pytest
from support import FIXTURES

from tiltcal.bench.live import LiveTilt, TiltOfReadings, as_calibrated, require_as_calibrated
from tiltcal.drivers import find_model
from tiltcal.drivers.model import Reading
from tiltcal.errors import InputError
from tiltcal.files.bench import BenchSensor
from tiltcal.files.calibration import read_calibration
from tiltcal.files.results import BenchRecord

PLANE = read_calibration(FIXTURES / "plane.yaml")
FITTED = PLANE.provenance.replaced(bench=None)
FILED = "i2c:///dev/i2c-1?address=0x1d&counts_per_g=900&rate=50"
OTHER = replace(
    PLANE,
    sensor=PLANE.sensor.replaced(model="sca3000-i2c"),
    provenance=PLANE.provenance.replaced(bench=BenchRecord(address=FILED)),
)


@pytest.mark.parametrize(
    ("address", "joined"),
    [("i2c:///dev/i2c-2?address=0x1e", "&counts_per_g=900&rate=50"), ("i2c:///dev/i2c-2", "?counts_per_g=900&rate=50"),
     ("i2c:///dev/i2c-2?rate=100&address=0x1d", "&counts_per_g=900"), ("sim:", "counts_per_g=900&rate=50"),
     ("sim:seed=1", "&counts_per_g=900&rate=50"), ("sim:?seed=1", "&counts_per_g=900&rate=50"),
     ("sim:counts_per_g=640&rate=10", "")],
)  # fmt: skip
def test_an_address_gets_the_options_of_the_device_that_it_does_not_state(address: str, joined: str) -> None:
    assert as_calibrated(OTHER, address) == address + joined
    assert as_calibrated(replace(OTHER, provenance=FITTED), address) == address


@pytest.mark.parametrize(("silent", "temperature"), [(False, 21.5), (True, None)])
def test_a_reading_is_its_angles_with_their_intervals(silent: bool, temperature: float | None) -> None:
    unstated = replace(PLANE, uncertainty=replace(PLANE.uncertainty, standard={}, covariance=None))
    x, y = sin(radians(10.0)), sin(radians(-5.0))
    values = PLANE.coefficients.offset + PLANE.coefficients.sensitivity @ (x, y, (1.0 - x * x - y * y) ** 0.5)
    tilt = TiltOfReadings(unstated if silent else PLANE, find_model("sca100t-d02"))(
        Reading(tuple(values.tolist()), temperature), 3.0
    )
    assert tilt.angles == pytest.approx({"tilt_x": 10.0, "tilt_y": -5.0}, abs=0.01)
    assert tilt.expanded.keys() == (set() if silent else {"tilt_x", "tilt_y"})
    half, warm = [f"± {one:.2f}°" for one in tilt.expanded.values()] or ["", ""], [("", "21.5 °C", "")] * (not silent)
    angles = [f"{one:+.2f}°" for one in tilt.angles.values()]
    assert tilt.in_words() == [("tilt x", angles[0], half[0]), ("tilt y", angles[1], half[1]), *warm]
    intervals = {f"U95_{name}": one for name, one in tilt.expanded.items()}
    assert tilt.as_data() == {**tilt.angles, **intervals, "temperature": temperature, "flag": 1, "reason": 0}
    assert str(tilt) == "   ".join(" ".join(filter(None, part)) for part in tilt.in_words())


def test_what_a_terminal_has_no_room_for_is_left_out_and_the_flag_is_said_first() -> None:
    near = LiveTilt({"tilt_x": 1.0, "pitch": 1.0, "roll": -2.0}, {}, 20.0, 3, 1)
    said = ["suspect", "pitch +1.00°", "roll -2.00°", "tilt x +1.00°", "20.0 °C", "arcsine argument beyond ±1"]
    for width, places in (
        (94, "012345"),
        (93, "01234"),
        (65, "01234"),
        (64, "0123"),
        (55, "0123"),
        (54, "0124"),
        (24, "02"),
    ):
        assert near.within(width) == "".join(f"   {said[int(place)]}" for place in places), width
    assert near.within(5) == "   su"


@pytest.mark.parametrize(
    ("model", "address", "why"),
    [("sca100t-d02", "sim:", ""), ("sca100t-d01", "sim:", "another range or scale, 8.* nominally 1638 count/g"),
     ("serial-columns", "sim:columns=x,y&unit=count&sensitivity=1140", ""),
     ("serial-columns", "sim:columns=x,y&unit=count&sensitivity=1150", "nominally 1150 count/g"),
     ("serial-columns", "sim:columns=x,y&unit=V&sensitivity=1", "is of x, y in count, and sim:.* gives x, y in V"),
     ("serial-columns", "sim:columns=x&unit=count&sensitivity=819", "gives x in count: name the address")],
)  # fmt: skip
def test_a_sensor_has_to_be_what_it_was_when_it_was_calibrated(model: str, address: str, why: str) -> None:
    """A sensitivity of 817 counts per g, which may be 1.4 times that of the model or less."""
    fitted = replace(PLANE, provenance=FITTED)
    if why:
        with pytest.raises(InputError, match=why):
            require_as_calibrated(fitted, BenchSensor("S", model, address))
    else:
        require_as_calibrated(fitted, BenchSensor("S", model, address))
