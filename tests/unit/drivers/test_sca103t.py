"""SCA103T and SCA61T: the words of the fact sheet, their twins, and a part that was written apart from both."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import asin, degrees

import pytest
from support.emulated.bench import Sca103t as PartFacts
from support.part_link import PartLink
from support.sca103t_part import Sca103tPart
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault

D04, D05 = find_model("sca103t-d04"), find_model("sca103t-d05")
FAHH1G, FA1H1G = find_model("sca61t-fahh1g"), find_model("sca61t-fa1h1g")
EVERY = (D04, D05, FAHH1G, FA1H1G)


def scripted(model: Model, *words: str, first: tuple[str, ...] = ()) -> tuple[Sensor, Script]:
    clock = VirtualClock()
    commands = ("10", "11")[: len(words)]
    lines = [f"{command} 00 00 / xx {word}" for command, word in zip(commands, words, strict=True)]
    script = Script("s", clock, *first, *lines, "08 00 / xx AA")
    return model.driver(script, clock), script


@pytest.mark.parametrize(
    ("model", "words", "count", "tilt"),
    [
        (D04, ("80 00", "80 00"), 0, 0.0),
        (D04, ("87 20", "78 E0"), 114, 0.9967),
        (D04, ("87 3F", "78 FF"), 114, 0.9967),
        (D04, ("A3 A0", "5C 60"), 570, 4.9893),
        (D05, ("A3 A0", "5C 60"), 570, 10.0170),
        (D04, ("5C 60", "A3 A0"), -570, -4.9893),
        (D04, ("C7 20", "38 E0"), 1138, 9.9992),
        (D04, ("EA 00", "16 00"), 1696, 14.9973),
        (D05, ("91 E0", "6E 20"), 286, 5.0072),
        (FAHH1G, ("80 00",), 1024, 0.0),
        (FAHH1G, ("83 A0",), 1053, 1.0144),
        (FAHH1G, ("91 E0",), 1167, 5.0084),
        (FAHH1G, ("6E 20",), 881, -5.0084),
        (FAHH1G, ("7C 60",), 995, -1.0144),
        (FAHH1G, ("E6 60",), 1843, 30.0),
        (FAHH1G, ("E6 7F",), 1843, 30.0),
        (FA1H1G, ("81 C0",), 1038, 0.9795),
        (FA1H1G, ("88 E0",), 1095, 4.9733),
        (FA1H1G, ("B3 40",), 1434, 30.0404),
        (FA1H1G, ("E6 60",), 1843, 90.0),
    ],
)
def test_words_of_the_fact_sheet(model: Model, words: tuple[str, ...], count: int, tilt: float) -> None:
    """Angles as printed there; one of them stands for 3276.8 in place of 3277 count/g."""
    sensor, script = scripted(model, *words)
    reading = sensor.read()
    assert reading.values == (float(count),)
    assert degrees(asin((count - model.offset) / model.sensitivity)) == pytest.approx(tilt, abs=4e-4)
    assert reading.temperature == pytest.approx(24.93, abs=0.005)
    script.close()


@pytest.mark.parametrize(
    ("model", "words", "why"),
    [
        (D04, ("F3 40", "0C A0"), "RDAX reads 1946 count, outside 102 to 1945"),
        (D04, ("05 00", "05 00"), "RDAX reads 40 count, outside 102 to 1945"),
        (D05, ("80 00", "F3 40"), "RDAY reads 1946 count"),
        (FAHH1G, ("05 00",), "x reads 40 count, and words below 102"),
    ],
)
def test_a_fault_of_either_element_is_no_reading(model: Model, words: tuple[str, ...], why: str) -> None:
    sensor, _ = scripted(model, *words)
    with pytest.raises(DeviceFault, match=why):
        sensor.read()


def test_probe_shows_the_common_mode() -> None:
    sensor, _ = scripted(D04, "87 20", "78 E0", first=("00 / xx",))
    said = sensor.probe()
    assert said["x"] == "114 count"
    assert str(said["elements"]).startswith("1081 and 967 count, together 2048")


def test_an_sca61t_has_no_self_test_whose_limits_are_known() -> None:
    assert not hasattr(FAHH1G.driver(None, VirtualClock()), "self_test")


@pytest.mark.parametrize(
    ("model", "celsius", "gain"),
    [
        (D04, 60.0, -0.0000005 * 60**3 - 0.00005 * 60**2 + 0.0032 * 60 - 0.031),
        (FAHH1G, 60.0, -0.00011 * 60**2 + 0.0019 * 60 + 0.0362),
    ],
)
def test_the_mean_temperature_curves_are_those_of_the_data_sheets(model: Model, celsius: float, gain: float) -> None:
    """Typed from the fact sheet: per cent of the sensitivity, and degrees of the SCA61T's offset."""
    curve = model.population
    assert sum(k * celsius**n for n, k in enumerate(curve.gain)) == pytest.approx(gain / 100)
    drift = 0.0 if model is D04 else -0.0000005 * 60**3 + 0.0000857 * 60**2 - 0.0032 * 60 + 0.0514
    counts = model.sensitivity * drift * 0.017453293
    assert sum(k * celsius**n for n, k in enumerate(curve.drift)) == pytest.approx(counts, abs=1e-6)


def part_of(model: Model, **changes: object) -> PartFacts:
    elements = 2 if model.offset == 0.0 else 1
    facts = PartFacts(counts_per_g=model.sensitivity, elements=elements)
    return replace(facts, **{"jig": 0.0, "noise": 0.0, **changes})


@pytest.mark.parametrize("model", EVERY, ids=lambda model: model.name)
def test_driver_twin_and_part_agree_on_the_bus(model: Model) -> None:
    clock = VirtualClock()
    facts = part_of(model)
    link = PartLink(Sca103tPart(**asdict(facts)), clock)
    gravity = [0.2, -0.3, 0.87**0.5]
    link.part.pose(gravity, 31.0)
    reading = model.driver(link, clock).read()
    (row,) = facts.sensitivity
    plain = facts.offset[0] + sum(share * g for share, g in zip(row, link.part.gravity, strict=True))
    assert reading.values[0] == pytest.approx(model.offset + model.sensitivity * plain, abs=1.0)
    link.close()

    truth = Truth(
        channels=("x",),
        offset={"x": model.offset + model.sensitivity * facts.offset[0]},
        sensitivity={"x": {axis: model.sensitivity * one for axis, one in zip("xyz", row, strict=True)}},
        ambient=31.0,
    )
    fixture = Fixture(clock, ambient=31.0)
    fixture.gravity = tuple(link.part.gravity)
    ours = model.driver(model.twin(truth, fixture, clock), clock).read()
    assert ours.values == pytest.approx(reading.values, abs=2.0)
    assert ours.temperature == pytest.approx(reading.temperature, abs=1.0)


@pytest.mark.parametrize("model", EVERY, ids=lambda model: model.name)
def test_a_fault_comes_and_goes(model: Model) -> None:
    clock = VirtualClock()
    truth = replace(model.default_truth(3), noise={}, faults=(Fault("parity", 1.0, 2.0), Fault("silent", 2.0, 3.0)))
    sensor = model.driver(model.twin(truth, Fixture(clock), clock), clock)
    before = sensor.probe()["x"]
    clock.seek(1_000_000_000)
    with pytest.raises(DeviceFault):
        sensor.read()
    clock.seek(2_000_000_000)
    with pytest.raises(BusError, match="stuck high"):
        sensor.read()
    clock.seek(3_000_000_000)
    assert sensor.probe()["x"] == before


def test_both_elements_of_an_sca103t_test_themselves() -> None:
    clock = VirtualClock()
    sensor = D05.driver(D05.twin(D05.default_truth(4), Fixture(clock), clock), clock)
    tested = sensor.self_test("x")
    assert (tested.channel, tested.passed) == ("RDAY", True)
    assert tested.deflected >= 0.95 * 2047


@pytest.mark.parametrize("model", EVERY, ids=lambda model: model.name)
def test_drawn_parts_differ_and_stay_within_their_limits(model: Model) -> None:
    parts = [model.default_truth(seed) for seed in range(50)]
    assert len({part.offset["x"] for part in parts}) == 50
    assert all(abs(part.sensitivity["x"]["x"] / model.sensitivity - 1.0) <= 0.005 for part in parts)
