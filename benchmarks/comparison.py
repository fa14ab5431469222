"""How near a kitchen table and a reference bring a sensor: blind benches with `measure comparison`.

    python benchmarks/comparison.py [--benches 200]

Each bench draws a sensor (SCL3300 and ADXL355 in turn) within its data sheet, with noise and non-linearity, screwed
to a plate as it came, and a reference whose zero and scale are within U = 0.005° (k = 2) at 30°, with 0.001° of
repeatability and up to a degree about the vertical. The plate is set by hand, to within 3° of what is asked, and
nobody states an angle. Then the tilt of each axis over ±30°, with the other level and along the axes of the reference,
is compared with the truth. Exit code 1 where less than 93 % of the 95 % intervals hold, or less than 95 % of the axes
stay within 0.01°. Creep, and a plate that bends as it is tilted, are not in it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from math import cos, radians, sin
from pathlib import Path
from statistics import quantiles

import numpy as np
import yaml

from tiltcal import Calibration, measure
from tiltcal.drivers import find_model
from tiltcal.drivers.virtual import Truth
from tiltcal.errors import HardwareError
from tiltcal.files.bench import BenchFile, BenchReference, BenchSensor

MODELS = ("scl3300", "adxl355")
UNCERTAINTY, RANGE, EACH, TURN = 0.005, 30.0, 0.001, 1.0
"""Of the reference: U (k = 2) of zero and scale together, at, of each tilt, askew; degrees."""
BY_HAND = 3.0  # standard deviation of an inclination from what is asked for, degrees
LIMIT, HELD, WITHIN = 0.01, 0.93, 0.95
TILTS = np.linspace(-30.0, 30.0, 25)
INCLINATIONS, NEEDED = 8, 30.0  # seconds of the operator for one


@dataclass(frozen=True)
class Outcome:
    """The errors of one axis over its range and half of their 95 % intervals, degrees, and what the session took, s."""

    errors: np.ndarray
    halves: np.ndarray
    seconds: float


def twin(path: Path, truth: Truth) -> None:
    """Write the twin file of a truth."""
    names = ("offset", "sensitivity", "noise", "nonlinearity", "jig", "ambient")
    section = {name: value for name, value in asdict(truth).items() if name in names}
    section["nonlinearity"] = {channel: list(terms) for channel, terms in truth.nonlinearity.items()}
    path.write_text(yaml.safe_dump({"tiltcal": 1, "kind": "twin", "seed": truth.seed, "truth": section}))


def drawn(number: int, rng: np.random.Generator) -> tuple[str, Truth, float]:
    """Return a sensor and the turn of the reference, radians; its noise and non-linearity are those of its model."""
    name = MODELS[number % len(MODELS)]
    model = find_model(name)
    truth = model.default_truth(number)
    bend = tuple(rng.normal(0.0, one) for one in model.nonlinearity)
    bends = dict.fromkeys(truth.channels, bend) if bend else {}
    ambient = 24.0 + rng.uniform(-0.5, 0.5)
    truth = replace(truth, drift={}, gain={}, nonlinearity=bends, jig=BY_HAND, ambient=ambient, thermometer_error=0.0)
    return name, truth, radians(rng.normal(0.0, TURN))


def instrument(seed: int, turn: float, rng: np.random.Generator) -> Truth:
    """Return a reference that reads the sines of the tilts, with its zero, its scale and its turn."""
    zero = np.radians(rng.normal(0.0, UNCERTAINTY / 2.0, 2))
    scale = 1.0 + rng.normal(0.0, UNCERTAINTY / 2.0 / RANGE, 2)
    rows = scale[:, None] * np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]])
    return Truth(
        ("x", "y"),
        dict(zip("xy", zero.tolist(), strict=True)),
        {channel: dict(zip("xy", row, strict=True)) for channel, row in zip("xy", rows.tolist(), strict=True)},
        noise=dict.fromkeys("xy", radians(EACH)),
        seed=seed,
    )


def bench(number: int, folder: Path) -> list[Outcome]:
    """Calibrate one sensor, and judge its axes."""
    rng = np.random.default_rng([7, number])
    name, truth, turn = drawn(number, rng)
    twin(folder / "sensor.yaml", truth)
    twin(folder / "reference.yaml", instrument(number, turn, rng))
    reference = BenchReference(
        model="serial-columns", address="sim:columns=x,y&unit=g&twin=reference.yaml", uncertainty=UNCERTAINTY,
        range=RANGE, repeatability=EACH, alignment=TURN,
    )  # fmt: skip
    sensor = BenchSensor(f"S-{number}", name, "sim:twin=sensor.yaml")
    found: Calibration = measure(
        "comparison", bench=BenchFile((sensor,), reference=reference), operator="sim", output=".", samples=50,
        settle=0.5, tilt=RANGE, journal=folder / "session.jsonl",
    )  # fmt: skip
    record = found.record.provenance
    seconds = (np.datetime64(record.ended[:-1]) - np.datetime64(record.started[:-1])) / np.timedelta64(1, "s")
    outcomes = []
    for axis in "xy":
        # Up along the axes of the reference, which are turned against those of the plate.
        sines = np.sin(np.radians(TILTS))
        along = np.array([cos(turn), sin(turn)]) if axis == "x" else np.array([-sin(turn), cos(turn)])
        ups = np.column_stack([np.outer(sines, along), np.sqrt(1.0 - sines**2)])
        rows = {c: [truth.reading(c, tuple(up), truth.ambient) for up in ups] for c in truth.channels}
        applied = found.apply(rows, uncertainty=True)
        angle = np.asarray(applied[f"tilt_{axis}"] if f"tilt_{axis}" in applied else applied["tilt"])
        outcomes.append(Outcome(angle - TILTS, np.asarray(applied[f"U95_tilt_{axis}"]), float(seconds)))
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=200)
    stated = parser.parse_args()
    outcomes, refused = list[Outcome](), 0
    for number in range(stated.benches):
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            try:
                outcomes += bench(number, Path(folder))
            except HardwareError as error:
                refused += 1
                print(f"bench {number}: {error}", file=sys.stderr)
            os.chdir("/")
    errors = np.array([np.abs(one.errors) for one in outcomes])
    held = float(np.mean(errors <= [one.halves for one in outcomes]))
    worst = errors.max(axis=1)
    within = float(np.mean(worst <= LIMIT))
    print(f"{refused} sessions refused; {len(outcomes)} axes: {100 * held:.1f} % of the 95 % intervals hold the truth")
    print(f"{100 * within:.1f} % stay within {LIMIT:g}°; 95 % have no error above {quantiles(worst, n=20)[-1]:.4f}°")
    minutes = (max(one.seconds for one in outcomes) + INCLINATIONS * NEEDED) / 60.0
    print(f"a session takes {minutes:.1f} min, with {NEEDED:g} s to set each of {INCLINATIONS} inclinations")
    return int(held < HELD or within < WITHIN)


if __name__ == "__main__":
    sys.exit(main())
