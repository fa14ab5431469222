"""``tiltcal probe``: say what is in a log, or test the wiring of a sensor."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime

import click

from tiltcal.bench.devices import open_sensor
from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar
from tiltcal.column_guess import guess
from tiltcal.column_names import AXES
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.columns import listened, shown
from tiltcal.errors import NEGATIVE_VERDICT, BusError, UsageError
from tiltcal.files.device import model_named
from tiltcal.printable import counted

_EXAMPLES = """\b
Examples:
  tiltcal probe night.csv
  tiltcal probe --sensor sca100t-d02 --address spi:///dev/spidev0.0 --self-test
"""


@options.command(epilog=_EXAMPLES)
@click.argument("device", metavar="[LOG]", required=False)
@click.option(
    "--sensor",
    metavar="MODEL",
    help="The sensor's model; `tiltcal devices` lists them. Without it, a serial port is listened to for two seconds.",
)
@click.option("--address", help="Its address, such as spi:///dev/spidev0.0, /dev/ttyUSB0, or sim: for its twin.")
@click.option("--self-test", "self_test", is_flag=True, help="Start the self-test of the part; lay it level and still.")
@options.as_json
def command(device: str | None, sensor: str | None, address: str | None, self_test: bool, as_json: bool) -> int:
    """Say what is in a LOG, or test the connection of a sensor and print its answer.

    Of a LOG: where its table begins, names and units of its columns, rows and rate, gravity at rest, still attitudes,
    and the command to type next. With --address a FILE in place of LOG describes the device. Exit code 3 if
    a sensor does not answer, 1 if its self-test fails.
    """
    if address is None:
        if device is None or sensor is not None or self_test:
            raise UsageError("give a LOG alone, or the --address of a sensor")
        return _read(device, as_json)
    if device is not None and sensor is not None:
        raise UsageError(f"{device} and --sensor {sensor}: --address takes one of them")
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
        lines = [f"{model.name} answers at {address}", *(f"  {name:<12} {value}" for name, value in said.items())]
        lines += [f"  self-test {one}  {'passed' if test.passed else 'FAILED'}: {test}" for one, test in tests.items()]
        options.print_judged("\n".join(lines))
    return 0 if passed else NEGATIVE_VERDICT


def _read(log: str, as_json: bool) -> int:
    """Print what is in a log."""
    from tiltcal.logs.probe import probe_log

    with progress_bar("probe") as progress:
        found = probe_log(log, progress)
    options.print_judged(options.json_text(found.as_data()) if as_json else str(found))
    return 0


def _listen(address: Address, as_json: bool) -> int:
    """Print what a device on a serial port sends, and the address that reads its numbers."""
    with closing(open_link(address, find_model("serial-columns"))) as link:
        lines, rate = listened(link, session_clock(datetime.now(UTC), virtual=False))
    if any(line.startswith(b"$PTCDC,") for line in lines):
        raise UsageError(f"{address} sends the times of duty cycles ($PTCDC,...): name the model, as --sensor adxl202")
    found = guess([line.decode(errors="replace") for line in lines])
    if not found.roles:
        raise BusError(
            f"{address} sends text without numbers, such as {shown(lines[-1])}: is the baud rate right (baudrate=), "
            "and does the sketch print its readings?"
        )
    columns, known, count = ",".join(found.roles), bool({*found.roles} & {*AXES}), len(found.roles)
    scale = {"unit": found.unit} if found.unit else {}
    scale |= {"sensitivity": f"{found.per_g:g}"} if found.per_g else {}
    place = address.written.partition("?")[0]

    def advised(**stated: str) -> str:
        options = (f"{name}={value}" for name, value in {**address.options, **stated}.items())
        return f"{place}?{'&'.join(options)}".rstrip("?")

    if as_json:
        said = {"numbers": count, "columns": columns, "unit": found.unit, "example": found.example}
        said |= {"lines_per_second": round(rate, 1)}
        said |= {"address": advised(columns=columns, **scale) if known else advised(**scale)}
        options.print_judged(options.json_text(said))
        return 0
    if known:
        unknown = ", and unit= is not known: add it and what 1 g is, such as &unit=count&sensitivity=16384"
        shown_by = " (at rest they are as long as gravity)" if found.by == "length" or not found.unit else ""
        unit = f", unit={found.unit}{shown_by}" if found.unit else unknown
        what, how = f"as columns={columns}{unit}. If that is right:", advised(columns=columns, **scale)
    else:
        what = "which of them are the accelerations does not show (- skips one): name them, such as"
        how = advised(columns=",".join((*AXES, *"-" * count)[:count]), unit="m/s2")
    procedure = "six-face" if "z" in found.roles else "PROCEDURE"
    options.print_judged(
        f"{place} prints {counted(count, 'number')} a line, {rate:.0f} lines a second:\n  {found.example}\n{what}\n"
        f'  tiltcal measure {procedure} --sensor serial-columns --address "{how}" --serial IMU1 -o IMU1.yaml'
    )
    return 0
