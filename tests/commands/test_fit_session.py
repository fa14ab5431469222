"""``fit`` of what people have: signs turned, a tapped or stuck hold, several logs, means without names."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal

import tiltcal as library

S = np.eye(3) + np.array([[0.010, 0.004, -0.003], [-0.006, -0.012, 0.002], [0.001, 0.005, 0.020]])
"""Of the sensor, g/g; it is made up."""
OFFSET = np.array([0.021, -0.015, 0.033])
CORNERS = np.array(
    [(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) if 0 < a * a + b * b + c * c < 3]
)
DIRECTIONS = CORNERS / np.linalg.norm(CORNERS, axis=1)[:, None]
FACES = np.concatenate([np.eye(3), -np.eye(3)])


def held(directions: np.ndarray = DIRECTIONS, seed: int = 1, rows: int = 120) -> np.ndarray:
    """Readings, g: held in each direction, turned in between."""
    draw = np.random.default_rng(seed)
    up = [directions[0] + 0.0 * np.ones((rows, 1))]
    for one, other in pairwise(directions):
        share = np.linspace(0.0, 1.0, 40)[:, None]
        up += [(1 - share) * one + share * other + 0.05 * draw.normal(size=(40, 3)), other + np.zeros((rows, 1))]
    up = np.concatenate(up)
    return up @ S.T + OFFSET + 0.0015 * draw.normal(size=up.shape)


def write(path: Path, rows: np.ndarray, header: str = "x,y,z\n", separator: str = ",") -> Path:
    path.write_text(header + "".join(separator.join(f"{cell:.5f}" for cell in row) + "\n" for row in rows))
    return path


def fitted(folder: Path, *arguments: object) -> tuple[library.Calibration, str]:
    done = tiltcal("fit", *arguments, "--serial", "A", "-o", "a.yaml", cwd=folder, code=0)
    return library.read(folder / "a.yaml"), done.stderr


def off(calibration: library.Calibration) -> float:
    """Return the largest error of the offsets, mg."""
    per_g = {"g": 1.0, "m/s2": 9.80665}[calibration.sensor.unit]
    return 1e3 * max(abs(calibration.offset[axis] / per_g - OFFSET[k]) for k, axis in enumerate("xyz"))


def test_a_channel_that_stood_still_in_more_than_two_holds_is_not_credible(tmp_path: Path) -> None:
    rows = held()
    for k in range(3):
        rows[160 * (3 + 2 * k) : 160 * (3 + 2 * k) + 120, 2] = rows[160 * (3 + 2 * k) + 60, 2]
    calibration, said = fitted(tmp_path, "free", write(tmp_path / "log.csv", rows))
    assert (said.count("z stood at one value"), off(calibration) < 1.0) == (3, True)
    tiltcal("check", "a.yaml", cwd=tmp_path, code=1)


def test_signs_belong_to_the_file(tmp_path: Path) -> None:
    """A phone that reads -1 g up; every reader of the file needs no sign."""
    raw = -held() + 2 * OFFSET  # its own offset is the same
    log = write(tmp_path / "log.csv", raw)
    calibration, said = fitted(tmp_path, "free", log, "--columns", "x=-x,y=-2,z=-z")
    assert off(calibration) < 1.0
    assert calibration.sensitivity["z", "z"] == pytest.approx(-S[2, 2], abs=0.001)
    up = np.tile(-S[:, 2] + OFFSET, (5, 1))
    write(tmp_path / "up.csv", up)
    tiltcal("apply", "a.yaml", "up.csv", "-o", "out.csv", cwd=tmp_path, code=0)
    inclination = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)["inclination"]
    assert np.abs(inclination).max() < 0.5
    refused = tiltcal("apply", "a.yaml", "up.csv", "--columns", "x=-x", "-o", "out.csv", cwd=tmp_path, code=2)
    assert "signs belong to the calibration" in refused.stderr
    longest = np.concatenate([raw, np.tile(raw[-1:] * 0 - S[:, 2] + OFFSET, (400, 1)) + 0.0015 * held()[:400] * 0])
    longest[len(raw) :] += 0.0015 * np.random.default_rng(2).normal(size=(400, 3))
    _, said = fitted(tmp_path, "free", write(tmp_path / "log.csv", longest))
    assert "is upside down" in said


def test_six_logs_are_one_session_in_any_order_or_each_a_position(tmp_path: Path) -> None:
    names = ("x-up", "y-up", "z-up", "x-down", "y-down", "z-down")
    for k, (name, up) in enumerate(zip(names, FACES, strict=True)):
        write(tmp_path / f"{name}.csv", 9.80665 * held(up[None], seed=k), "t,ax,ay,az\n"[2:])
    logs = [f"{name}.csv" for name in names]
    for given in (logs[::-1], [f"{name}={name}.csv" for name in names]):
        calibration, said = fitted(tmp_path, "six-face", *given)
        assert off(calibration) < 1.0
        assert (calibration.sensor.unit, calibration.record.sensor.unit_from) == ("m/s2", "length")
        assert "the unit is m/s2: at rest the readings are as long as gravity" in said
        assert len(calibration.record.provenance.logs) == 6
    mixed = tiltcal("fit", "six-face", "x-up=x-up.csv", "y-up.csv", "--serial", "A", "-o", "b.yaml", cwd=tmp_path)
    assert "y-up.csv has no name of a position" in mixed.stderr


@pytest.mark.parametrize(("header", "separator"), [("", "\t"), ("", " "), ("ax,ay,az\n", ","), ("k;a;b;c\n", ";")])
def test_means_of_free_positions_need_no_names(header: str, separator: str, tmp_path: Path) -> None:
    """Magneto's input: three numbers a line."""
    means = 9.80665 * (np.concatenate([DIRECTIONS, -DIRECTIONS[:5]]) @ S.T + OFFSET)
    means += 0.003 * np.random.default_rng(1).normal(size=means.shape)
    numbered = header.startswith("k")
    rows = np.column_stack([np.arange(len(means)), means]) if numbered else means
    write(tmp_path / "means.txt", rows, header, separator)
    columns = ("--columns", "x=a,y=3,z=c") if numbered else ()
    calibration, _ = fitted(tmp_path, "free", "means.txt", "--table", *columns)
    assert (off(calibration) < 1.0, calibration.sensor.unit) == (True, "m/s2")
    if not header:
        asked = tiltcal("fit", "free", "means.txt", "--serial", "A", "-o", "b.yaml", cwd=tmp_path)
        assert "if each row is the mean of one position, say --table" in asked.stderr


def test_what_contradicts_the_unit_is_said_and_a_torn_row_is_skipped_on_request(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", held())
    _, said = fitted(tmp_path, "free", log, "--unit", "m/s2")
    assert "the unit is probably g" in said
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join([*lines[:1500], lines[1500][:9] + "\n", *lines[1501:]]))
    refused = tiltcal("fit", "free", log, "--serial", "A", "-o", "b.yaml", cwd=tmp_path)
    assert "log.csv:1501: the row has 2 fields, the header 3" in refused.stderr
    calibration, _ = fitted(tmp_path, "free", log, "--skip-bad-rows")
    assert off(calibration) < 1.0
    still = write(tmp_path / "still.csv", held() - OFFSET - held() + 0.001)
    tiltcal("fit", "free", still, "--unit", "m/s2", "--serial", "A", "-o", "b.yaml", cwd=tmp_path, code=2)


def test_a_sensor_of_one_axis_needs_no_tilt_of_the_other(tmp_path: Path) -> None:
    rows = [
        (a, 2.5 + 2.0 * np.sin(np.radians(a)), np.sin(np.radians(a)), np.cos(np.radians(a))) for a in range(-60, 61, 10)
    ]
    text = "".join(f"at {a},{volts:.4f},{x:.8f},0,{z:.8f}\n" for a, volts, x, z in rows)
    (tmp_path / "t.csv").write_text("position,x,gx,gy,gz\n" + text)
    calibration, said = fitted(tmp_path, "plane", "t.csv", "--table", "--unit", "V", "--jig", "0.1")
    assert calibration.offset["x"] == pytest.approx(2.5, abs=1e-3)
    assert calibration.sensitivity["x", "x"] == pytest.approx(2.0, abs=1e-3)
    assert "no position tilts y: the sensitivity to it counts as zero" in said


def test_each_log_of_a_session_has_a_clock_of_its_own(tmp_path: Path) -> None:
    """A soak of 360 s does not reach into the log before; a table is one file."""
    draw = np.random.default_rng(1)
    for name, celsius in (("warm", 24.0), ("cold", 5.0)):
        rows = draw.normal([0.0, 1024.0, 1024.0, celsius], [0.0, 0.5, 0.5, 0.01], (200, 4))
        rows[:, 0] = np.arange(200.0)
        write(tmp_path / f"{name}.csv", rows, "time,x,y,temperature\n")
    logs = ("level-warm=warm.csv", "level-cold=cold.csv", "--sensor", "sca100t-d02", "--serial", "A", "-o", "a.yaml")
    tiltcal("fit", "two-temperature", *logs, cwd=tmp_path, code=0)
    refused = tiltcal("fit", "two-temperature", "--table", *logs, cwd=tmp_path, code=2)
    assert refused.stderr == "tiltcal: a --table is one file, and 2 are given: name one\n"


def test_a_table_may_have_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    rows = "x-tilt1;3,5117;2,5210\nx-tilt2;1,5083;2,5000\ny-tilt1;2,4903;3,5083\ny-tilt2;2,5303;1,5123\n"
    (tmp_path / "t.csv").write_text("position;x;y\n" + rows)
    calibration, _ = fitted(tmp_path, "plane", "t.csv", "--table", "--unit", "V", "--jig", "0.1")
    assert calibration.offset["x"] == pytest.approx((3.5117 + 1.5083 + 2.4903 + 2.5303) / 4, abs=1e-3)


def test_a_hold_that_was_tapped_is_trimmed_or_left_out_and_named(tmp_path: Path) -> None:
    rows = held()
    rows[480:600] = rows[480:600].mean(axis=0) + 0.0003 * np.random.default_rng(2).normal(size=(120, 3))
    rows[510:600:9] += (0.004, -0.003, 0.002)
    calibration, said = fitted(tmp_path, "free", write(tmp_path / "log.csv", rows))
    assert "still-04" in re.search(r"1 of \d+ holds is (trimmed|left out): (.*)", said)[2]
    assert off(calibration) < 1.0
    segments = calibration.record.provenance.segments
    assert [*segments.trimmed, *segments.left_out] == ["still-04"]
    tiltcal("check", "a.yaml", cwd=tmp_path, code=0)
