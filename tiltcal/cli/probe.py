"""``tiltcal probe``: test the wiring of a sensor."""

from __future__ import annotations

import click

from tiltcal.bench.devices import open_sensor
from tiltcal.cli import options
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import SelfTesting
from tiltcal.errors import NEGATIVE_VERDICT, UsageError


@options.command(epilog="Example: tiltcal probe --sensor sca100t-d02 --address spi:///dev/spidev0.0 --self-test")
@click.option("--sensor", required=True, metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them.")
@click.option(
    "--address", required=True, help="Its address, such as spi:///dev/spidev0.0, or sim: for its virtual twin."
)
@click.option("--self-test", "self_test", is_flag=True, help="Start the self-test of the part; lay it level and still.")
@options.as_json
def command(sensor: str, address: str, self_test: bool, as_json: bool) -> int:
    """Test the connection of a sensor, and print its answer.

    Exit code 3 if it does not answer, 1 if its self-test fails.
    """
    model = find_model(sensor).at(parse_address(address))
    with open_sensor(sensor, address) as driver:
        said = dict(driver.probe())
        tests = {}
        if self_test:
            if not isinstance(driver, SelfTesting):
                raise UsageError(f"{model.name} has no self-test")
            tests = {channel: driver.self_test(channel) for channel in model.channels}
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
