"""Do heading, levels, interpolated calibrations and means of the season of a tilt meter hold what they state.

The truth is made here, with rotations of scipy and random numbers; the results come through the library and its files.

    python benchmarks/season.py                 # all, some minutes
    python benchmarks/season.py heading means
    python benchmarks/season.py folder          # times: on a quiet machine
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

import tiltcal

START = datetime(2026, 1, 1, tzinfo=UTC)
NAMES = [*"xyz"]


def calibration(folder: Path, name: str, offset: Any, sensitivity: Any, stated: str = "", *, days: float = 0.0) -> Path:
    """Write a calibration file and return its path; channels are as many as offsets."""
    axes = NAMES[: len(offset)]
    rows = ", ".join(
        f"{axis}: {{{', '.join(f'{other}: {float(value)!r}' for other, value in zip(axes, row, strict=True))}}}"
        for axis, row in zip(axes, sensitivity, strict=True)
    )
    offsets = ", ".join(f"{axis}: {float(value)!r}" for axis, value in zip(axes, offset, strict=True))
    ended = f"{START + timedelta(days=days):%Y-%m-%dT%H:%M:%SZ}"
    text = (
        f"tiltcal: 1\nkind: tilt\nsensor: {{model: benchmark, serial: {name.split('@')[0]}, unit: count, "
        f"channels: [{', '.join(axes)}]}}\ncalibration:\n  offset: {{{offsets}}}\n  sensitivity: {{{rows}}}\n"
        f'{stated}provenance:\n  started: "{ended}"\n  ended: "{ended}"\n'
    )
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def uncertain(names: list[str], covariance: np.ndarray, noise: float, axes: list[str]) -> str:
    """Return the section ``uncertainty`` of a file."""
    single = ", ".join(f"{axis}: {noise}" for axis in axes)
    matrix = ", ".join(str(row) for row in covariance.tolist())
    return (
        f"uncertainty:\n  single_reading: {{{single}}}\n  covariance:\n    parameters: [{', '.join(names)}]\n"
        f"    matrix: [{matrix}]\n"
    )


def share(inside: Any, independent: int) -> str:
    """Return a share of intervals in per cent, with its Monte Carlo error."""
    part = float(np.mean(inside))
    return f"{100 * part:.2f} ± {100 * np.sqrt(part * (1 - part) / independent):.2f} %"


def heading(folder: Path) -> None:
    """10,000 random attitudes against rotations, and as many with errors of the stated size in each row."""
    draw, n, declination = np.random.default_rng(1), 10_000, 7.5
    to_earth = Rotation.random(n, random_state=draw)  # of the instrument; earth: east, north, up
    up = to_earth.inv().apply([0.0, 0.0, 1.0])
    angle = np.radians(declination)
    field = to_earth.inv().apply([20.0 * np.sin(angle), 20.0 * np.cos(angle), -40.0])
    velocity = draw.normal(size=(n, 3))
    flow, ahead = to_earth.apply(velocity), to_earth.apply([1.0, 0.0, 0.0])
    true = np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1])) % 360.0
    sensitivity = np.array([[820.0, 12.0, -5.0], [-9.0, 815.0, 7.0], [4.0, -6.0, 830.0]])
    options: dict[str, Any] = {
        "magnetometer": "mx,my,mz",
        "velocity": "u,v,w",
        "declination": declination,
    }

    def columns(readings: np.ndarray, measured: np.ndarray) -> dict[str, np.ndarray]:
        table = {axis: readings[:, k] for k, axis in enumerate(NAMES)}
        for k, name in enumerate(("mx", "my", "mz")):
            table[name] = measured[:, k]
        return table | {name: velocity[:, k] for k, name in enumerate("uvw")}

    exact = tiltcal.read(calibration(folder, "exact", [1000.0, 1010.0, 990.0], sensitivity))
    out = exact.apply(columns([1000.0, 1010.0, 990.0] + up @ sensitivity.T, field), **options)
    off = np.abs((out["heading"] - true + 180.0) % 360.0 - 180.0)
    enu = np.stack([out["v_east"], out["v_north"], out["v_up"]], axis=1)
    print(f"heading     largest error {off.max():.1e}°, of a velocity {np.abs(enu - flow).max():.1e} of 1")
    names = [f"offset.{a}" for a in NAMES] + [f"sensitivity.{a}.{b}" for a in NAMES for b in NAMES]
    mixed = draw.normal(size=(12, 12))
    covariance = 4.0 * (mixed @ mixed.T / 12.0 + np.eye(12))
    stated = uncertain(names, covariance, 3.0, NAMES)
    known = tiltcal.read(calibration(folder, "known", [1000.0, 1010.0, 990.0], sensitivity, stated))
    errors = draw.multivariate_normal(np.zeros(12), covariance, n)
    matrices = sensitivity + errors[:, 3:].reshape(n, 3, 3)
    readings = [1000.0, 1010.0, 990.0] + errors[:, :3] + np.einsum("nij,nj->ni", matrices, up)
    readings += 3.0 * draw.normal(size=(n, 3))
    measured = field + 0.2 * draw.normal(size=(n, 3))
    out = known.apply(columns(readings, measured), uncertainty=True, magnetometer_noise=0.2, **options)
    off = np.abs((out["heading"] - true + 180.0) % 360.0 - 180.0)
    told = {"heading": share(off <= out["U95_heading"], n)}
    for k, name in enumerate(("v_east", "v_north", "v_up")):
        told[name] = share(np.abs(out[name] - flow[:, k]) <= out[f"U95_{name}"], n)
    print("heading     intervals hold " + ", ".join(f"{name} {value}" for name, value in told.items()))


def between(folder: Path) -> None:
    """Fleets of 20 units with calibrations at 0, 300, 700 and 1000 days; nine times between the last two."""
    days = np.array([0.0, 300.0, 700.0, 1000.0])
    at = np.linspace(700.0, 1000.0, 11)[1:-1]
    every = np.sort(np.concatenate([days, at]))
    for truth in ("line", "walk"):
        draw = np.random.default_rng([2, len(truth)])
        held: dict[float, list[np.ndarray]] = {}
        for fleet in range(40):
            u = (0.25, 1.0, 2.0)[fleet % 3]
            library = folder / f"{truth}-{fleet}"
            library.mkdir()
            steps = draw.normal(size=(20, 2, len(every) - 1)) * np.sqrt(np.diff(every) / 365.0)
            walk = np.concatenate([np.zeros((20, 2, 1)), np.cumsum(steps, axis=2)], axis=2)
            line = draw.normal(size=(20, 2, 1)) * every / 365.0
            zero = 1000.0 + 2.0 * (walk if truth == "walk" else line)
            stated = f"uncertainty:\n  offset: {{x: {u}, y: {u}}}\n  single_reading: {{x: 0.0, y: 0.0}}\n"
            for unit in range(20):
                for day in days:
                    measured = zero[unit, :, np.searchsorted(every, day)] + u * draw.normal(size=2)
                    calibration(library, f"U{unit}@{day:.0f}", measured, 820.0 * np.eye(2), stated, days=day)
            opened = tiltcal.open_calibrations(library)
            seconds = START.timestamp() + 86400.0 * at
            for unit in range(20):
                true = zero[unit][:, np.searchsorted(every, at)]
                frame = {"time": seconds, "x": true[0] + 100.0, "y": true[1] - 50.0}
                out = opened.apply(frame, serial=f"U{unit}", uncertainty=True)
                for axis, reading in (("x", 100.0), ("y", -50.0)):
                    error = np.abs(out[f"tilt_{axis}"] - np.degrees(np.arcsin(reading / 820.0)))
                    held.setdefault(u, []).append(error <= out[f"U95_tilt_{axis}"])
        for u, inside in sorted(held.items()):
            print(
                f"between     {truth} of 2 counts a year, calibrations ± {u} count: {share(inside, len(inside))} hold"
            )


def means(folder: Path) -> None:
    """Means of 1, 100 and 10,000 rows, each with a sensor that is off by random errors of the stated size."""
    draw, names = np.random.default_rng(3), ["offset.x", "offset.y", "sensitivity.x.x", "sensitivity.y.y"]
    covariance = np.diag([1.0, 1.0, 4.0, 4.0])
    stated = uncertain(names, covariance, 20.0, ["x", "y"])
    known = tiltcal.read(calibration(folder, "means", [1000.0, 1000.0], 820.0 * np.eye(2), stated))
    for count, groups in ((1, 4000), (100, 4000), (10_000, 1000)):
        held = []
        for _ in range(max(groups * count // 1_000_000, 1)):
            part = min(groups, max(1_000_000 // count, 1))
            off = draw.multivariate_normal(np.zeros(4), covariance, part)
            up = np.sin(np.radians(draw.uniform(-50.0, 50.0, (part, 2)))) / np.sqrt(2.0)
            level = 1000.0 + off[:, :2] + (820.0 + off[:, 2:]) * up
            readings = np.repeat(level, count, axis=0) + 20.0 * draw.normal(size=(part * count, 2))
            out = known.apply({"x": readings[:, 0], "y": readings[:, 1]}, average=count, uncertainty=True)
            for k, axis in enumerate("xy"):
                error = np.abs(out[f"tilt_{axis}"] - np.degrees(np.arcsin(up[:, k])))
                held.append(error <= out[f"U95_tilt_{axis}"])
        number = sum(len(one) for one in held)
        print(f"means       of {count} rows: {share(np.concatenate(held), number)} hold")


def folder_of_many(folder: Path) -> None:
    """10,000 files indexed, and a log applied with a folder and with a file, in turn."""
    stated = "uncertainty:\n  offset: {x: 1.0, y: 1.0}\n  single_reading: {x: 1.0, y: 1.0}\n"
    many = folder / "many"
    many.mkdir()
    for unit in range(2500):
        for year in range(4):
            calibration(many, f"U{unit}@{year}", [1000.0, 1000.0], 820.0 * np.eye(2), stated, days=365.0 * year)
    spent = []
    for _ in range(2):
        begun = time.perf_counter()
        found = len(tiltcal.open_calibrations(many).serials)
        spent.append(time.perf_counter() - begun)
    print(f"folder      10,000 files of {found} sensors indexed in {spent[0]:.2f} s, then in {spent[1]:.2f} s")
    draw, n = np.random.default_rng(4), 5_000_000
    few = folder / "few"
    few.mkdir()
    fitted = (Path(__file__).parents[1] / "fixtures" / "six-face.yaml").read_text(encoding="utf-8")
    for day in (0.0, 100.0):  # with the sensitivity of both, as after `level`
        path = few / f"{day:.0f}.yaml"
        moved = fitted.replace("y: 1020.44125}", f"y: {1020.44125 + day / 50.0}}}")
        path.write_text(re.sub("2000-01-01T[^Z]*", f"{START + timedelta(days=day):%Y-%m-%dT%H:%M:%S}", moved))
    log = folder / "log.csv"
    seconds = START.timestamp() + np.linspace(0.0, 99.0, n) * 86400.0
    readings = draw.uniform(700.0, 1300.0, (2, n)).round(2)
    pl.DataFrame({"time": seconds.round(3), "x": readings[0], "y": readings[1]}).write_csv(log)
    for uncertainty in (False, True):
        times: dict[str, list[float]] = {"file": [], "folder": []}
        for _ in range(5):
            for kind, made in (("file", tiltcal.read(path)), ("folder", tiltcal.open_calibrations(few))):
                wall = time.perf_counter()
                options = {} if kind == "file" else {"serial": "SIM-42"}
                tiltcal.apply_log(made, log, folder / f"{kind}.csv", uncertainty=uncertainty, **options)
                times[kind].append(time.perf_counter() - wall)
        one, other = (float(np.median(times[kind])) for kind in ("file", "folder"))
        print(
            f"folder      {n:,} rows{', with uncertainty' if uncertainty else ''}: file {one:.2f} s, "
            f"folder {other:.2f} s, ratio {other / one:.3f}"
        )


def with_punpy(folder: Path) -> None:
    """The mean of 10,000 rows, stated by tiltcal, and by punpy from the file of 1,000 means of ten rows."""
    try:
        import punpy
    except ImportError:
        print("punpy       is not installed: pip install punpy")
        return
    import xarray

    draw, n = np.random.default_rng(5), 10_000
    names = ["offset.x", "offset.y", "sensitivity.x.x", "sensitivity.y.y"]
    stated = uncertain(names, np.diag([4.0, 4.0, 4.0, 4.0]), 20.0, ["x", "y"])
    path = calibration(folder, "punpy", [1000.0, 1000.0], 820.0 * np.eye(2), stated)
    readings = [1280.0, 1100.0] + 20.0 * draw.normal(size=(n, 2))
    columns = {axis: ("time", readings[:, k], {"units": "count"}) for k, axis in enumerate("xy")}
    xarray.Dataset(columns).to_netcdf(folder / "log.nc", engine="h5netcdf")
    made = {}
    for count in (10, n):
        tiltcal.apply_log(path, folder / "log.nc", folder / f"{count}.nc", average=count, uncertainty=True)
        made[count] = xarray.load_dataset(folder / f"{count}.nc", engine="h5netcdf")
    tilt = made[10]["tilt_x"]
    propagation = punpy.MCPropagation(40_000, parallel_cores=1)
    ways = {"random": propagation.propagate_random, "systematic": propagation.propagate_systematic}
    for name in tilt.attrs["unc_comps"]:
        form = made[10][name].attrs["err_corr_1_form"]
        found = ways[form](lambda x: np.array([np.mean(x)]), [tilt.values], [made[10][name].values])
        own = float(made[n][name][0])
        print(f"punpy       {form}: {found[0]:.5f}°, tiltcal {own:.5f}°, ratio {found[0] / own:.4f}")


STUDIES: dict[str, Callable[[Path], None]] = {
    "heading": heading,
    "between": between,
    "means": means,
    "folder": folder_of_many,
    "punpy": with_punpy,
}


def main() -> None:
    """Run the studies that are named, or all."""
    for name in sys.argv[1:] or STUDIES:
        with TemporaryDirectory() as folder:
            STUDIES[name](Path(folder))


if __name__ == "__main__":
    main()
