"""A procedure judged before anybody starts: the library's ``plan``, which ``tiltcal plan`` prints."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from tiltcal.bench.options import PlanOptions
from tiltcal.bench.setup import stage_channels
from tiltcal.calibration.measurement import require_no_jig, require_suitable
from tiltcal.calibration.prediction import Plan, predict, predict_mounting
from tiltcal.calibration.record import bases_of
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.procedure import find_procedure
from tiltcal.options import complete, takes

_NOT_PREDICTED = (
    "nothing can be predicted before the stage turns: p and q will have a standard uncertainty of 2 s / (A sqrt(n)), "
    "after n samples of noise s, where A is the amplitude of an accelerometer at the spin frequency"
)


@takes(PlanOptions)
def plan(procedure: str | Path, **options: Unpack[PlanOptions]) -> Plan:
    """Predict how well a procedure will determine every coefficient, before anybody starts.

    Parameters
    ----------
    procedure : str or Path
        Its name, or the path of your own.
    **options

    Returns
    -------
    Plan
        It prints as ``tiltcal plan`` does; ``uncertainty`` is by the name of each coefficient. That of the pairs of a
        stage depends on their amplitude, which is not known before it turns.

    Raises
    ------
    EstimateError
        The positions cannot determine what the procedure asks for; the message names the position to add.
    UsageError
        The model or the procedure is unknown, or does not go with the other.

    Examples
    --------
    >>> print(tiltcal.plan("zero-45", sensor="sca100t-d02", jig=0.1))
    """
    stated = complete(PlanOptions, options)
    jig, noise, samples, base = stated["jig"], stated["noise"], stated["samples"], stated["base"]
    own = None if base is None else read_calibration(base)
    model = _model(stated["sensor"], stated["address"], own)
    steps = find_procedure(procedure, stated["tilt"]).with_closing(stated["closing"])
    require_no_jig(steps, jig)
    if own is not None or steps.determines.level:
        bases_of(steps, base, [] if own is None else [own.sensor.serial])
    if steps.rotation is not None:
        channels = stage_channels(steps.rotation, [("", model)])
        pairs = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in channels.pairs]
        lines = [f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}" for pair in channels.pairs]
        data = {"pairs": pairs, "turns": steps.rotation.turns, "left_out": list(channels.left_out)}
        return Plan({**data, "why": _NOT_PREDICTED}, "\n".join([*lines, *channels.left_out, _NOT_PREDICTED]))
    require_suitable(steps, model)
    if steps.determines.mounting:
        return predict_mounting(steps, model, jig=jig, noise=noise, samples=samples)
    return predict(
        steps, model, jig=jig, thermometer=stated["thermometer"], table_lean=stated["table_lean"], noise=noise,
        samples=samples, base=own,
    )  # fmt: skip


def _model(sensor: str | None, address: str | None, own: CalibrationRecord | None) -> Model:
    """Return the model that is named, or that of the sensor's calibration, as it is connected at the address."""
    name = sensor if own is None else sensor or own.sensor.model
    if name is None:
        raise UsageError("name the --sensor model, or its calibration with --base")
    model = find_model(name)
    return model if address is None else model.at(parse_address(address))
