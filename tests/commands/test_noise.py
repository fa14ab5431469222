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
    def test_numbers_and_the_number_of_samples_for_a_target(self, tmp_path: Path) -> None:
        """The noisier channel settles it: (sigma / target)², and degrees of one g are those of the nominal part."""
        log = written(tmp_path / "log.csv", counts())
        found = as_json(log, "--sensor", "sca100t-d02", "--target", "0.005")
        assert (found["samples"], found["unit"], found["interval"]) == (20_000, "count", pytest.approx(0.01, rel=1e-6))
        for name, sigma in (("x", 0.6), ("y", 0.9)):
            one = found["channels"][name]
            assert one["mean"] == pytest.approx(1024.0, abs=0.03)
            assert one["averages"][0]["std"] == pytest.approx(sigma, rel=0.02)
            # One-sided density of white noise: 2 sigma² dt.
            assert one["noise_density"]["value"] == pytest.approx(sigma * sqrt(2 * 0.01), rel=0.03)
        advice = found["recommendation"]
        assert (advice["channel"], advice["met"]) == ("y", True)
        assert advice["samples"] == pytest.approx((degrees(0.9 / SCA100T_D02) / 0.005) ** 2, rel=0.06)
        printed = noise(log, "--sensor", "sca100t-d02", "--target", "0.005").stdout
        assert f"measure --samples {advice['samples']}:" in printed

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


def test_what_is_wrong_with_a_log_is_counted_and_told(tmp_path: Path) -> None:
    """A gap, a row that cannot be parsed, a knock, and readings that are stuck."""
    path, lines = tmp_path / "l.csv", written(tmp_path / "l.csv", counts(4000)).read_text().splitlines()
    path.write_text("\n".join(lines[:1001] + lines[1501:]) + "\n")
    found = as_json(path)
    assert (found["gaps"], found["samples"], found["seconds"]) == (
        {"count": 1, "rows": 500},
        3500,
        pytest.approx(40.0),
    )
    assert "1 gap in its times, 500 rows long" in noise(path).stderr
    path.write_text("\n".join([*lines[:10], "0.09,oops,1024", *lines[11:]]) + "\n")
    assert ":11:" in refused(noise(path), InputError)
    found = as_json(path, "--skip-bad-rows")
    assert (found["bad_rows"], found["missing"]) == (1, {"x": 1, "y": 1})
    samples = counts(4000)
    samples[2500:, 0] += 30.0
    ((begin, end),) = as_json(written(path, samples))["moved"]
    assert begin <= 25.0 <= end
    assert f"note: it was not still: moved or knocked from {begin:.4g} to {end:.4g} s; the" in noise(path).stderr
    samples = np.round(counts(4000) * 2) / 2
    samples[300:420], samples[1000:1200] = samples[300], samples[1000]
    assert as_json(written(path, samples))["hung"] == pytest.approx([10.0, 12.0], abs=0.05)
    assert "the readings were stuck" in noise(path).stderr


class TestLive:
    ONE = ("--sensor", "sca100t-d02", "--address", "sim:seed=3")

    @pytest.mark.parametrize("name", ["still.csv", "still.parquet"])
    def test_recorded_and_done_again(self, tmp_path: Path, name: str) -> None:
        """What is kept says the same as what was recorded; the times are written to the millisecond."""
        log = tmp_path / name
        result = noise(*self.ONE, "--samples", "3000", "-o", log, "--json")
        assert result.stderr == f"3000 samples in {log}\n"
        live = json.loads(result.stdout)
        assert (
            noise(*self.ONE, "--samples", "3000").stdout.replace("the record", str(log))
            == noise(log, "--sensor", "sca100t-d02").stdout
        )
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
