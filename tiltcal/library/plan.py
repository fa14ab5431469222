"""A procedure judged before anybody starts: the library's ``plan``, which ``tiltcal plan`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

from tiltcal.bench.options import PlanOptions
from tiltcal.bench.setup import stage_channels
from tiltcal.calibration.fit import along_gravity
from tiltcal.calibration.measurement import require_no_jig, require_suitable
from tiltcal.calibration.prediction import PredictedMounting, PredictedUncertainty, predict, predict_mounting
from tiltcal.calibration.record import bases_of
from tiltcal.core.pair.model import Pair
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.procedure import Procedure, find_procedure
from tiltcal.options import complete, takes
from tiltcal.printable import in_html

_NOT_PREDICTED = (
    "nothing can be predicted before the stage turns: p and q will have a standard uncertainty of 2 s / (A sqrt(n)), "
    "after n samples of noise s, where A is the amplitude of an accelerometer at the spin frequency"
)


@dataclass(frozen=True)
class PlannedRotation:
    """The pairs that a rotation will match; their uncertainty depends on the amplitude, which is not known before.

    Attributes
    ----------
    turns : int
        The most turns of the stage.
    left_out : tuple of str
        Why other pairs are not matched.
    """

    pairs: tuple[Pair, ...]
    turns: int
    left_out: tuple[str, ...]

    def as_data(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        pairs = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in self.pairs]
        return {"pairs": pairs, "turns": self.turns, "left_out": list(self.left_out), "why": _NOT_PREDICTED}

    def __str__(self) -> str:
        pairs = (
            f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}, in up to {self.turns} turns"
            for pair in self.pairs
        )
        return "\n".join([*pairs, *self.left_out, _NOT_PREDICTED])

    __repr__ = __str__
    _repr_html_ = in_html


@takes(PlanOptions)
def plan(
    procedure: str | Path, **options: Unpack[PlanOptions]
) -> PredictedUncertainty | PredictedMounting | PlannedRotation:
    """Predict how well a procedure will determine every coefficient, before anybody starts.

    Parameters
    ----------
    procedure : str or Path
        Its name, or the path of your own.
    **options

    Returns
    -------
    PredictedUncertainty, PredictedMounting or PlannedRotation
        By the kind of procedure; each prints as ``tiltcal plan`` does.

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
        return PlannedRotation(channels.pairs, steps.rotation.turns, channels.left_out)
    require_suitable(steps, model, based=own is not None)
    if steps.determines.mounting:
        return predict_mounting(steps, model, jig=jig, noise=noise, samples=samples)
    known = partial(
        predict, jig=jig, thermometer=stated["thermometer"], table_lean=stated["table_lean"], noise=noise,
        samples=samples, base=own,
    )  # fmt: skip
    found = known(steps, model)
    if steps.closes or steps.determines.free or steps.ramp is not None or len(steps.positions) < 2:
        return found
    closed = known(steps.with_closing(True), model)
    return replace(
        found, closing=_closing_in_words(steps, found.design.channels, samples or steps.samples, closed.prediction.dof)
    )


def _model(sensor: str | None, address: str | None, own: CalibrationRecord | None) -> Model:
    """Return the model that is named, or that of the sensor's calibration, as it is connected at the address."""
    name = sensor if own is None else sensor or own.sensor.model
    if name is None:
        raise UsageError("name the --sensor model, or its calibration with --base")
    model = find_model(name)
    return model if address is None else model.at(parse_address(address))


def _closing_in_words(steps: Procedure, channels: Sequence[str], samples: int, dof: int) -> str:
    """Return what ``--closing`` takes, and the degrees of freedom that it leaves."""
    first = steps.positions[0]
    soaked = "" if first.temperature is None else f"a soak at {first.temperature:g} °C and "
    steep = along_gravity(channels, [position.gravity for position in steps.positions])
    advised = "--closing is recommended, as along gravity nothing else shows a drift: it" if steep else "--closing"
    return (
        f"{advised} takes {first.name} again at the end ({soaked}{samples} samples), and leaves {dof} degrees of "
        "freedom, which show what has changed"
    )
