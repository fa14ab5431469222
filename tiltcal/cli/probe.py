"""``tiltcal probe``: test the wiring of a sensor."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime

import click

from tiltcal.bench.devices import open_sensor
from tiltcal.cli import options
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.columns import guess, listened, shown, unit_of_gravity
from tiltcal.errors import NEGATIVE_VERDICT, BusError, UsageError
from tiltcal.files.device import model_named


@options.command(epilog="Example: tiltcal probe --sensor sca100t-d02 --address spi:///dev/spidev0.0 --self-test")
@click.argument("device", metavar="[FILE]", required=False)
@click.option(
    "--sensor",
    metavar="MODEL",
    help="The sensor's model; `tiltcal devices` lists them. Without it, a serial port is listened to for two seconds.",
)
@click.option(
    "--address", required=True, help="Its address, such as spi:///dev/spidev0.0, /dev/ttyUSB0, or sim: for its twin."
)
@click.option("--self-test", "self_test", is_flag=True, help="Start the self-test of the part; lay it level and still.")
@options.as_json
def command(device: str | None, sensor: str | None, address: str, self_test: bool, as_json: bool) -> int:
    """Test the connection of a sensor, or of the device that the device FILE describes, and print its answer.

    Exit code 3 if it does not answer, 1 if its self-test fails.
    """
    parsed = parse_address(address)
    sensor = sensor or device
    if parsed.scheme == "serial" and (not sensor or (sensor == "serial-columns" and "columns" not in parsed.options)):
        return _listen(parsed, as_json)
    if not sensor:
        raise UsageError("--sensor is missing: the model that is connected there ('tiltcal devices' lists them)")
    model = model_named(sensor).at(parsed)
    with open_sensor(sensor, address) as driver:
        said = dict(driver.probe())
        tests = {channel: driver.self_test(channel) for channel in model.channels} if self_test else {}
    passed = all(test.passed for test in tests.values())
    if as_json:
        results = {channel: {"passed": test.passed, "said": str(test)} for channel, test in tests.items()}
        options.print_judged(
            options.json_text({"model": model.name, "address": address, "answers": said, "self_test": results})
        )
    else:
        options.print_judged(f"{model.name} answers at {address}")
        for name, value in said.items():
            options.print_judged(f"  {name:<12} {value}")
        for channel, test in tests.items():
            options.print_judged(f"  self-test {channel}  {'passed' if test.passed else 'FAILED'}: {test}")
    return 0 if passed else NEGATIVE_VERDICT


def _listen(address: Address, as_json: bool) -> int:
    """Print what a device on a serial port sends, and the address that reads its numbers."""
    with closing(open_link(address, find_model("serial-columns"))) as link:
        lines, rate = listened(link, session_clock(datetime.now(UTC), virtual=False))
    if any(line.startswith(b"$PTCDC,") for line in lines):
        raise UsageError(f"{address} sends the times of duty cycles ($PTCDC,...): name the model, as --sensor adxl202")
    found = guess(lines)
    if not found.numbers:
        raise BusError(
            f"{address} sends text without numbers, such as {shown(lines[-1])}: is the baud rate right (baudrate=), "
            "and does the sketch print its readings?"
        )
    unit = found.unit or unit_of_gravity(found)
    options_of = {**address.options, "columns": found.columns, **({"unit": unit} if unit else {})}
    place = address.written.partition("?")[0]
    advised = f"{place}?{'&'.join(f'{name}={value}' for name, value in options_of.items())}"
    if as_json:
        said = {**found._asdict(), "lines_per_second": round(rate, 1), "address": advised}
        options.print_judged(options.json_text(said))
        return 0
    plural = "" if found.numbers == 1 else "s"
    options.print_judged(f"{place} prints {found.numbers} number{plural} a line, {rate:.0f} lines a second:")
    options.print_judged(f"  {found.example}")
    procedure = "six-face" if "z" in found.columns.split(",") else "PROCEDURE"
    unknown = ", and unit= is not known: add it and what 1 g is, such as &unit=count&sensitivity=16384"
    known = f", unit={unit}" if unit else unknown
    how = "" if found.unit or not unit else " (at rest they are as long as gravity)"
    options.print_judged(f"as columns={found.columns}{known}{how}. If that is right:")
    measure = f'tiltcal measure {procedure} --sensor serial-columns --address "{advised}" --serial IMU1 -o IMU1.yaml'
    options.print_judged(f"  {measure}")
    return 0
