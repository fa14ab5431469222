"""An SCA100T behind the kernel's interface, written apart from ours, is led by a program.

The bounds are those of a bench with a 0.01° jig and 0.6 count of noise: offsets within 0.5 count, and sensitivities
within 0.9 count/g of the part's truth.
"""

import errno
from pathlib import Path

import numpy as np
import pytest
from support.emulated.bench import SCA100T, coefficients, run_on
from support.warm_start import WarmStart

from tiltcal.files.calibration import read_calibration
from tiltcal.journal.lines import Journal
from tiltcal.library.replay import replay

pytest.importorskip("spidev", reason="the spidev package is not installed")


def test_cross_axis_with_a_wrong_position_and_a_part_that_is_unplugged(warm: WarmStart, tmp_path: Path) -> None:
    file = tmp_path / "S-0042.yaml"
    options = "--sensor sca100t-d02 --address spi:///dev/spidev0.0 --serial S-0042 --settle 0.15 --samples 30"
    command = [*warm.program, "measure", "cross-axis", *options.split(), "--operator", "json", "-o", str(file)]
    with run_on(command) as bench:
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
    assert (told[-1]["event"], told[-1]["calibrations"]) == ("done", [str(file)])
    calibration, (offset, sensitivity) = read_calibration(file), coefficients(SCA100T)
    np.testing.assert_allclose(calibration.coefficients.offset, offset, atol=0.5)
    np.testing.assert_allclose(calibration.coefficients.sensitivity, sensitivity, atol=0.9)
    # Eq. 1 on the part's truth: sqrt(11.2² + 3.5²) / 817.4 and sqrt(7.9² + 5.1²) / 821.6.
    assert calibration.derived.cross_axis_percent == pytest.approx({"x": 1.4356, "y": 1.1445}, abs=0.15)
    # What went wrong on the bus is in the journal, and replays.
    assert any(event.kind == "!" for event in Journal(tmp_path / "S-0042.journal.jsonl"))
    assert [*replay(tmp_path / "S-0042.journal.jsonl").texts.values()] == [file.read_text()]
