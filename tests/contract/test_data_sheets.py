"""Every driver against the bytes and figures of ``data_sheets.yaml``, through its public interface."""

from functools import reduce
from math import hypot, radians
from operator import xor
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.arriving_pieces import ArrivingPieces
from support.scripted_link import Script
from support.virtual_device import VirtualDevice

from tiltcal import errors
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.converters import RATES, Ads1115
from tiltcal.drivers.model import Model

SHEETS = yaml.load(Path(__file__).with_name("data_sheets.yaml").read_text(encoding="utf-8"), yaml.CBaseLoader)
LETTERS = {"spi": "s", "i2c": "i", "modbus": "m", "serial": "r"}


def each(key: str) -> Any:
    """Make a test of each row that the sheets have under a key, by the name of its model."""
    cases = [pytest.param(sheet, row, id=sheet["model"]) for sheet in SHEETS for row in sheet.get(key, ())]
    return pytest.mark.parametrize(("sheet", "row"), cases)


def at(sheet: dict[str, Any], options: str = "") -> Model:
    """The model at the address of a sheet, or at its place with other options."""
    place, mark, own = sheet.get("address", "sim:").partition("?")
    return find_model(sheet["model"]).at(parse_address(f"{place}?{options}" if options else place + mark + own))


def filled(lines: list[str], row: dict[str, Any], given: dict[str, str]) -> list[str]:
    """The transactions of one reading, with the bytes of its row."""
    values = {**given, **row}
    if "n" in row:
        # The XOR of the characters between $ and *, as NMEA 0183 has it.
        values["hh"] = f"{reduce(xor, b'PTCDC,' + row['n'].encode()):02X}"
    return [line.format(**values) for line in lines]


@each("rows")
def test_the_bytes_of_a_data_sheet_are_its_readings(sheet: dict[str, Any], row: Any) -> None:
    model, clock, given = at(sheet), VirtualClock(), sheet.get("given", {})
    readings = row if isinstance(row, list) else [row]
    lines = [line for one in readings for line in filled(one.get("exchange", sheet["exchange"]), one, given)]
    link: Any
    if "lines" in sheet or "pieces" in sheet:
        link = ArrivingPieces(*(line.encode() if "lines" in sheet else bytes.fromhex(line) for line in lines))
    else:
        bus = sheet["address"].partition(":")[0].rpartition("+")[2]
        link = Script(LETTERS[bus], clock, *readings[0].get("setup", sheet.get("setup", ())), *lines)
    sensor = model.driver(link, clock)
    for expected in readings:
        if "error" in expected:
            kind, why = expected["error"]
            with pytest.raises(getattr(errors, kind), match=why):
                sensor.read()
            continue
        reading = sensor.read()
        if "values" in expected:
            assert reading.values == pytest.approx(tuple(map(float, expected["values"])), abs=1e-6)
        if "g" in expected:
            g = [(value - model.offset) / model.sensitivity for value in reading.values]
            assert g == pytest.approx(list(map(float, expected["g"])), abs=5e-6)
        if "celsius" in expected:
            digits = len(expected["celsius"].partition(".")[2])
            near = min(0.02, 0.6 * 10.0**-digits)
            celsius = None if expected["celsius"] == "null" else pytest.approx(float(expected["celsius"]), abs=near)
            assert reading.temperature == celsius
        if "statistics" in expected:
            assert {name: str(count) for name, count in sensor.link_statistics().items()} == expected["statistics"]
        if "step" in expected:
            assert reading.step == pytest.approx(float(expected["step"]))
    if isinstance(link, Script):
        assert min(link.rests) >= float(sheet.get("rest", 0)) - 1e-12
        # A converter is asked for nothing more where an input is beyond its range.
        if "error" not in readings[-1]:
            link.close()
    if "sent" in sheet:
        assert link.heard == [bytes.fromhex(sheet["sent"])]


@each("facts")
def test_the_facts_of_a_model_are_those_of_its_data_sheet(sheet: dict[str, Any], row: dict[str, Any]) -> None:
    model = at(sheet, row.get("at", ""))
    for name, expected in row.items():
        if name == "start":
            device = VirtualDevice(find_model(sheet["model"]), row.get("at", ""))
            began = device.clock.now_ns()
            device.sensor.read()
            assert 0.0 <= (device.clock.now_ns() - began) / 1e9 - float(expected) < 6e-3
        elif name == "limits":
            # The errors of a part are evenly distributed, so the largest of many comes near its limit.
            drawn, unit = [model.default_truth(seed) for seed in range(100)], model.sensitivity
            rows = [(channel, part.sensitivity[channel]) for part in drawn for channel in model.channels]
            found = (
                max(hypot(*(k for axis, k in row.items() if axis != channel)) / row[channel] for channel, row in rows),
                max(abs(slope) / unit for part in drawn for (slope,) in part.drift.values()),
                max(abs(slope) for part in drawn for (slope,) in part.gain.values()),
                max(abs(part.thermometer_error) for part in drawn),
            )
            for one, limit in zip(found, map(float, expected), strict=True):
                assert 0.97 * limit <= one <= limit, (found, expected)
        elif name == "held":
            sensor = VirtualDevice(model).sensor
            assert {at: f"{sensor.register(int(at, 16)):02X}" for at in expected} == expected
        elif name == "spi":
            assert model.spi is not None
            figures = (*model.spi.modes, model.spi.fastest or 0, model.spi.speed or 0, model.spi.slowest)
            assert figures == tuple(map(int, expected))
        elif name in ("gain", "drift"):
            unit = 0.01 if name == "gain" else model.sensitivity * radians(1.0)
            assert getattr(model.population, name) == pytest.approx([unit * float(k) for k in expected]), name
        elif name != "at":
            value = model.default_truth(1).noise["x"] if name == "noise" else getattr(model, name)
            if name == "channels":
                assert list(value) == expected
            elif isinstance(value, bool | str):
                assert expected in (str(value), str(value).lower()), name
            else:
                figure = tuple(map(float, expected)) if isinstance(expected, list) else float(expected)
                assert value == pytest.approx(figure, rel=2e-3 if name.endswith("spread") else 2e-5), name


@each("codes")
def test_an_option_is_set_by_the_code_of_the_data_sheet(sheet: dict[str, Any], row: dict[str, str]) -> None:
    for option, transaction in row.items():
        device = VirtualDevice(find_model(sheet["model"]), option)
        device.sensor.read()
        assert bytes.fromhex(transaction) in [out for out, _, _ in device.line.sent], (option, transaction)
        name, _, value = option.partition("=")
        if name == "rate" and device.model.interval and device.model.unit == "count":
            assert device.model.interval == pytest.approx(1.0 / float(value), rel=2e-3), option


@each("refused")
def test_an_address_that_cannot_be_is_refused_with_the_reason(sheet: dict[str, Any], row: str) -> None:
    with pytest.raises(errors.UsageError) as refusal:
        open_link(parse_address(f"{sheet['address'].partition('?')[0]}?{row}"), at(sheet, row))
    assert sheet["refused"][row] in str(refusal.value)


def test_the_clock_of_a_virtual_converter_is_10_percent_wrong_at_most() -> None:
    took = []
    for seed in range(20):
        device = VirtualDevice(find_model("sca100t-d01-analog"), "rate=8", seed=seed)
        device.line.exchange(bytes.fromhex("01 C1 03"))
        began = device.clock.now_ns()
        while not device.line.exchange(b"\x01", 2)[0] & 0x80:
            device.clock.sleep(1e-3)
        assert device.line.exchange(b"", 2) == device.line.exchange(b"\x01", 2), "the pointer stays where it is"
        took.append((device.clock.now_ns() - began) / 1e9 * 8.0)
    assert 0.9 <= min(took) < 0.93
    assert 1.07 < max(took) <= 1.12  # it is asked once in 1.5 ms


@pytest.mark.parametrize("rate", RATES)
def test_it_waits_for_a_converter_that_is_10_percent_slow(rate: int) -> None:
    converter, clock = Ads1115(parse_address(f"sim:rate={rate}")), VirtualClock()
    word = f"{converter.config(0):04X}"
    script = Script("i", clock, f"01 {word} /", f"01 / {word}", "00 / 00 00")
    converter.volts(script, clock, 0)
    assert script.times[1] - script.times[0] >= 1.1 / rate - 1e-9
