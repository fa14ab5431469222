"""An SCA100T that was written apart from ours, behind /dev/spidev0.0, is led through procedures by a program.

The bounds are those of a bench with 0.6 count of noise and a 0.01° jig: offsets within 0.5 count and sensitivities
within 0.9 count/g of the part's truth.
"""

from __future__ import annotations

import errno
import signal
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.command import TILTCAL
from support.emulated.bench import Part, run_on_spi
from support.warm_start import WarmStart

from tiltcal.bench.journal import calibrations_of
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.journal import read_journal

pytest.importorskip("spidev", reason="the spidev package is not installed")

FLAT = Part(sensitivity=((817.4, 11.2, 0.0), (-7.9, 821.6, 0.0)))


def program(start: Sequence[str], procedure: str, folder: Path, *options: str) -> list[str]:
    return [
        *(*start, "measure", procedure, "--sensor", "sca100t-d02"),
        *("--address", "spi:///dev/spidev0.0", "--serial", "S-0042", "-o", str(folder / "S-0042.yaml")),
        *("--operator", "json", "--settle", "0.15", "--samples", "30", *options),
    ]


def led(start: Sequence[str], procedure: str, folder: Path, part: Part) -> CalibrationRecord:
    with run_on_spi(program(start, procedure, folder), part) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    assert told[-1]["event"] == "done"
    assert told[-1]["calibrations"] == [str(folder / "S-0042.yaml")]
    return read_calibration(folder / "S-0042.yaml")


def test_plane(tmp_path: Path) -> None:
    found = led(TILTCAL, "plane", tmp_path, FLAT).coefficients
    np.testing.assert_allclose(found.offset, FLAT.offset, atol=0.5)
    np.testing.assert_allclose(found.sensitivity[:, :2], np.array(FLAT.sensitivity)[:, :2], atol=0.9)


def test_cross_axis(warm: WarmStart, tmp_path: Path) -> None:
    part = Part()
    calibration = led(warm.program, "cross-axis", tmp_path, part)
    np.testing.assert_allclose(calibration.coefficients.offset, part.offset, atol=0.5)
    np.testing.assert_allclose(calibration.coefficients.sensitivity, part.sensitivity, atol=0.9)
    # Eq. 1 on the part's truth: sqrt(11.2² + 3.5²) / 817.4 and sqrt(7.9² + 5.1²) / 821.6.
    assert calibration.derived.cross_axis_percent["x"] == pytest.approx(1.4356, abs=0.15)
    assert calibration.derived.cross_axis_percent["y"] == pytest.approx(1.1445, abs=0.15)


def test_a_wrong_position_is_refused_and_asked_for_again(warm: WarmStart, tmp_path: Path) -> None:
    with run_on_spi(program(warm.program, "plane", tmp_path, "--samples", "20"), FLAT) as bench:
        first = bench.read()
        bench.take(first, gravity=(-0.5, 0.0, 0.866025404))
        refused = bench.read()
        assert refused["event"] == "refused"
        assert refused["position"] == "x-tilt1"
        assert "x-tilt2" in str(refused["why"])
        again = bench.read()
        assert again == first
        bench.take(again)
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    assert told[0]["event"] == "accepted"


def test_unplugged_in_mid_session_and_plugged_in_again(warm: WarmStart, tmp_path: Path) -> None:
    with run_on_spi(program(warm.program, "plane", tmp_path, "--samples", "20"), FLAT) as bench:
        bench.take()
        assert bench.read()["event"] == "accepted"
        bench.fail(errno.EIO)
        bench.take()
        refused = bench.read()
        assert refused["event"] == "refused"
        assert "/dev/spidev0.0" in str(refused["why"])
        bench.fail(0)
        bench.lead()
        assert bench.exit_code == 0, bench.errors()
    found = read_calibration(tmp_path / "S-0042.yaml").coefficients
    np.testing.assert_allclose(found.offset, FLAT.offset, atol=0.7)
    # What went wrong on the bus is in the journal, and replays.
    events = read_journal(tmp_path / "S-0042.journal.jsonl").events
    assert any(event.kind == "!" for event in events)


def test_a_part_that_stays_away_ends_the_session_and_keeps_it(warm: WarmStart, tmp_path: Path) -> None:
    with run_on_spi(program(warm.program, "plane", tmp_path, "--samples", "20"), FLAT) as bench:
        bench.take()
        assert bench.read()["event"] == "accepted"
        bench.fail(errno.ENODEV)
        bench.lead()
        assert bench.exit_code == 3
        assert "--resume" in bench.errors()
    assert not (tmp_path / "S-0042.yaml").exists()
    assert read_journal(tmp_path / "S-0042.journal.jsonl").end is None


def test_a_faulty_part_is_told_before_the_first_prompt(warm: WarmStart, tmp_path: Path) -> None:
    part = Part(offset=(10.0, 10.0), noise=0.0)
    with run_on_spi(program(warm.program, "plane", tmp_path), part) as bench:
        told = bench.lead()
        assert bench.exit_code == 3
        assert "fault signal" in bench.errors()
    assert told == []
    assert list(tmp_path.iterdir()) == []


def test_a_captured_real_session_replays_to_the_byte(warm: WarmStart, tmp_path: Path) -> None:
    led(warm.program, "plane", tmp_path, FLAT)
    with run_on_spi([*warm.program, "replay", str(tmp_path / "S-0042.journal.jsonl")]) as bench:
        text = bench.process.stdout.read()
    assert text.encode() == (tmp_path / "S-0042.yaml").read_bytes()


def test_killed_on_the_real_bus_and_resumed(warm: WarmStart, tmp_path: Path) -> None:
    with run_on_spi(program(TILTCAL, "plane", tmp_path, "--samples", "30"), FLAT) as bench:
        for _ in range(2):
            bench.take()
            assert bench.read()["event"] == "accepted"
        bench.take()
        bench.kill(signal.SIGKILL)
        assert bench.exit_code == 128 + signal.SIGKILL
    journal = tmp_path / "S-0042.journal.jsonl"
    before = journal.read_bytes()
    with run_on_spi([*warm.program, "measure", "--resume", str(journal)], FLAT) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    # The third position was being measured; nobody knows how the bench stands now, so it is asked for again.
    assert [message["position"] for message in told if "ask" in message] == ["y-tilt1", "y-tilt2"]
    assert told[-1]["event"] == "done"
    assert journal.read_bytes()[: before.rfind(b"\n") + 1] == before[: before.rfind(b"\n") + 1]
    found = read_calibration(tmp_path / "S-0042.yaml").coefficients
    np.testing.assert_allclose(found.offset, FLAT.offset, atol=0.7)
    assert [event.kind for event in read_journal(journal).events].count("resumed") == 1
    assert (
        next(iter(calibrations_of(read_journal(journal)).texts().values())).encode()
        == (tmp_path / "S-0042.yaml").read_bytes()
    )
