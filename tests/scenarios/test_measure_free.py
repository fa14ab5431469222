"""``tiltcal measure free``: positions that nobody sets, led on an SCA3000 that was written apart from ours.

Its fixture misses every position by several degrees, which no jig would do. What must come out right is what does not
depend on how the sensor lay: the offsets, the length of each row of the sensitivity matrix, the angles between them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.command import tiltcal
from support.emulated.bench import Sca3000, run_on_spi
from support.warm_start import WarmStart

from tiltcal.files.calibration import read_calibration
from tiltcal.files.procedure import find_procedure

Array = NDArray[np.float64]

BY_HAND = Sca3000(jig=6.0, noise=1.5, seed=8)


def program(start: Sequence[str], folder: Path, *options: str) -> list[str]:
    return [
        *(*start, "measure", "free", "--sensor", "sca3000-d01"),
        *("--address", "spi:///dev/spidev0.0", "--serial", "A-3000", "-o", str(folder / "A-3000.yaml")),
        *("--operator", "json", "--settle", "0.12", "--samples", "40", *options),
    ]


def angles(sensitivity: Array) -> Array:
    """Between the rows x and y, x and z, y and z, degrees."""
    rows = sensitivity / np.linalg.norm(sensitivity, axis=1, keepdims=True)
    return np.degrees(np.arccos([rows[0] @ rows[1], rows[0] @ rows[2], rows[1] @ rows[2]]))


def test_a_part_that_was_laid_down_anyhow(warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("spidev", reason="the spidev package is not installed")
    with run_on_spi(program(warm.program, tmp_path), BY_HAND) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    assert [one["position"] for one in told if one.get("event") == "accepted"] == [
        position.name for position in find_procedure("free").positions
    ]
    found = read_calibration(tmp_path / "A-3000.yaml")
    coefficients = found.coefficients
    truth = np.array(BY_HAND.sensitivity)
    # 1.5 count over 40 samples is 0.24 count; six positions tell of each unknown.
    np.testing.assert_allclose(coefficients.offset, BY_HAND.offset, atol=0.6)
    np.testing.assert_allclose(
        np.linalg.norm(coefficients.sensitivity, axis=1), np.linalg.norm(truth, axis=1), atol=0.8
    )
    np.testing.assert_allclose(angles(coefficients.sensitivity), angles(truth), atol=0.05)
    assert found.derived.mounting.startswith("undetermined")
    assert found.fit.distinct_attitudes == 18
    assert found.fit.degrees_of_freedom == 18 - 9
    again = tiltcal("replay", tmp_path / "A-3000.journal.jsonl")
    assert again.stdout.encode() == (tmp_path / "A-3000.yaml").read_bytes()


def test_the_same_attitude_again_is_refused(warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("spidev", reason="the spidev package is not installed")
    with run_on_spi(program(warm.program, tmp_path), BY_HAND) as bench:
        bench.pose([1.0, 0.0, 0.0])
        first = bench.ask('{"answer": "ready"}')
        assert first["ask"] == "position"
        heard = [bench.ask('{"answer": "ready"}') for _ in range(3)]
        bench.say('{"answer": "quit"}')
    refused = [one for one in heard if one.get("event") == "refused"]
    assert "attitude of x-up again" in refused[0]["why"]


def test_several_sensors_that_sit_differently_share_the_attitudes(tmp_path: Path) -> None:
    (tmp_path / "twin.yaml").write_text(
        "tiltcal: 1\nkind: twin\nmodel: sca3000-d01\nseed: 5\ntruth:\n"
        "  offset: {x: 31.4, y: -18.7, z: 44.2}\n"
        "  sensitivity: {x: {x: 1341.2, y: 9.6, z: -14.3}, y: {x: -7.1, y: 1322.5, z: 11.8}, z: {x: 5.9, y: -12.4,"
        " z: 1338.7}}\n"
        "  noise: {x: 1.5, y: 1.5, z: 1.5}\n  jig: 5.0\n"
    )
    (tmp_path / "bench.yaml").write_text(
        "tiltcal: 1\nkind: bench\nsensors:\n"
        '  - {serial: A, model: sca3000-d01, address: "sim:?twin=twin.yaml"}\n'
        '  - {serial: B, model: sca3000-d01, address: "sim:?twin=twin.yaml&seed=9", axes: [y, -x, z]}\n'
    )
    result = tiltcal("measure", "free", "--bench", "bench.yaml", "--operator", "sim", "--samples", "40", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    truth = np.array([[1341.2, 9.6, -14.3], [-7.1, 1322.5, 11.8], [5.9, -12.4, 1338.7]])
    for serial in "AB":
        found = read_calibration(tmp_path / f"{serial}.yaml").coefficients
        np.testing.assert_allclose(found.offset, [31.4, -18.7, 44.2], atol=0.6)
        np.testing.assert_allclose(np.linalg.norm(found.sensitivity, axis=1), np.linalg.norm(truth, axis=1), atol=0.8)
        np.testing.assert_allclose(angles(found.sensitivity), angles(truth), atol=0.05)


def test_a_bench_with_a_sensor_of_two_axes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(
        'tiltcal: 1\nkind: bench\nsensors:\n  - {serial: A, model: sca3000-d01, address: "sim:"}\n'
        '  - {serial: B, model: sca100t-d02, address: "sim:?seed=9"}\n'
    )
    result = tiltcal("measure", "free", "--bench", "bench.yaml", "--operator", "sim", cwd=tmp_path)
    assert result.returncode == 2
    assert "free positions need a sensor of three channels x, y and z, and sca100t-d02 has x, y" in result.stderr


REFUSED = {
    "a sensor of two axes": (("measure", "free", "--sensor", "sca100t-d02"), "three channels"),
    "a stated jig": (("measure", "free", "--sensor", "sca3000-d01", "--jig", "0.3"), "use no jig"),
    "a stated jig in a plan": (("plan", "free", "--sensor", "sca3000-d01", "--jig", "0.3"), "use no jig"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_before_anyone_starts(name: str, tmp_path: Path) -> None:
    command, why = REFUSED[name]
    bench = () if command[0] == "plan" else ("--address", "sim:", "--serial", "S-1", "-o", "S-1.yaml")
    result = tiltcal(*command, *bench, cwd=tmp_path)
    assert result.returncode == 2
    assert why in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_plan_says_what_hand_held_positions_will_give() -> None:
    """Eighteen directions spread over the sphere, noise of one mean s: the bound of an independent ellipsoid fit."""
    result = tiltcal("plan", "free", "--sensor", "sca3000-d01", "--noise", "1.0", "--samples", "100", "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    predicted = told["uncertainty"]
    gravity = np.array([position.gravity for position in find_procedure("free").positions])
    # |u - offset| = S on a sphere: d length = -g . d offset - sum of g_i² d S_ii - ... for each direction.
    rows = np.hstack([gravity, *(gravity[:, [i]] * gravity[:, i:] for i in range(3))])
    covariance = 0.1**2 * np.linalg.inv(rows.T @ rows)
    for place, name in enumerate(("offset.x", "offset.y", "offset.z", "sensitivity.x.x", "sensitivity.x.y")):
        assert predicted[name] == pytest.approx(np.sqrt(covariance[place, place]), rel=0.02), name
    assert told["degrees_of_freedom"] == 9
