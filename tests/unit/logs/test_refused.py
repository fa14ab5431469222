"""What does not go with recorded data is refused in whole words, which say what to do."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray
from support import FIXTURES

import tiltcal
from tiltcal.errors import TiltcalError
from tiltcal.files.document import document_of
from tiltcal.files.procedure import find_procedure
from tiltcal.logs.frames import rows_of
from tiltcal.logs.recordings import require_no_signs

CAL = FIXTURES / "plane.yaml"
LOG = {"x": [1024.0, 1030.0] * 40, "y": [1020.0, 1021.0] * 40}
THREE = {axis: (9.81 * (axis == "z") + np.random.default_rng(1).normal(0.0, 0.01, 80)).tolist() for axis in "xyz"}
SENSOR = {"serial": "S-1", "sensor": "sca100t-d02"}
SEGMENT = [{"position": "level", "start": 0, "end": 80}]
DISK = xarray.Dataset({name: ("n", np.linspace(0.0, 20.0, 400)) for name in ("theta", "a", "b", "c")})
DISK["theta"].attrs["units"] = "rad"
ZERO_45 = {"position": ["level", "x-45", "y-45"], "x": [1024.0, 1603.0, 1024.0], "y": [1024.0, 1024.0, 1603.0]}
NOISY = {"x": np.random.default_rng(1).normal(size=200).tolist()}


def fit(procedure: str, data: Any = LOG, **options: Any) -> Callable[[], Any]:
    return lambda: tiltcal.fit(procedure, data, **SENSOR | options)


def noise(data: Any, **options: Any) -> Callable[[], Any]:
    return lambda: tiltcal.noise(data, **options)


def applied(data: Any = LOG, **options: Any) -> Callable[[], Any]:
    return lambda: tiltcal.read(CAL).apply(data, **options)


REFUSED: dict[str, Callable[[], Any]] = {
    "skip_bad_rows is for logs: a frame has no row that cannot be parsed": applied(skip_bad_rows=True),
    "serial is for a folder of calibrations (calibrations)": applied(serial="S"),
    "average and every each say what belongs into a mean: give one of them": applied(average=2, every="1s"),
    "declination is between -180 and 180 degrees, not 180.5": applied(magnetometer="x,y,z", declination=180.5),
    "declination needs magnetometer or velocity": applied(declination=1.0),
    "stability needs uncertainty": applied(stability=1.0),
    "every takes a time such as 10s, 500ms, 5min or 1h, not 10q": applied(every="10q"),
    "every takes a time such as 10s, 500ms, 5min or 1h, not 0s": applied(every="0s"),
    "columns -a has a minus, and signs belong to the calibration: name a; the file that was fitted turns it": (
        lambda: require_no_signs("x=-a,y=b", ["a", "b"])
    ),
    "the rows is a list of rows: each is a mapping, such as {'position': 'level', 'x': 2.5}": (
        lambda: rows_of([1.0], "the rows")
    ),
    "f: a number or a text is needed, not a complex": lambda: document_of({"f": 1j}),
    "plane lets no stage turn": lambda: find_procedure("plane").in_turns(),
    "rotation renews no offset: leave alignment out": lambda: find_procedure("rotation").with_alignment(1.0),
    "free sets no position that could be visited again: leave closing out": lambda: find_procedure(
        "free"
    ).with_closing(),
    "ramp sets no position that could be visited again: leave closing out": lambda: find_procedure(
        "ramp"
    ).with_closing(),
    "ramp sets no positions to verify with: name another procedure": lambda: find_procedure("ramp").verifying(),
    "a table is one file, and 2 are given: name one": fit("plane", ["a.csv", "b.csv"], table=True),
    "a table has its positions already: leave segments out": fit("plane", LOG, table=True, segments=SEGMENT),
    "the frame: segment level ends at row 81, and the log has 80": (
        fit(
            "ramp",
            LOG | {"time": np.arange(80.0), "temperature": np.full(80, 20.0)},
            segments=[SEGMENT[0] | {"end": 81}],
        )
    ),
    "state the sensor's serial number": fit("plane", serial=None),
    "two-temperature determines no sensitivity, and none is known: name a sensor model whose nominal one may stand in, "
    "state it in the address (sensitivity=..., unit per g), or name the sensor's own calibration with base": fit(
        "two-temperature", sensor=None, unit="V"
    ),
    "state the unit of the readings (such as m/s2), or the sensor model: neither names nor the length of gravity at "
    "rest show it": fit(
        "free", {axis: np.eye(12)[k] * 1000.0 for k, axis in enumerate("xyz")}, sensor=None, table=True
    ),
    "the table states no uncertainties (ux, uy, uz) and has no position more than there are unknowns: nothing says how "
    "good the result is; add either": fit("zero-45", ZERO_45, jig=0.1),
    "the frame: its sample rate is unknown: there is no column 'time'; name it with columns time=NAME, or state rate "
    "HZ": noise(NOISY),
    "the frame: column 'x' has no value in any row: is x connected?": noise({"x": [None] * 80}, rate=1.0),
    "the frame: x has 63 samples; nothing is said of noise from fewer than 64": noise({"x": NOISY["x"][:63]}, rate=1.0),
    "the frame: x reads 2 in all 80 samples: identical samples are not still, they are stuck (or the noise is far "
    "below the step of the reading, and no averaging helps)": noise({"x": [2.0] * 80}, rate=1.0),
    "target is in degrees, and nothing says how much a degree is: give the sensor model, a calibration, or unit g or "
    "m/s2": noise(NOISY, rate=1.0, target=0.1),
    "the frame: x and temperature are one column, 'x': name the column of each": applied(columns="temperature=x"),
    "the readings have one unit: sensor says count, but unit says V": noise(NOISY, sensor="sca100t-d02", unit="V"),
    "the frame: column 'theta' is in rad, and stage angles in degree: convert the readings": lambda: tiltcal.match(
        DISK, [("a", "b", "c")], phase="theta"
    ),
    "a and b with the orthogonal a: a pair is of three different columns": lambda: tiltcal.match(
        DISK, [("a", "b", "a")]
    ),
    "the frame: the record is too short, its time does not change, or a time lies before its first or after its last: "
    "the spin cannot be estimated; without phase the stage must turn at one speed": lambda: tiltcal.match(
        DISK.assign(time=("n", np.where(np.arange(400) == 100, 1e17, np.arange(400.0)))), [("a", "b", "c")]
    ),
    "the frame: column 'a' has no value in any row: is a connected?": lambda: tiltcal.match(
        {"t": np.arange(900.0), "a": [np.nan] * 900, "b": np.ones(900), "c": np.ones(900)},
        [("a", "b", "c")],
        phase="t",
    ),
}


@pytest.mark.parametrize("said", REFUSED, ids=[said[:40] for said in REFUSED])
def test_it_is_refused_in_whole_words(said: str) -> None:
    with pytest.raises(TiltcalError) as refused:
        REFUSED[said]()
    assert str(refused.value) == said
