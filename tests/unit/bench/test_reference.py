"""A reference on the plate: what it must be, what it says of an attitude, and when it is not at rest."""

from dataclasses import replace
from math import asin, atan, degrees, radians, sin, sqrt
from typing import Any

import pytest

from tiltcal.bench.reference import reference_of, require_steady
from tiltcal.bench.settle import Unsettled
from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.drivers.model import Reading
from tiltcal.errors import InputError, UsageError
from tiltcal.files.bench import BenchFile, BenchReference, BenchSensor
from tiltcal.files.procedure import find_procedure
from tiltcal.journal.header import ReferenceDevice
from tiltcal.journal.playback import Sample
from tiltcal.journal.reference import compared, set_by, uncertainty_with

POSITION = find_procedure("plane").positions[0]  # the +X side up by 30°


def reference(columns: str = "x,y", unit: str = "deg", jig: float | None = None, **more: Any) -> ReferenceDevice:
    options = {"zero": 0.0025, "scale": 0.0002, "repeatability": 0.002, "alignment": 0.3, **more}
    stated = BenchReference(model="serial-columns", address=f"sim:columns={columns}&unit={unit}", **options)
    found = reference_of(BenchFile((BenchSensor("S", "sca100t-d02", "sim:"),), reference=stated, jig=jig))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("stated", "why"),
    [
        ({"unit": "V"}, "the reference reads V: state its unit, such as deg, mrad or mm/m"),
        ({"zero": None}, "the reference: state 'zero' and 'scale', or the 'uncertainty' of the certificate"),
        (
            {"columns": "z", "unit": "g"},
            "the reference serial-columns reads no tilt of the plate: it needs x or y, and",
        ),
        ({"columns": "x"}, "the reference reads no tilt y, which keeps its set angle: state jig for it"),
        ({"columns": "y"}, "the reference reads no tilt x, which keeps its set angle: state jig for it"),
        ({"columns": "x", "axes": ("-y", "x")}, "the reference reads no tilt x, which keeps its set angle"),
    ],
)
def test_what_no_reference_is(stated: dict[str, Any], why: str) -> None:
    with pytest.raises(UsageError, match=f"^{why}"):
        reference(**stated)


@pytest.mark.parametrize(
    ("device", "values", "tilt"),
    [
        ({"unit": "deg"}, (29.5, -1.0), (29.5, -1.0)),
        ({"unit": "g"}, (0.5, -0.1), (30.0, degrees(asin(-0.1)))),
        ({"unit": "mrad"}, (500.0, 10.0), (degrees(0.5), degrees(0.01))),
        ({"unit": "mm/m"}, (577.35, 10.0), (degrees(atan(0.57735)), degrees(atan(0.01)))),
        ({"axes": ("-y", "x")}, (1.0, 29.5), (29.5, -1.0)),
        ({"columns": "x", "jig": 0.1}, (29.5,), (29.5, 0.0)),
        ({"columns": "y", "jig": 0.1}, (-1.0,), (30.0, -1.0)),
    ],
)
def test_the_attitude_is_that_which_the_reference_reads(
    device: dict[str, Any], values: tuple[float, ...], tilt: tuple[float, float]
) -> None:
    """The mean of two samples 0.02 apart; what is not read stays as it was set, and upside down there is no tilt."""
    found = reference(**device)
    samples = [Sample(), *(Sample() for _ in range(2))]
    for sample, off in zip(samples[1:], (-0.01, 0.01), strict=True):
        sample.reference = Reading(tuple(value + off for value in values))
    x, y = (sin(radians(one)) for one in tilt)
    is_set = set_by(found, POSITION, samples)
    assert is_set.tilt == pytest.approx({"x": tilt[0], "y": tilt[1]}, abs=2e-6)
    assert is_set.gravity == pytest.approx((x, y, sqrt(1.0 - x * x - y * y)), abs=1e-7)
    over = set_by(found, replace(POSITION, gravity=(*POSITION.gravity[:2], -POSITION.gravity[2])), samples)
    assert (over.tilt, over.gravity) == (None, pytest.approx((x, y, -sqrt(1.0 - x * x - y * y)), abs=1e-7))


def test_what_no_attitude_has_is_no_reading() -> None:
    sample = Sample()
    sample.reference = Reading((72.0, 20.0))
    with pytest.raises(InputError, match=r"^the reference reads 72, 20, which no attitude has$"):
        set_by(reference(), POSITION, [sample])


@pytest.mark.parametrize(
    ("x", "why"),
    [
        ([10.0, 10.0, 10.0, 10.0], ""),
        ([10.0, 10.002, 10.004, 10.0059], ""),
        ([10.0, 10.002, 10.004, 10.0061], r"the reference moved by \+0.0061° in x while it was sampled: let it rest"),
        ([10.0, 9.99], ""),
        ([10.011, 9.989, 9.989, 10.011], ""),
        ([10.013, 9.987, 9.987, 10.013], "the reference scatters by 0.013° in x, so that the mean of 4 is not as good "
         "as its repeatability of 0.002°: is it at rest"),
        ([10.01, 9.991], "the reference scatters by 0.0095° in x, so that the mean of 2"),
    ],
)  # fmt: skip
def test_a_reference_that_is_not_at_rest_is_refused(x: list[float], why: str) -> None:
    """It may change by three times its repeatability of 0.002°, and scatter by as much and the root of the number."""
    samples = []
    for number, value in enumerate(x):
        samples.append(Sample())
        samples[-1].reference, samples[-1].now_ns = Reading((value, 1.0)), number * 10**9
    if why:
        with pytest.raises(Unsettled, match=f"^{why}"):
            require_steady(reference(), samples)
    else:
        require_steady(reference(), samples)


def test_what_a_reference_makes_of_the_uncertainty_of_the_bench() -> None:
    """Of an angle that it does not read the jig's remains, less what it has itself; a lean it reads as well."""
    stated = BenchUncertainty(0.1, 0.5, 0.3, 0.2)
    assert uncertainty_with(None, stated) == stated
    both, one = (uncertainty_with(reference(columns, jig=0.1), stated) for columns in ("x,y", "y"))
    assert (both.jig, both.table_lean, one.jig, one.table_lean) == (0.002, 0.0, 0.002, 0.3)
    assert (both.thermometer, both.heading) == (0.5, 0.2)
    instrument: Any = one.instrument
    assert (instrument.axes, instrument.zero, instrument.scale, instrument.alignment) == (("y",), 0.0025, 0.0002, 0.3)
    assert instrument.unread == pytest.approx(sqrt(0.1**2 - 0.002**2))
    assert compared(None) == []
    (said,) = compared(reference())
    counts = (
        "zero 0.0025°, scale 0.02 % and alignment 0.3° count as one error each for the whole session, 0.002° for each"
    )
    assert said.startswith(f"the angles are those that the reference serial-columns read: {counts}")
