"""Parts behind the kernel's interfaces, the SCA100T one written apart from ours, are led by a program.

The bounds are those of a bench with a 0.01° jig. Of an SCA100T with 0.6 count of noise: offsets within 0.5 count and
sensitivities within 0.9 count/g of the part's truth; of an SCA3000 with 1.5 count of noise 0.9 of both.
"""

import errno
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command import TILTCAL
from support.emulated.bench import SCA100T, SCA3000, coefficients, run_on, truth
from support.warm_start import WarmStart

from tiltcal.drivers.virtual import Truth
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.journal.lines import Journal
from tiltcal.library.replay import replay

pytest.importorskip("spidev", reason="the spidev package is not installed")

FLAT = truth(0.6, (1026.3, 817.4, 11.2, 0.0), (1020.8, -7.9, 821.6, 0.0))

ON_SPI = ("--sensor", "sca100t-d02", "--address", "spi:///dev/spidev0.0")
SCA3000_ON_SPI = ("--sensor", "sca3000-d01", "--address", "spi:///dev/spidev0.0")
SCA3000_ON_I2C = ("--sensor", "sca3000-i2c", "--address", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1333&rate=250")


def program(start: Sequence[str], procedure: str, folder: Path, *options: str) -> list[str]:
    return [
        *(*start, "measure", procedure, *ON_SPI, "--serial", "S-0042", "-o", str(folder / "S-0042.yaml")),
        *("--operator", "json", "--settle", "0.15", "--samples", "30", *options),
    ]


def near(file: Path, part: Truth, offset: float, sensitivity: float) -> CalibrationRecord:
    """The calibration in a file, which is that of a part within these bounds."""
    calibration = read_calibration(file)
    for found, true, bound in zip(
        (calibration.coefficients.offset, calibration.coefficients.sensitivity),
        coefficients(part),
        (offset, sensitivity),
        strict=True,
    ):
        np.testing.assert_allclose(found, true, atol=bound)
    return calibration


def test_cross_axis_with_a_wrong_position_and_a_part_that_is_unplugged(warm: WarmStart, tmp_path: Path) -> None:
    with run_on(program(warm.program, "cross-axis", tmp_path)) as bench:
        first = bench.read()
        bench.take(first, gravity=(-0.5, 0.0, 0.866025404))
        refused = bench.read()
        assert (refused["event"], refused["position"]) == ("refused", "x-tilt1")
        assert "x-tilt2" in str(refused["why"])
        again = bench.read()
        assert again == first
        bench.take(again)
        assert bench.read()["event"] == "accepted"
        bench.fail(errno.EIO)
        bench.take()
        refused = bench.read()
        assert (refused["event"], "/dev/spidev0.0" in str(refused["why"])) == ("refused", True)
        bench.fail(0)
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    assert (told[-1]["event"], told[-1]["calibrations"]) == ("done", [str(tmp_path / "S-0042.yaml")])
    calibration = near(tmp_path / "S-0042.yaml", SCA100T, 0.5, 0.9)
    # Eq. 1 on the part's truth: sqrt(11.2² + 3.5²) / 817.4 and sqrt(7.9² + 5.1²) / 821.6.
    assert calibration.derived.cross_axis_percent == pytest.approx({"x": 1.4356, "y": 1.1445}, abs=0.15)
    # What went wrong on the bus is in the journal, and replays.
    assert any(event.kind == "!" for event in Journal(tmp_path / "S-0042.journal.jsonl"))
    assert [*replay(tmp_path / "S-0042.journal.jsonl").texts.values()] == [(tmp_path / "S-0042.yaml").read_text()]


def test_killed_on_the_real_bus_and_resumed(warm: WarmStart, tmp_path: Path) -> None:
    with run_on(program(TILTCAL, "plane", tmp_path, "--samples", "30"), FLAT) as bench:
        for _ in range(2):
            bench.take()
            assert bench.read()["event"] == "accepted"
        bench.take()
        bench.kill(signal.SIGKILL)
        assert bench.exit_code == 128 + signal.SIGKILL
    journal = tmp_path / "S-0042.journal.jsonl"
    before = journal.read_bytes()
    with run_on([*warm.program, "measure", "--resume", str(journal)], FLAT) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    # The third position was being measured; nobody knows how the bench stands now, so it is asked for again.
    assert [message["position"] for message in told if "ask" in message] == ["y-tilt1", "y-tilt2"]
    assert told[-1]["event"] == "done"
    assert journal.read_bytes()[: before.rfind(b"\n") + 1] == before[: before.rfind(b"\n") + 1]
    near(tmp_path / "S-0042.yaml", FLAT, 0.7, 1.0)
    assert [event.kind for event in Journal(journal)].count("resumed") == 1
    assert replay(journal).texts == {"S-0042.yaml": (tmp_path / "S-0042.yaml").read_text(encoding="utf-8")}


def test_six_face_on_spi_and_on_i2c(warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    for start, options, part, *where in (
        (TILTCAL, SCA3000_ON_SPI, SCA3000, "sca3000-d01"),
        (warm.program, SCA3000_ON_I2C, replace(SCA3000, seed=2), "sca3000-i2c", 0x1D),
    ):
        with run_on(program(start, "six-face", tmp_path, *options), part, *where) as bench:
            bench.lead()
            assert bench.exit_code == 0, bench.errors()
        found = near(tmp_path / "S-0042.yaml", part, 0.9, 0.9)
        if options is SCA3000_ON_SPI:
            # The part's own thermometer: 24 °C is raw 257.8, sent as 258, read as 24.1 °C.
            assert [position.temperature for position in found.positions] == pytest.approx([24.11] * 6, abs=0.01)
        (tmp_path / "S-0042.yaml").unlink()  # the calibration of another model is never replaced
