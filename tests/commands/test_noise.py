"""``tiltcal noise`` from the command line."""

import json
import signal
import subprocess
from math import degrees, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from support import coloured_noise as coloured
from support.applied import refused
from support.recordings import recording
from support.warm_start import WarmStart, wait_until_grown

from tiltcal.cli.noise import command
from tiltcal.errors import InputError

SCA100T_D02 = 819.0
"""count/g"""


def noise(*arguments: str | Path, stdin: bytes | None = None) -> Result:
    return CliRunner().invoke(command, [str(one) for one in arguments], input=stdin)


def as_json(*arguments: str | Path) -> dict[str, Any]:
    result = noise(*arguments, "--json")
    assert result.exit_code == 0, (result.output, result.exception)
    loaded: dict[str, Any] = json.loads(result.stdout)
    return loaded


def counts(n: int = 20_000, seed: int = 1) -> coloured.Samples:
    """Two channels of white noise about 1024."""
    rng = np.random.default_rng(seed)
    return 1024.0 + np.stack([coloured.white(rng, n, 0.6), coloured.white(rng, n, 0.9)], axis=1)


def written(path: Path, samples: coloured.Samples, interval: float = 0.01, rows: slice = slice(None)) -> Path:
    lines = [f"{k * interval:.4f},{x:.6g},{y:.6g}" for k, (x, y) in enumerate(samples.tolist())]
    path.write_text("\n".join(["time,x,y", *lines[rows]]) + "\n")
    return path


class TestOfALog:
    def test_numbers(self, tmp_path: Path) -> None:
        found = as_json(written(tmp_path / "log.csv", counts()), "--sensor", "sca100t-d02")
        x, y = found["channels"]["x"], found["channels"]["y"]
        assert found["samples"] == 20_000
        assert found["interval"] == pytest.approx(0.01, rel=1e-6)
        assert found["seconds"] == pytest.approx(200.0)
        assert found["unit"] == "count"
        assert x["mean"] == pytest.approx(1024.0, abs=0.02)
        assert x["averages"][0]["std"] == pytest.approx(0.6, rel=0.02)
        assert x["averages"][0]["std_degrees"] == pytest.approx(degrees(0.6 / SCA100T_D02), rel=0.02)
        assert [one["samples"] for one in x["averages"]] == [1, 10, 100, 1000]
        # One-sided density of white noise: 2 sigma² dt.
        assert x["noise_density"]["value"] == pytest.approx(0.6 * sqrt(2 * 0.01), rel=0.03)
        assert y["velocity_random_walk"]["value"] == pytest.approx(0.9 * sqrt(0.01), rel=0.03)
        assert x["drift"] is None
        assert not x["bias_instability"]["reached"]
        assert [point["tau"] for point in x["allan"]][:3] == pytest.approx([0.01, 0.02, 0.04])
        assert all(point["low"] < point["deviation"] < point["high"] for point in x["allan"])

    def test_the_number_of_samples_for_a_target(self, tmp_path: Path) -> None:
        """The noisier channel settles it: (sigma / target)², and degrees of one g are those of the nominal part."""
        log = written(tmp_path / "log.csv", counts())
        advice = as_json(log, "--sensor", "sca100t-d02", "--target", "0.005")["recommendation"]
        assert advice["channel"] == "y"
        assert advice["met"] is True
        assert advice["samples"] == pytest.approx((degrees(0.9 / SCA100T_D02) / 0.005) ** 2, rel=0.06)
        assert advice["seconds"] == pytest.approx(advice["samples"] * 0.01)
        result = noise(log, "--sensor", "sca100t-d02", "--target", "0.005")
        assert f"measure --samples {advice['samples']}:" in result.stdout
        # By range: white noise of sigma / √n, whose averages of a hundred lie within about five standard deviations.
        averages = as_json(log, "--sensor", "sca100t-d02")["channels"]["y"]["averages"]
        by_range = as_json(log, "--sensor", "sca100t-d02", "--target", "0.05")["recommendation"]["channels"]["y"]
        ranges = [(one["samples"], one["range_degrees"]) for one in averages]
        above = next(n for n, width in reversed(ranges) if width > 0.05)
        assert above < by_range["samples_by_range"] <= 10 * above
        assert f"y {by_range['samples_by_range']}" in noise(log, "--sensor", "sca100t-d02", "--target", "0.05").stdout

    def test_a_figure(self, tmp_path: Path) -> None:
        log = written(tmp_path / "log.csv", counts(4000))
        result = noise(log, "--sensor", "sca100t-d02", "--figure", tmp_path / "a.svg")
        assert result.exit_code == 0
        drawn = (tmp_path / "a.svg").read_text()
        assert all(text in drawn for text in ("Allan deviation of x [count]", "near level [°]", "averaging time [s]"))
        assert "10⁻²" in drawn
        assert "$" not in drawn

    def test_a_real_sensor(self, tmp_path: Path) -> None:
        """The still minute of an Xsens MTi, and the whole record, in which it is turned by hand."""
        lines = recording("xsens_acc.txt").read_text().splitlines(keepends=True)
        (tmp_path / "still.txt").write_text("".join(lines[:4500]))
        columns = ("--columns", "time=1,x=2,y=3,z=4")
        still = as_json(tmp_path / "still.txt", *columns)
        assert still["moved"] == []
        assert still["interval"] == pytest.approx(0.01, rel=1e-3)
        x = [float(line.split()[1]) for line in lines[:4500]]
        assert still["channels"]["x"]["averages"][0]["std"] == pytest.approx(np.std(x, ddof=1))
        assert still["channels"]["x"]["step"] == 1.0
        assert as_json(recording("xsens_acc.txt"), *columns)["moved"]


class TestWhatIsWrongWithALog:
    def test_a_gap(self, tmp_path: Path) -> None:
        path = written(tmp_path / "l.csv", counts(4000))
        lines = path.read_text().splitlines()
        path.write_text("\n".join(lines[:1001] + lines[1501:]) + "\n")
        found = as_json(path)
        assert found["gaps"] == {"count": 1, "rows": 500}
        assert found["samples"] == 3500
        assert found["seconds"] == pytest.approx(40.0)
        assert "1 gap in its times, 500 rows long" in noise(path).stderr

    def test_bad_rows(self, tmp_path: Path) -> None:
        path = written(tmp_path / "l.csv", counts(1000))
        lines = path.read_text().splitlines()
        lines[10] = "0.09,oops,1024"
        path.write_text("\n".join(lines) + "\n")
        assert ":11:" in refused(noise(path), InputError)
        found = as_json(path, "--skip-bad-rows")
        assert found["bad_rows"] == 1
        assert found["missing"] == {"x": 1, "y": 1}

    def test_motion_is_told(self, tmp_path: Path) -> None:
        samples = counts(4000)
        samples[2500:, 0] += 30.0
        path = written(tmp_path / "l.csv", samples)
        ((begin, end),) = as_json(path)["moved"]
        assert begin <= 25.0 <= end
        assert f"moved or knocked from {begin:.4g} to {end:.4g} s; the numbers are" in noise(path).stderr

    def test_stuck_readings_are_named(self, tmp_path: Path) -> None:
        samples = np.round(counts(4000) * 2) / 2
        samples[1000:1200] = samples[1000]
        path = written(tmp_path / "l.csv", samples)
        begin, end = as_json(path)["hung"]
        assert (begin, end) == pytest.approx((10.0, 12.0), abs=0.05)
        assert "the readings were stuck" in noise(path).stderr


class TestLive:
    ONE = ("--sensor", "sca100t-d02", "--address", "sim:seed=3")

    @pytest.mark.parametrize("name", ["still.csv", "still.parquet"])
    def test_recorded_and_done_again(self, tmp_path: Path, name: str) -> None:
        """What is kept says the same as what was recorded; the times are written to the millisecond."""
        log = tmp_path / name
        live = as_json(*self.ONE, "--samples", "3000", "-o", log)
        again = as_json(log, "--sensor", "sca100t-d02")
        assert live == again
        assert live["samples"] == 3000
        assert live["channels"]["x"]["step"] == 1.0

    def test_interrupted_it_tells_of_what_it_has(self, warm: WarmStart, tmp_path: Path) -> None:
        log = tmp_path / "still.csv"
        process = subprocess.Popen(
            [*warm.program, "noise", *self.ONE, "--samples", "100000000", "-o", str(log)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        wait_until_grown(process, log, 20_000)
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate()
        assert process.returncode == 130
        rows = len(log.read_text().splitlines()) - 1
        assert f"{rows} samples in" in said
        assert printed.startswith(f"{rows} samples of x, y")
