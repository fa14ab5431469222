"""``tiltcal plan``"""

from __future__ import annotations

import json

import click

from tiltcal.bench.channel_map import map_channels
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.device import Model
from tiltcal.files.procedure import find_procedure
from tiltcal.files.rotation import Rotation


@click.command(epilog="Example: tiltcal plan cross-axis --sensor sca100t-d02 --jig 0.05")
@click.argument("procedure")
@click.option("--sensor", required=True, metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them.")
@click.option("--address", help="Its address, where that settles facts of the model, such as counts_per_g.")
@click.option("--jig", type=click.FloatRange(0.0), metavar="DEGREES", help="Standard uncertainty of a set angle.")
@click.option(
    "--thermometer", type=click.FloatRange(0.0), metavar="CELSIUS", help="Standard uncertainty of a temperature."
)
@click.option("--noise", type=click.FloatRange(0.0), help="Standard deviation of one sample, in the sensor's unit.")
@click.option("--samples", type=click.IntRange(2), help="Samples per position, in place of the procedure's.")
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle that the procedure leaves free.")
@click.option("--json", "as_json", is_flag=True, help="Print an object for a program.")
def command(
    procedure: str,
    sensor: str,
    address: str | None,
    jig: float | None,
    thermometer: float | None,
    noise: float | None,
    samples: int | None,
    tilt: float | None,
    as_json: bool,
) -> None:
    """Predict how well PROCEDURE will determine every coefficient, before anyone starts.

    A procedure that cannot determine what it asks for is refused (exit code 2), with the position to add.
    """
    from tiltcal.calibration.prediction import mounting_outlook, outlook
    from tiltcal.calibration.unit_gravity import require_no_jig
    from tiltcal.report.prediction import outlook_text

    model = find_model(sensor)
    if address is not None:
        model = model.at(parse_address(address))
    steps = find_procedure(procedure, tilt)
    require_no_jig(steps, jig)
    if steps.rotation is not None:
        _tell_rotation(steps.rotation, model, as_json)
        return
    if steps.determines.mounting:
        _tell_mounting(mounting_outlook(steps, model, jig=jig, noise=noise, samples=samples), jig, as_json)
        return
    expected = outlook(steps, model, jig=jig, thermometer=thermometer, noise=noise, samples=samples)
    if not as_json:
        click.echo(outlook_text(expected))
        return
    prediction = expected.prediction
    click.echo(
        json.dumps(
            {
                "noise": expected.noise,
                "jig": jig,
                "uncertainty": prediction.uncertainty(),
                "degrees_of_freedom": prediction.dof,
                "correlations": [list(pair) for pair in prediction.correlations],
                "worth_adding": [list(one) for one in prediction.worth_adding],
            }
        )
    )


_UNKNOWN = (
    "nothing to predict before the stage turns: p and q come out with a standard uncertainty of 2 s / (A sqrt(n)), "
    "after n samples of noise s, where A is the amplitude that an accelerometer has at the turning; it shows then"
)


def _tell_mounting(expected: dict[str, float], jig: float | None, as_json: bool) -> None:
    """How well the positions tell the angles of a mounting."""
    if as_json:
        click.echo(json.dumps({"jig": jig, "uncertainty": {f"mounting.{angle}": u for angle, u in expected.items()}}))
        return
    stated = "a perfect jig (none is stated)" if jig is None else f"a jig of {jig:g}°"
    click.echo(f"predicted standard uncertainty of a sensor that sits straight, with its noise and {stated}:")
    for angle, u in expected.items():
        click.echo(f"  {angle:<6} {u:.2g}°")
    click.echo("  what its calibration is uncertain by comes on top")


def _tell_rotation(rotation: Rotation, model: Model, as_json: bool) -> None:
    """Which pairs a device has, and why no more can be said."""
    hookup = map_channels(rotation, [("", model)])
    if as_json:
        pairs = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in hookup.pairs]
        left_out = list(hookup.left_out)
        click.echo(json.dumps({"pairs": pairs, "turns": rotation.turns, "left_out": left_out, "why": _UNKNOWN}))
        return
    for pair in hookup.pairs:
        click.echo(f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}, in up to {rotation.turns} turns")
    for why in hookup.left_out:
        click.echo(why)
    click.echo(_UNKNOWN)
