"""The uncertainty that a procedure will leave, predicted before the operator starts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import hypot, radians, sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.angle_units import FEWER, identified, too_steep
from tiltcal.calibration.fit import covered_tilts
from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.calibration.priors import design_of
from tiltcal.calibration.tilt_uncertainty import half_widths, tilt_lines
from tiltcal.calibration.wording import label
from tiltcal.core.attitude import STRAIGHT, Orientation, solve_mounting
from tiltcal.core.estimation.design import predict_uncertainty
from tiltcal.core.estimation.positions import Design, Observation
from tiltcal.core.model import Array, Limits
from tiltcal.core.samples import rounding_of_means
from tiltcal.drivers.model import Model
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.procedure import MountingCompletion, Position, PositionProcedure, Ramp, find_procedure
from tiltcal.printable import in_html, in_minutes

PARTS = 8  # positions that stand for a leg of a ramp

LEAN = (
    "If the table is not level, its tilt is in the offsets: turn the fixture by 180° and repeat one position, or state "
    "--table-lean."
)

SIXTEEN, INCLINATIONS, SUFFICES = "comparison-16", (8, 12, 16), 1.05
"""The comparison that has most inclinations; how many are tried, and within which factor of the best they suffice."""

SHOWN = 3  # positions that are proposed in words


@dataclass(frozen=True)
class Plan:
    """What a procedure will determine, as plain data and in words."""

    data: Mapping[str, Any]
    text: str
    brief: str = ""
    """The tilts near level and what they assume, in one line."""

    @property
    def uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each coefficient by its dotted name, in its unit; empty for a rotation."""
        return dict(self.data.get("uncertainty", {}))

    def as_data(self) -> dict[str, Any]:
        """Return the plan as plain data."""
        return dict(self.data)

    def __str__(self) -> str:
        return self.text

    __repr__ = __str__
    _repr_html_ = in_html


def _predict_mounting(
    procedure: MountingCompletion, model: Model, bench: BenchUncertainty, scatter: float, samples: int
) -> Plan:
    """Predict the uncertainty of a mounting beside that of the calibration, of a sensor that sits straight."""
    read = scatter / sqrt(samples) / model.sensitivity
    known = np.array([position.gravity for position in procedure.positions])
    turns = solve_mounting(known, known, np.full(len(known), hypot(radians(bench.jig or 0.0), read))).covariance
    u = dict(zip(ANGLES, np.degrees(np.sqrt(np.diag(turns))).tolist(), strict=True))
    with_what = f"with its noise and {_jig_in_words(bench)}"
    lines = [
        f"predicted standard uncertainty of a sensor that is mounted straight, {with_what}:",
        *(f"  {angle:<6} {value:.2g}°" for angle, value in u.items()),
        "  that of its calibration comes on top",
    ]
    data = {"jig": bench.jig, "uncertainty": {f"mounting.{angle}": value for angle, value in u.items()}}
    return Plan(data, "\n".join(lines), lines[0].rstrip(":"))


def predict(
    procedure: PositionProcedure,
    model: Model,
    bench: BenchUncertainty,
    *,
    noise: float | None = None,
    samples: int | None = None,
    settle: float | None = None,
    orientation: Orientation = STRAIGHT,
    sensors: int = 1,
    base: CalibrationRecord | None = None,
    proposing: bool = True,
) -> Plan:
    """Predict the standard uncertainty of every coefficient equal sensors reach; no stated jig is a perfect one.

    What is worth adding is looked for where ``proposing``, which takes most of the time.
    """
    samples, scatter = samples or procedure.samples, _usual_noise(model) if noise is None else noise
    seconds = procedure.least_seconds(samples, model.interval, settle or procedure.settle, done=0)
    match procedure:
        case MountingCompletion():
            return _predict_mounting(procedure, model, bench, scatter, samples)
        case Ramp():
            procedure = _along_ramp(procedure)
    if bench.thermometer is None:
        bench = replace(bench, thermometer=model.thermometer_rounding)
    identity = identified(SensorIdentity(model.name, "", model.unit, model.channels, angles=model.angles), procedure)
    design, drift = design_of(identity, procedure, bench, nominal=model, base=base), _usual_drift(model, base)
    kept = _usable(procedure, identity)
    planned = _planned(kept, design, model, orientation, scatter, samples)
    expected = partial(predict_uncertainty, design, sensitivity=model.sensitivity, sensors=sensors)
    found = expected(planned, drift=drift, level=procedure.renews, proposing=proposing)
    limits = Limits(covered_tilts(design.channels, [position.gravity.tolist() for position in planned]))
    tilts = half_widths(found.coefficients, found.uncertain, limits)
    by_count = dict[int, float]()
    if bench.instrument is not None and procedure.compares:
        usual = find_procedure(SIXTEEN, procedure.angle).in_positions().positions[len(kept) :]
        further = [*planned, *_planned(usual, design, model, orientation, scatter, samples)] if usual else planned
        for count in sorted({len(kept), *(count for count in INCLINATIONS if count > len(kept))}):
            reached = expected(further[:count], proposing=False)
            halves = half_widths(reached.coefficients, reached.uncertain, limits)
            by_count[count] = max(float(halves[axis][1].max()) for axis in bench.instrument.axes)
    headings = {(position.heading or 0.0) % 360.0 for position in procedure.positions}
    not_covered = LEAN if len(headings) == 1 and bench.table_lean is None and not design.free else None
    data = {
        "noise": scatter,
        "jig": None if design.free else design.jig,
        "uncertainty": found.uncertain.by_name(found.uncertain.u),
        "degrees_of_freedom": found.dof,
        "tilt": {
            axis: [[round(float(tilt[k]), 6), float(half[k])] for k in (0, _level(tilt), -1)]
            for axis, (tilt, half) in tilts.items()
        },
        "seconds": seconds,
        "worth_adding": [list(position) for position in found.worth_adding],
        "not_covered": not_covered,
    }
    lines = [*_lines(data, model, bench, design, drift, tilts), *([f"  {not_covered}"] if not_covered else [])]
    if by_count:
        data["inclinations"], said = _enough(by_count)
        lines.append(said)
    return Plan(data, "\n".join(lines), _near_level(tilts, "" if design.free else _assumed(bench)))


def _usable(procedure: PositionProcedure, identity: SensorIdentity) -> list[Position]:
    """Return the positions that do not stand a channel of angles too steep; an EstimateError where none is left."""
    reads = identity.angle_readings
    if kept := [one for one in procedure.positions if not too_steep(one.gravity, identity.channels, reads)]:
        return kept
    raise EstimateError(f"{procedure.name} leaves no position to {identity.model}: {FEWER}")


def _planned(
    positions: Sequence[Position], design: Design, model: Model, orientation: Orientation, scatter: float, samples: int
) -> list[Observation]:
    """Return what positions will observe, with the uncertainty of their means."""
    adc = rounding_of_means(scatter**2, model.resolution, len(positions)) if model.resolution else 0.0
    u = max(hypot(scatter / sqrt(samples), adc), 1e-12 * abs(model.sensitivity))
    if design.angles is not None:
        u, adc = (float(one * design.angles.steepness(np.zeros(()))) for one in (u, adc))
    settings = [None, *((position.gravity, position.heading) for position in positions)]
    return [
        Observation(
            one.name,
            np.array(orientation.seen(one.gravity)),
            np.zeros(len(design.channels)),
            np.full(len(design.channels), u),
            design.reference if one.temperature is None else one.temperature,
            one.heading,
            held=setting == before,
            adc=adc,
        )
        for one, (before, setting) in zip(positions, pairwise(settings), strict=True)
    ]


def _level(tilt: Array) -> int:
    """Return which of some tilts is nearest to level."""
    return int(np.argmin(np.abs(tilt)))


def _near_level(tilts: Mapping[str, tuple[Array, Array]], assumed: str) -> str:
    """Return what is predicted near level, in words."""
    near = ", ".join(f"tilt {axis} ± {half[_level(tilt)]:.2g}°" for axis, (tilt, half) in tilts.items())
    return f"{near} near level (95 %) is predicted {assumed}".rstrip()


def _enough(by_count: Mapping[int, float]) -> tuple[int, str]:
    """Return how many inclinations suffice, and that in words, of what each number of them reaches, degrees."""
    fewest = min(count for count, u in by_count.items() if u <= SUFFICES * min(by_count.values()))
    reached = ", ".join(f"± {u:.2g}° with {count}" for count, u in by_count.items())
    return fewest, f"  {fewest} inclinations suffice: all tilts within {reached}"


def _lines(
    data: Mapping[str, Any],
    model: Model,
    bench: BenchUncertainty,
    design: Design,
    drift: float,
    tilts: Mapping[str, tuple[Array, Array]],
) -> Iterator[str]:
    """Yield a plan in words."""
    set_by = "positions that are not set" if design.free else _jig_in_words(bench)
    yield f"predicted standard uncertainty, with {data['noise']:.2g} {model.unit} of noise a sample and {set_by}:"
    if design.thermal and design.thermometer:
        part = f"for a part that drifts by {drift:.2g} {model.unit}/°C"
        yield f"  and temperatures that are known to {design.thermometer:.2g} °C, {part}"
    for name, u in data["uncertainty"].items():
        # What unit gravity leaves open is the choice of a frame, in which these are 0.
        if u > 0.0 or not design.free:
            yield f"  {name:<28} {u:.2g} {label(name, model.unit).unit}".rstrip()
    yield from tilt_lines(tilts)
    dof = data["degrees_of_freedom"]
    yield f"  degrees of freedom {dof}{'' if dof else ': no residuals are left to check the result'}"
    for name, coefficient, share in data["worth_adding"][:SHOWN]:
        cut = f"would cut the uncertainty of {_in_words(coefficient)} by {100 * (1 - share):.0f} %"
        yield f"  One more position, {name}, {cut}"
    if bench.jig is None and not design.free:
        yield f"  This is {_assumed(bench)}"
    held = in_minutes(data["seconds"])
    yield f"  readings are held still and sampled for {held}; setting and changing temperatures on top"


def _assumed(bench: BenchUncertainty) -> str:
    """Return what a prediction takes for granted of the angles that are set."""
    if bench.jig is not None:
        return f"with {_jig_in_words(bench)}"
    return "if every angle is set exactly: no --jig is stated, and what the positions show will be larger"


def _along_ramp(procedure: Ramp) -> Ramp:
    """Return a ramp as positions on the way between its turning points, by which its uncertainty is predicted."""
    ways = pairwise([procedure.reference, *procedure.turns])
    positions = tuple(
        replace(procedure.positions[0], name=f"leg-{leg}-{part + 1}", temperature=start + (end - start) * part / PARTS)
        for leg, (start, end) in enumerate(ways, start=1)
        for part in range(PARTS)
    )
    return replace(procedure, positions=positions)


def _in_words(coefficient: str) -> str:
    """Return the symbol of a sensitivity, and another coefficient by its name."""
    letter, index = label(coefficient).symbol
    name = label(coefficient).words
    return f"S_{index}" if letter == "S" else f"the {name[:1].lower()}{name[1:]}"


def _jig_in_words(bench: BenchUncertainty) -> str:
    if bench.instrument is not None:
        return f"a reference whose zero is known to {bench.instrument.zero:.2g}°, each tilt to {bench.jig:.2g}°"
    return "a perfect jig (none is stated)" if bench.jig is None else f"a jig of {bench.jig:g}°"


def _usual_noise(model: Model) -> float:
    """Return the noise of a sample of the model's virtual part, at least that of rounding, unit."""
    known = max(model.default_truth(0).noise.values(), default=0.0)
    return hypot(known, model.resolution / sqrt(12))


def _usual_drift(model: Model, base: CalibrationRecord | None) -> float:
    """Return the drift of the offset, root mean square of the channels: the base's, or the virtual part's, unit/°C."""
    thermal = None if base is None else base.coefficients.thermal
    if thermal is not None and thermal.drift.size:
        slopes = thermal.drift[:, 0]
    else:
        usual = model.default_truth(0).drift.values()
        slopes = np.array([terms[0] for terms in usual if terms] or [0.0])
    return float(np.sqrt(np.mean(slopes**2)))
