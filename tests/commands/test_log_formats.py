"""Every command that reads a log reads it in every format, and finds the same."""

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import xarray
from support import FIXTURES
from support.command import tiltcal

from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.library.calibration import Calibration
from tiltcal.logs.formats import open_log

FORMATS = ("csv", "parquet", "nc")


def write(frame: pl.DataFrame, folder: Path, stem: str) -> None:
    frame.write_csv(folder / f"{stem}.csv")
    frame.write_parquet(folder / f"{stem}.parquet")
    data = {name: ("row", frame[name].to_numpy()) for name in frame.columns}
    xarray.Dataset(data).to_netcdf(folder / f"{stem}.nc", engine="h5netcdf")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("formats")
    draw = np.random.default_rng(3)
    time = np.arange(6000) * 0.01
    rest = {name: np.rint(1024.0 + draw.normal(0.0, 1.5, len(time))) for name in ("x", "y")}
    write(pl.DataFrame({"time": time, **rest, "temperature": np.full(len(time), 15.0)}), folder, "rest")
    turn = np.arange(8000) * 0.02
    signals = {"a1": np.sin(turn), "a2": -0.99 * np.sin(turn + 0.002), "a4": np.cos(turn)}
    noisy = {name: signal + draw.normal(0.0, 1e-5, len(turn)) for name, signal in signals.items()}
    write(pl.DataFrame({"theta": np.degrees(turn), **noisy}), folder, "disk")
    return folder


def printed(folder: Path, *arguments: str) -> str:
    done = tiltcal(*arguments, cwd=folder, code=0)
    return done.stdout


@pytest.mark.parametrize("end", FORMATS)
def test_a_log_is_read_whole_and_says_how_far(end: str, tmp_path: Path) -> None:
    """Cell by cell what was written, in several blocks, and the share of its bytes with each."""
    count = np.arange(300_000.0)
    write(pl.DataFrame({"time": count / 100.0, "x": np.sin(count), "n": count}), tmp_path, "long")
    path, said, read = tmp_path / f"long.{end}", list[tuple[int, int | None]](), []
    with open_log(path, progress=lambda *done: said.append(done)) as log:
        read += [np.stack([block.values[k] for k in (0, 1, 2)]) for block in log.rows([2, 0, 1], 0)]
    np.testing.assert_array_equal(np.concatenate(read, axis=1), [count / 100.0, np.sin(count), count])
    size = path.stat().st_size
    assert len(said) == len(read) > 1
    assert said[-1] == (size, size)
    shares = np.cumsum([len(part[0]) for part in read]) / len(count)
    # Blocks are read ahead.
    assert all(0.95 * share * size <= done <= size == whole for share, (done, whole) in zip(shares, said, strict=True))


@pytest.mark.parametrize(
    "command",
    [
        "noise rest.{} --unit count --json",
        "match disk.{} --pair a1,a2 --orthogonal a4 --phase theta --json",
        "report bare.yaml rest.{} -o {}.html",
        "fit zero-45 held.{} --segments segments.csv --sensor sca100t-d02 --serial S --jig 0.1 -o {}.yaml",
    ],
)
def test_every_format_gives_the_same(command: str, folder: Path) -> None:
    known, found = read_calibration(FIXTURES / "mavs.yaml"), []
    Calibration(CalibrationRecord(known.sensor, known.coefficients)).save(folder / "bare.yaml")
    levels = np.repeat([[1000.0, 1000.0], [1400.0, 1000.0], [1000.0, 1400.0]], 200, axis=0)
    levels += np.random.default_rng(4).normal(0.0, 1.0, levels.shape)
    write(pl.DataFrame(dict(zip("xy", levels.T, strict=True))), folder, "held")
    segments = "position,start,end,gx,gy,gz\nlevel,0,200,0,0,1\nx,200,400,0.5,0,0.8660254\ny,400,600,0,0.5,0.8660254\n"
    (folder / "segments.csv").write_text(segments)
    for end in FORMATS:
        words = command.format(end, end).split()
        text = printed(folder, *words)
        if "-o" in words:
            text = (folder / words[-1]).read_text(encoding="utf-8")
            log = next(word for word in words if word.endswith(f".{end}"))
            assert log in text
            text = re.sub(r'"?\b[0-9a-f]{64}\b"?', "", text.replace(log, "log"))
        found.append(text)
    assert found[0] == found[1] == found[2]


def test_units_of_the_header_are_used_and_said_once(folder: Path) -> None:
    frame = pl.read_csv(folder / "rest.csv")
    names = {"time": "Time (ms)", "temperature": "Temp (°F)", "x": "ax", "y": "ay"}
    other = frame.with_columns(pl.col("time") * 1e3, pl.col("temperature") * 1.8 + 32).rename(names)
    other.write_csv(folder / "other.csv")
    assert json.loads(printed(folder, "noise", "other.csv", "--unit", "count", "--json"))["interval"] == 0.01
    other.rename({"ax": "ax (m/s^2)", "ay": "ay (m/s^2)"}).write_csv(folder / "si.csv")
    found = json.loads(printed(folder, "noise", "si.csv", "--json"))
    assert (found["unit"], [*found["channels"]], found["interval"]) == ("m/s2", ["x", "y"], 0.01)
    np.savetxt(folder / "still.txt", np.random.default_rng(2).normal((0.1, 0.2, 9.8), 0.01, (3000, 3)), fmt="%.4f")
    found = json.loads(printed(folder, "noise", "still.txt", "--rate", "100", "--target", "0.01", "--json"))
    assert (found["unit"], [*found["channels"]]) == ("m/s2", ["x", "y", "z"])
    assert "the unit is m/s2 if these are accelerations: at rest they are as long as gravity" in found["remarks"]
    results = []
    for log, columns in (("rest.csv", ""), ("other.csv", "temperature=Temp")):
        done = tiltcal("apply", FIXTURES / "mavs.yaml", log, "--every", "10s", "--columns", columns, cwd=folder, code=0)
        assert done.stderr.count("is in °F, by its name: °C are used") == (log == "other.csv")
        results.append(pl.read_csv(done.stdout.encode()))
    assert len(results[1]) == 6
    assert results[0]["flag"].to_list() == results[1]["flag"].to_list()
    assert results[1]["Temp (°F)"].to_list() == pytest.approx([59.0] * 6)  # as the log has it
    np.testing.assert_allclose(results[0]["tilt_x"], results[1]["tilt_x"], atol=1e-9)
