"""Random calibrations, and what a header of theirs computes."""

import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, Thermal
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
G = 9.80665


def random_calibration(seed: int, unit: str = "count", reach: float = 1.2) -> CalibrationRecord:
    """Return a calibration of one to three channels with every term that there is, or without some."""
    random = np.random.default_rng(seed)
    channels = ("x", "y", "z")[: random.integers(1, 4)]
    axes = channels if len(channels) != 2 or random.random() < 0.5 else ("x", "y", "z")
    scale = 800.0 if unit == "count" else G
    sensitivity = scale * (np.eye(len(channels), len(axes)) + 0.02 * random.normal(size=(len(channels), len(axes))))
    thermal = mounting = bent = None
    if random.random() < 0.7:
        drift = random.normal(size=(len(channels), 3)) * [1e-3, 1e-5, 1e-7] * scale
        gain = random.normal(size=(len(channels), 2)) * [1e-4, 1e-6]
        thermal = Thermal(25.0, (-20.0, 60.0), drift, gain)
    if random.random() < 0.4:
        bent = random.normal(size=(len(channels), 2)) * [0.002, 0.002]
    if len(channels) > 1 and random.random() < 0.5:
        mounting = Mounting(*random.uniform(-0.5, 0.5, 3))
    offset = random.normal(scale, scale / 10.0, len(channels))
    limits = Limits(tilt=dict.fromkeys(channels, (-reach, reach)) if len(channels) < 3 else {})
    coefficients = Coefficients(channels, axes, offset, sensitivity, thermal, mounting, bent)
    return CalibrationRecord(SensorIdentity("recorded", f"R-{seed}", unit, channels), coefficients, limits=limits)


def readings(record: CalibrationRecord, count: int, seed: int) -> tuple[Array, Array]:
    """Return readings and temperatures within the calibrated range, by the forward model alone."""
    random, coefficients = np.random.default_rng(seed), record.coefficients
    up = random.normal(size=(count, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    if len(coefficients.channels) < 3:
        up[:, 1] *= len(coefficients.channels) == 2
        up[:, :2] *= np.sin(record.limits.tilt["x"][1])
        up[:, 2] = np.sqrt(1.0 - up[:, 0] ** 2 - up[:, 1] ** 2)
    temperature = random.uniform(-20.0, 60.0, count) if coefficients.thermal else np.full(count, 25.0)
    return coefficients.predict(up, temperature), temperature


def angles_apart(record: CalibrationRecord, gravity: Array, u: Array, celsius: Array) -> float:
    """Return the largest difference of an angle from that of the whole calibration, degrees."""
    true = Compensation(record.coefficients, record.limits)(u, celsius)
    if gravity.shape[1] == 3:
        cosine = np.sum(gravity * true.gravity, axis=1)
        sine = np.linalg.norm(np.cross(gravity, true.gravity), axis=1)
        return float(np.degrees(np.arctan2(sine, cosine)).max())
    return float(np.abs(np.degrees(np.arcsin(np.clip(gravity, -1.0, 1.0))) - true.tilt).max())


def drifting() -> CalibrationRecord:
    """Return the calibration of two channels whose offset and sensitivity drift, over 0 to 40 °C."""
    thermal = Thermal(20.0, (0.0, 40.0), np.array([[0.9, 4e-3], [-0.6, 2e-3]]), np.array([[2e-4], [-1e-4]]))
    matrix, axes = np.array([[819.0, 11.0], [-9.0, 822.0]]), ("x", "y")
    return replace(
        random_calibration(0),
        sensor=SensorIdentity("recorded", "A-1", "count", axes),
        coefficients=Coefficients(axes, axes, np.array([1024.0, 1021.0]), matrix, thermal),
        limits=Limits(tilt={"x": (-1.2, 1.2), "y": (-1.2, 1.2)}),
    )


MAIN = """\
#include <stdio.h>
{headers}
int main(void)
{{
    double celsius;
    int which;
    while (scanf("%d %lf", &which, &celsius) == 2) {{
        switch (which) {{
{cases}
        }}
    }}
    return 0;
}}
"""
SINGLE = """\
        case {k}: {{ float u[c{k}_CHANNELS], g[c{k}_AXES], degrees[c{k}_AXES];
            for (int i = 0; i < c{k}_CHANNELS; ++i) if (scanf("%f", &u[i]) != 1) return 1;
            c{k}_g(u, (float)celsius, g);
            c{k}_degrees(u, (float)celsius, degrees);
            for (int i = 0; i < c{k}_AXES; ++i) printf("%.9g %.9g ", (double)g[i], (double)degrees[i]);
            printf("\\n"); break; }}
"""


def compiled(folder: Path, program: str, *compiler: str) -> Path:
    """Compile a program of C, with gcc unless another compiler is named; every warning is an error."""
    (folder / "main.c").write_text(program)
    subprocess.run([*(compiler or ["gcc"]), *STRICT, "main.c", "-lm", "-o", "main"], cwd=folder, check=True)
    return folder / "main"


def computed_in_c(folder: Path, headers: Sequence[str], rows: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Return what headers named ``c0``, ``c1``, … compute of readings: gravity and tilt by turns, a row a reading."""
    for k, header in enumerate(headers):
        (folder / f"c{k}.h").write_text(header)
    included = "\n".join(f'#include "c{k}.h"' for k in range(len(headers)))
    cases = "".join(SINGLE.format(k=k) for k in range(len(headers)))
    binary = compiled(folder, MAIN.format(headers=included, cases=cases))
    lines = [
        f"{k} {t:.6f} {' '.join(f'{value:.9g}' for value in row)}"
        for k, (u, celsius) in enumerate(rows)
        for row, t in zip(u, celsius, strict=True)
    ]
    run = subprocess.run([binary], input="\n".join(lines), capture_output=True, text=True, check=True)
    printed = iter(run.stdout.splitlines())
    return [np.array([next(printed).split() for _ in u], dtype=float) for u, _ in rows]


COUNTS = """\
#include <stdio.h>
#include "tilt.h"
{setup}
int main(void)
{{
    {start}
    for (int32_t k = 0; k < {count}; ++k) {{
        {kind} u[2] = {{200 + k % 1649, 1900 - (7 * k) % 1699}};
        {body}
    }}
    {end}
    return 0;
}}
"""
FIXED = 'int32_t g[2]; tilt_g_fixed(u, (k % 40) * 100, g); printf("%ld %ld\\n", (long)g[0], (long)g[1]);'
