"""What a position is refused for, by written readings of a part of the data sheet: 1024 counts at 0 g, 819 count/g."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tiltcal.bench.checks import Expectations, far_off, require_few, require_no_turns
from tiltcal.bench.settle import Unsettled
from tiltcal.bench.setup import new_setup
from tiltcal.core.samples import ReadingStep
from tiltcal.drivers import find_model
from tiltcal.drivers.model import Reading
from tiltcal.files.bench import BenchFile, BenchSensor
from tiltcal.files.procedure import find_procedure
from tiltcal.journal.playback import Sample
from tiltcal.journal.positions import PositionResult, result_of


def samples(*columns: list[float], celsius: float | None = None) -> list[Sample]:
    """Samples of a sensor S by its channels."""
    return [Sample({"S": Reading(row, celsius)}) for row in zip(*columns, strict=True)]


def refusal(check: Callable[..., object], *arguments: object) -> str:
    """Why a check refuses; nothing where it does not."""
    try:
        check(*arguments)
    except Unsettled as why:
        return str(why)
    return ""


@pytest.mark.parametrize(
    ("x", "warm", "thermometers", "wrong"),
    [
        ([1024.0] * 5 + [1025.0] * 5, [24.0] * 10, True, {}),
        ([1024.0] * 9 + [1026.0], [24.0] * 10, True, {}),
        ([1024.0] * 9 + [1027.0], [24.0] * 10, True, {9: "x reads 1027 where the other samples read 1024"}),
        ([1024.0] * 10, [None, -61.0, -60.0, 24.0, 24.0, 29.0, 29.1, 19.0, 18.9, 24.0], True,
         {n: f"the thermometer reads {t} °C" for n, t in ((1, -61), (2, -60), (6, 29.1), (8, 18.9))}),
        ([1024.0] * 10, [150.0] * 9 + [150.1], True, {9: "the thermometer reads 150.1 °C"}),
        ([1024.0] * 10, [151.0] * 10, True, dict.fromkeys(range(10), "the thermometer reads 151 °C")),
        ([1024.0] * 10, [151.0] * 10, False, {}),
    ],
)  # fmt: skip
def test_samples_that_are_no_measurement(
    x: list[float], warm: list[float | None], thermometers: bool, wrong: dict[int, str]
) -> None:
    """More than two steps from the others, beyond -60 to 150 °C, or more than 5 °C from the others' median."""
    taken = [Sample({"S": Reading((one, 1024.0), celsius)}) for one, celsius in zip(x, warm, strict=True)]
    assert far_off(taken, {"S": find_model("sca100t-d02")}, thermometers=thermometers) == wrong


@pytest.mark.parametrize(
    ("y", "refused"),
    [([0, 5] * 4, True), ([0, 5] * 3 + [0], False), ([0, 4] * 4, False), ([0, 5, 5, 0] * 3, False),
     ([0, 5] * 8 + [0, 0], True), ([0, 5] * 8 + [0, 0, 5, 5], False)],
)  # fmt: skip
def test_two_values_in_turn_are_two_axes_in_one_column(y: list[float], refused: bool) -> None:
    """From eight samples on, by more than four steps, and a correlation of one to the next below -0.8."""
    taken = samples([1024.0] * len(y), [1024.0 + one for one in y])
    said = "y reads about 1024 and 1029 in turn: does each line have all axes that columns= or the pattern names?"
    assert refusal(require_no_turns, taken, {"S": find_model("sca100t-d02")}) == (said if refused else "")


@pytest.mark.parametrize(
    ("count", "wanted", "refused"),
    [(1, 5, False), (2, 5, True), (2, 39, True), (2, 40, False), (5, 100, False), (6, 100, True)],
)
def test_more_than_a_twentieth_and_more_than_one_far_off_are_a_fault(count: int, wanted: int, refused: bool) -> None:
    said = f"{count} samples of a position of {wanted} are far off: x reads 1; look for a loose contact"
    assert refusal(require_few, count, wanted, "x reads 1") == (said if refused else "")


LEVEL, UP, DOWN = (0.0, 0.0, 1.0), (0.5, 0.0, 0.75**0.5), (-0.5, 0.0, 0.75**0.5)
METRIC = {"model": "serial-columns?unit=m/s2", "scatter": 0.01}
VOLT = {"model": "serial-columns?unit=V&sensitivity=2", "scatter": 0.001}
OFF = {"offset": 2.5, "scatter": 0.001}
LOOKS = "this looks like x-tilt2: is the sensor turned round? "
STUCK = "x of S is stuck: all 20 samples read 614.5 count, and those of the positions before scatter by 1.98; see that"
TURNED = (
    "was the sensor turned and held still; does each line have all axes that columns= or the pattern names? If not so"
)


def sensor(serial: str, model: str) -> BenchSensor:
    """A sensor by its model, or by the options of an address of serial-columns."""
    name, _, options = model.partition("?")
    return BenchSensor(serial, name, f"sim:columns=x,y&{options}" if options else "sim:")


def taken(
    procedure: str, model: str, name: str, *, seen: tuple[float, float, float] | None = None, scatter: float = 2.0,
    celsius: float | None = 24.0, typed: float | None = None, serials: str = "S", offset: float = 0.0,
) -> PositionResult:  # fmt: skip
    """A position as a sensor of the data sheet reads a direction, which flickers by so many counts about it."""
    sensors = [sensor(serial, model) for serial in serials]
    asked = next(one for one in find_procedure(procedure).positions if one.name == name)
    part, up = sensors[0].wired, seen or asked.gravity
    rows = [
        tuple(offset + part.offset + part.sensitivity * up["xyz".index(c)] + scatter * (-1) ** n for c in part.channels)
        for n in range(20)
    ]
    read = [Sample(dict.fromkeys(serials, Reading(row, celsius))) for row in rows]
    return result_of(sensors, asked, asked, read, "", typed=typed, steps={serial: ReadingStep() for serial in serials})


@pytest.mark.parametrize(
    ("procedure", "before", "name", "how", "why"),
    [
        ("plane", [], "x-tilt1", {}, None),
        ("plane", [], "x-tilt1", {"celsius": 84.9}, None),
        ("plane", [], "x-tilt1", {"celsius": 85.0, "typed": 85.0}, None),
        ("plane", [], "x-tilt1", {"celsius": 85.0}, "the thermometer reads 85 °C in every sample, as a DS18B20 does"),
        ("plane", [("x-tilt1", {})], "x-tilt2", {"celsius": 44.0}, None),
        ("plane", [("x-tilt1", {})], "x-tilt2", {"celsius": 3.9},
         "3.9 °C is what the thermometer reads, and 24 °C was measured in a position before: one of them is wrong"),
        ("two-temperature", [], "level-warm", {"typed": 45.0}, "45 °C was typed, and 24 °C was asked for: one of them"),
        ("two-temperature", [("level-warm", {})], "level-cold", {"celsius": 5.0}, None),
        ("two-temperature", [("level-warm", {"celsius": None})], "level-cold", {"celsius": 85.0}, "85 °C is what the"),
        ("plane", [], "x-tilt1", {"seen": DOWN}, f"{LOOKS}If the +X side really points down now, choose x-tilt2"),
        ("plane", [("x-tilt1", {}), ("x-tilt2", {})], "y-tilt1", {"seen": DOWN}, LOOKS.rstrip()),
        ("plane", [], "x-tilt2", {"seen": UP}, "this looks like x-tilt1: is the sensor turned round? If the +X side "
         "really points up now, choose x-tilt1"),
        ("plane", [], "x-tilt1", {"seen": (1.0, 0.0, 0.0)}, "no position of this procedure reads like this (x reads "
         "1843 where about 1433.5 is expected, y reads 1024 where about 1024 is expected): is the sensor at the angle"),
        ("plane", [], "x-tilt1", {"seen": DOWN, "serials": "ST"}, f"S: {LOOKS}".rstrip()),
        ("plane", [("x-tilt1", {})], "x-tilt2", {"scatter": 0.0}, STUCK),
        ("plane", [("x-tilt1", {"scatter": 0.0})], "x-tilt2", {"scatter": 0.0}, None),
        ("plane", [("y-tilt1", {"scatter": 0.0})], "x-tilt1", {"seen": LEVEL, "scatter": 0.0},
         "x of S is stuck: all 40 samples of 2 positions read 1024 count; see that the sensor converts, and that its"),
        ("two-temperature", [("level-warm", {"scatter": 0.0})], "level-cold", {"scatter": 0.0, "celsius": 5.0}, None),
        ("plane", [("x-tilt1", {"scatter": 140.0})], "x-tilt2", {},
         f"x of S scatters by 144 count within a position, and differs by 819 count from x-tilt1: {TURNED}"),
        ("plane", [("x-tilt1", {"scatter": 130.0})], "x-tilt2", {}, None),
        ("two-temperature", [("level-warm", {"scatter": 130.0})], "level-cold", {"celsius": 5.0}, None),
        ("free", [("x-up", {})], "y-up", {"model": "sca3000-d01", "seen": (1.0, 0.08, 0.0)},
         "this is the attitude of x-up again: hold the sensor in a different attitude"),
        ("free", [("x-up", {})], "x-up", {"model": "sca3000-d01", "seen": (0.0, 0.0, -1.0)}, None),
        ("plane", [], "x-tilt1", {**METRIC, "seen": DOWN},
         f"{LOOKS}If the +X side really points down now, choose x-tilt2"),
        ("plane", [], "x-tilt1", {**VOLT, "seen": DOWN}, None),
        ("plane", [("x-tilt1", {**OFF, "seen": DOWN})], "x-tilt2", {**VOLT, **OFF, "seen": UP},
         "no position of this procedure reads like this (x reads 3.5 where about -0.5 is expected, y reads 2.5 where"),
        ("plane", [("x-tilt1", OFF), ("x-tilt2", OFF)], "y-tilt1", {**VOLT, **OFF, "seen": (0.0, -0.5, 0.75**0.5)},
         "this looks like y-tilt2: is the sensor turned round, or was a position before it wrong (go back)?"),
        ("plane", [("x-tilt1", OFF), ("x-tilt2", OFF)], "y-tilt1", {**VOLT, **OFF}, None),
    ],
)  # fmt: skip
def test_what_the_reading_of_a_position_is_refused_for(
    procedure: str, before: list[tuple[str, dict[str, Any]]], name: str, how: dict[str, Any], why: str | None
) -> None:
    model, serials = how.pop("model", "sca100t-d02"), how.get("serials", "S")
    bench = BenchFile(tuple(sensor(serial, model) for serial in serials))
    steps = find_procedure(procedure)
    setup = new_setup(steps, bench, [Path(f"{serial}.yaml") for serial in serials], Path("j"), operator="sim")
    assert not setup.typical_temperature
    accepted = [taken(procedure, model, one, **{"serials": serials, **other}) for one, other in before]
    open_ = [one for one in steps.positions if one.name not in dict(before)]
    alike: list[str] = []
    expectations = Expectations(setup, bench.sensors, accepted, {}, open_, alike)
    said = [refusal(expectations.require, taken(procedure, model, name, **how)) for _ in range(3)]
    assert (said[0].startswith(why) and said[1] == said[0]) if why else said == [""] * 3, said[0]
    hinted = f"{said[0].partition(' If ')[0]} See to the wiring, and to axes: of the bench file"
    assert said[2] == (hinted if alike else said[0])
