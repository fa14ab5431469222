"""Is the bound that ``export`` states ever exceeded, and does an Arduino compute what ``apply`` does?

    python benchmarks/export.py [--calibrations 10000] [--readings 100000]

Random calibrations with every term that there is, at random attitudes and temperatures which the bound has not seen;
for C compiled with gcc, a hundred headers a program, and on an ATmega328P under simavr. Exit code 1 where a bound is
exceeded, a header is more than 0.002° from ``apply``, or the Arduino more than 3 µg of 1 g.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.export_study import (
    COUNTS,
    FIXED,
    angles_apart,
    compiled,
    computed_in_c,
    drifting,
    random_calibration,
    readings,
)

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array
from tiltcal.export.loss import largest_error
from tiltcal.export.targets import TARGETS, Source, exported

THREE_AXES = ("fusion", "ros", "px4", "ardupilot")
BATCH, ROWS = 100, 50


def of_formulas(target: str, calibrations: int) -> float:
    """Return the largest share of its bound that an error of a target's formula has."""
    worst = 0.0
    for seed in range(calibrations):
        record = random_calibration(seed, "m/s2" if target in ("px4", "ardupilot") else "count")
        if target in THREE_AXES and len(record.sensor.channels) < 3:
            continue
        export = TARGETS[target](Source(record, record.limits))
        u, celsius = readings(record, ROWS, seed)
        if export.step:
            u, celsius = np.rint(u / export.step) * export.step, np.rint(celsius * 100.0) / 100.0
        bound = largest_error(record.coefficients, record.limits, export.formula, export.rounding, export.step)
        error = angles_apart(record, export.formula(u, celsius), u, celsius)
        worst = max(worst, error / bound if bound > 1e-9 else error)
    return worst


def of_headers(calibrations: int) -> tuple[float, float]:
    """Return the largest share of its bound that an error of a compiled header has, and the largest error, degrees."""
    worst, largest = 0.0, 0.0
    for first in range(0, calibrations, BATCH):
        records = [random_calibration(seed, reach=0.7) for seed in range(first, min(first + BATCH, calibrations))]
        headers = [exported(Source(record, record.limits, f"c{k}"), "c") for k, record in enumerate(records)]
        rows = [readings(record, ROWS, first + k) for k, record in enumerate(records)]
        with TemporaryDirectory() as folder:
            tables = computed_in_c(Path(folder), [one.text for one in headers], rows)
        for record, header, table, (u, celsius) in zip(records, headers, tables, rows, strict=True):
            error = angles_apart(record, table[:, ::2], u, celsius)
            worst, largest = max(worst, error / header.bound), max(largest, error)
    return worst, largest


SETUP = """\
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
static int put(char c, FILE *f) { (void)f; while (!(UCSR0A & (1 << UDRE0))) { } UDR0 = c; return 0; }
static FILE serial = FDEV_SETUP_STREAM(put, NULL, _FDEV_SETUP_WRITE);
"""
START, END = "UCSR0B = 1 << TXEN0; stdout = &serial;", "cli(); sleep_mode();"
SINGLE = 'float g[2]; tilt_g(u, k % 40, g); printf("%ld %ld\\n", (long)(g[0] * 1e6f), (long)(g[1] * 1e6f));'


def on_an_arduino(folder: Path, header: str, kind: str, count: int) -> Array:
    """Return what an ATmega328P computes of whole readings at 0 to 39 °C, g, shape (n, 2)."""
    (folder / "tilt.h").write_text(header)
    body = FIXED if kind == "int32_t" else SINGLE
    program = COUNTS.format(setup=SETUP, start=START, end=END, count=count, kind=kind, body=body)
    elf = compiled(folder, program, "avr-gcc", "-mmcu=atmega328p", "-Os")
    command = ["simavr", "-m", "atmega328p", "-f", "16000000", str(elf)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    return np.array(re.findall(r"(-?\d+) (-?\d+)\.", run.stdout + run.stderr), dtype=float) * 1e-6


def of_counts(count: int) -> Array:
    """Return what ``apply`` makes of the readings of :data:`COUNTS` at 0 to 39 °C, g, shape (n, 2)."""
    k = np.arange(count)
    u = np.column_stack([200.0 + k % 1649, 1900.0 - (7 * k) % 1699])
    return np.array(Compensation(drifting().coefficients)(u, k % 40 * 1.0).gravity)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calibrations", type=int, default=10_000)
    parser.add_argument("--readings", type=int, default=100_000)
    options = parser.parse_args()
    shares = {}
    for target in TARGETS:
        if target != "c":
            shares[target] = of_formulas(target, options.calibrations)
            print(f"{target:10} largest error over its bound {shares[target]:.3f}", flush=True)
    shares["c"], largest = of_headers(options.calibrations)
    print(f"c, gcc     largest error over its bound {shares['c']:.3f}, {largest:.2g}°", flush=True)
    apart = 0.0
    for kind, target in (("float", "c"), ("int32_t", "c-fixed")):
        record = drifting()
        with TemporaryDirectory() as folder:
            header = exported(Source(record, record.limits), target).text
            computed = on_an_arduino(Path(folder), header, kind, options.readings)
        apart = max(apart, float(np.abs(computed - of_counts(options.readings)).max()))
        print(f"{target:10} {len(computed)} readings on an ATmega328P, {1e6 * apart:.2f} µg apart", flush=True)
    return int(max(shares.values()) > 1.0 or largest > 0.002 or apart > 3e-6)


if __name__ == "__main__":
    sys.exit(main())
