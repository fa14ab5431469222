"""SCL3300 and SCA3300, written apart from ours, led through their procedures behind an emulated device node.

Noise is that of the data sheets, the jig has 0.01°. Offsets are found within 0.5 mg and sensitivities within 0.5 mg/g.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal
from support.emulated.bench import Bench, PartFacts, Scl3300, run_on_spi
from support.warm_start import WarmStart

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.files.calibration import read_calibration

SPI = "spi:///dev/spidev0.0"

FEW = ("--samples", "30")


@dataclass(frozen=True)
class Setup:
    """One part on one bus, and the procedure that fits it.

    Attributes
    ----------
    sensor, address, procedure : str
    part : PartFacts
    options : tuple of str
        Of ``tiltcal measure``.
    """

    sensor: str
    address: str
    procedure: str
    part: PartFacts
    options: tuple[str, ...] = FEW

    def run(self, program: list[str]) -> AbstractContextManager[Bench]:
        pytest.importorskip("spidev", reason="the spidev package is not installed")
        return run_on_spi(program, self.part)

    def program(self, start: Sequence[str], folder: Path) -> list[str]:
        return [
            *(*start, "measure", self.procedure, "--sensor", self.sensor),
            *("--address", self.address, "--serial", "A-1", "-o", str(folder / "A-1.yaml"), "--operator", "json"),
            *("--settle", "0.12", *self.options),
        ]


SCL = Setup("scl3300", SPI, "six-face", Scl3300(), options=("--samples", "20"))
SETUPS = [
    SCL,
    Setup("sca3300-d01", f"{SPI}?range=1.5g", "six-face", Scl3300(0x51, noise=0.4e-3, corner=70.0, seed=3)),
]


@pytest.mark.parametrize("setup", SETUPS, ids=lambda setup: f"{setup.sensor} on {setup.address}")
def test_a_calibration_finds_the_truth_of_the_part(setup: Setup, warm: WarmStart, tmp_path: Path) -> None:
    with setup.run(setup.program(warm.program, tmp_path)) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
        assert bench.counts()["forbidden"] == 0
    assert told[-1]["event"] == "done"
    require_true(setup, tmp_path)


def test_a_damaged_line_costs_frames_and_no_accuracy(warm: WarmStart, tmp_path: Path) -> None:
    """One bit of one frame in fifty: the calibration is as good, and the file says what the line damaged."""
    setup = replace(SCL, part=Scl3300(damage=0.02, seed=5), options=("--samples", "50"))
    with setup.run(setup.program(warm.program, tmp_path)) as bench:
        assert bench.lead()[-1]["event"] == "done"
        assert bench.exit_code == 0, bench.errors()
        part = bench.counts()
    require_true(setup, tmp_path)
    counted = read_calibration(tmp_path / "A-1.yaml").provenance.link_statistics
    # The probe before the session has a link of its own; what it saw damaged is in no file.
    assert 0 <= part["answers_damaged"] - counted["damaged"] <= 4
    assert 0 <= part["requests_damaged"] - counted["refused"] <= 6
    assert counted["damaged"] + counted["refused"] > 20
    again = tiltcal("replay", tmp_path / "A-1.journal.jsonl")
    assert again.stdout.encode() == (tmp_path / "A-1.yaml").read_bytes()


def require_true(setup: Setup, folder: Path) -> None:
    model = find_model(setup.sensor).at(parse_address(setup.address))
    found = read_calibration(folder / "A-1.yaml").coefficients
    truth = [[offset, *row] for offset, row in zip(setup.part.offset, setup.part.sensitivity, strict=True)]
    offset, sensitivity = np.array(truth)[:, 0], np.array(truth)[:, 1:]
    np.testing.assert_allclose((np.array(found.offset) - model.offset) / model.sensitivity, offset, atol=0.5e-3)
    determined = np.array(found.sensitivity) / model.sensitivity
    np.testing.assert_allclose(determined, sensitivity[:, : determined.shape[1]], atol=0.5e-3)
