"""``tiltcal fit`` and ``apply`` on the recorded six-face session (imucal's, MIT; see data/README.md)."""

import csv
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal
from support.recordings import recording

from tiltcal.files.calibration import read_calibration

SESSION, SEGMENTS = recording("ferraris_session.csv"), recording("ferraris_segments.csv")


COLUMNS = "x=acc_x,y=acc_y,z=acc_z"


def fitted(folder: Path, name: str, jig: str) -> str:
    result = tiltcal(
        *("fit", "six-face", SESSION, "--segments", SEGMENTS, "--columns", COLUMNS, "--jig", jig),
        *("--unit", "m/s2", "--serial", "IMU1", "-o", name),
        cwd=folder,
        code=0,
    )
    return str(result.stdout)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fit")
    fitted(folder, "imu1.yaml", "0")
    return folder


def test_the_published_coefficients_to_their_printed_digits(folder: Path) -> None:
    """The publication takes every face as set, which is a jig of 0."""
    found = read_calibration(folder / "imu1.yaml").coefficients
    assert [f"{value:.5f}" for value in found.offset] == ["0.55114", "-0.61973", "0.38564"]
    assert [[f"{value:.5f}" for value in row] for row in found.sensitivity] == [
        ["9.77673", "-0.14501", "-0.07316"],
        ["0.08434", "9.83353", "0.01813"],
        ["0.13384", "0.02012", "10.03860"],
    ]


def test_apply_gives_the_faces_as_they_were_held(folder: Path) -> None:
    """Within the placement of the faces, half a degree, each face's mean gravity is the direction that was up."""
    tiltcal("apply", "imu1.yaml", SESSION, "--columns", COLUMNS, "-o", "tilt.csv", cwd=folder, code=0)
    with open(SESSION, newline="") as before, open(folder / "tilt.csv", newline="") as after:
        rows_in, rows = list(csv.DictReader(before)), list(csv.DictReader(after))
    assert [{name: row[name] for name in rows_in[0]} for row in rows] == rows_in
    assert list(rows[0])[len(rows_in[0]) :] == [
        *("g_x", "g_y", "g_z", "tilt_x", "tilt_y", "tilt_z"),
        *("pitch", "roll", "inclination", "flag", "reason"),
    ]
    with open(SEGMENTS, newline="") as stream:
        for face in csv.DictReader(stream):
            still = rows[int(face["start"]) : int(face["end"])]
            for axis in "xyz":
                mean = sum(float(row[f"g_{axis}"]) for row in still) / len(still)
                assert mean == pytest.approx(float(face[f"g{axis}"]), abs=0.009), face["position"]


def test_with_a_stated_placement_error_imucals_offsets_are_inside_our_intervals(folder: Path) -> None:
    """imucal's own two-face formula gives offsets 0.5371, -0.6162, 0.3989 m/s² (data/README.md)."""
    fitted(folder, "placed.yaml", "0.2")
    found = read_calibration(folder / "placed.yaml")
    for axis, published in {"x": 0.5371, "y": -0.6162, "z": 0.3989}.items():
        offset = found.coefficients.offset["xyz".index(axis)]
        assert abs(offset - published) < 1.96 * found.uncertainty[f"offset.{axis}"]


def test_numbers_of_few_digits_and_a_log_without_gravity_are_called_so(tmp_path: Path) -> None:
    """Whole numbers of g say nothing better than some ten degrees; a phone may take gravity out."""
    faces = "x-up,1,0,0,50\nx-down,-1,0,0,50\ny-up,0,1,0,50\ny-down,0,-1,0,50\nz-up,0,0,1,50\nz-down,0,0,-1,50\n"
    faces = f"position,x,y,z,n\n{faces}"
    (tmp_path / "faces.csv").write_text(faces, encoding="utf-8")
    for unit, code in (("g", 0), ("count", 2)):
        options = ("--table", "--unit", unit, "--serial", "S-1", "-o", f"{unit}.yaml")
        done = tiltcal("fit", "six-face", "faces.csv", *options, cwd=tmp_path)
        assert (done.returncode, "wired" in done.stderr) == (code, False), done.stderr
        assert f"the numbers of x have a step of 1 {unit}" in done.stdout + done.stderr
    single = read_calibration(tmp_path / "g.yaml").uncertainty.single_reading
    assert single == pytest.approx(dict.fromkeys("xyz", 1.0 / np.sqrt(12.0)), abs=1e-4)  # rounding is all there is
    rows = np.random.default_rng(1).normal(0.1, 0.05, (400, 3))
    np.savetxt(tmp_path / "phone.csv", rows, delimiter=",", header="x,y,z", comments="", fmt="%.4f")
    options = ("--unit", "m/s2", "--serial", "P-1", "-o", "p.yaml")
    done = tiltcal("fit", "free", "phone.csv", *options, cwd=tmp_path, code=2)
    assert "m/s2 long at rest" in done.stderr
    assert "gravity has been taken out" in done.stderr
