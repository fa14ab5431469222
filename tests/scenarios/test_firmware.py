"""The firmware for the ADXL202's microcontroller under simavr: exact edges in, sentences out, tiltcal behind it.

1 mg is 0.125 ‰ of the period, which is 2 cycles of 16 MHz at T2 = 1 ms.
"""

from math import sqrt
from pathlib import Path

import pytest
import yaml
from support.firmware import Board, Pulses, built
from support.json_program import lead

from tiltcal.drivers.adxl202 import parse_sentence

PER_MG = 1.25e-4


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Board:
    return built(tmp_path_factory.mktemp("firmware"))


def errors(sent: bytes, pulses: Pulses) -> list[list[float]]:
    """Error of each sentence's duty cycles, mg, of x and of y; every sentence is whole, and none is missing."""
    lines = sent.split(b"\r\n")[:-1]
    sentences = [parse_sentence(line) for line in lines]
    assert [sentence and sentence.number for sentence in sentences] == list(range(len(lines)))
    return [
        [(sentence.duty[axis] - high / pulses.period) / PER_MG for sentence in sentences]
        for axis, high in enumerate((pulses.x, pulses.y))
    ]


SKEWS = (0, 1, 2, 3, 5, 8, 13, 30, 60, 100, 130, 160, 220, 290, 300, 310, 400, 7000)
"""In cycles: from coinciding edges to such as an interrupt would be done with."""


@pytest.mark.parametrize("centred", [False, True], ids=["common rise", "common centre"])
@pytest.mark.parametrize(("period", "rms"), [(16_000, 3.0), (160_000, 0.5)], ids=["T2 = 1 ms", "T2 = 10 ms"])
def test_duty_cycles_are_right_at_any_phase(board: Board, period: int, rms: float, centred: bool) -> None:
    for skew in SKEWS:
        # One T1 is odd, so that with common centres the edges of y lie between those of x's half cycles.
        pulses = Pulses(period, period * 9 // 16, period * 7 // 16 + 1, skew, centred)
        for one in errors(board.run(pulses, 1.0 if period < 100_000 else 4.0), pulses):
            assert len(one) > 80
            assert abs(sum(one) / len(one)) <= 0.3
            assert sqrt(sum(error**2 for error in one) / len(one)) <= rms


@pytest.mark.parametrize("period", [8_000, 32_768, 65_536, 80_000, 131_072, 192_000])
@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_every_period_of_the_part_and_those_of_the_timer(board: Board, period: int, share: float) -> None:
    """From 0.5 ms to 12 ms; a period of whole timer rounds finds the timer's overflow at the same place each time."""
    pulses = Pulses(period, round(period * share), period // 2, skew=11)
    for one in errors(board.run(pulses, 2.0), pulses):
        assert len(one) > 20
        assert max(map(abs, one)) <= 0.3 * 160_000 / period


@pytest.mark.parametrize("x", [8_000, 8_001])
def test_an_overflow_as_a_measurement_begins_is_counted(board: Board, x: int) -> None:
    """Sentence 313 of this run once had a T2 that was short by a whole round of the timer."""
    pulses = Pulses(16_000, x, 8_000, centred=True)
    assert max(abs(error) for one in errors(board.run(pulses, 3.0), pulses) for error in one) <= 0.3


def test_two_minutes_without_a_lost_or_damaged_sentence(board: Board) -> None:
    """The period is odd, so that the timer's overflow is at another place of each: 12,000 places, where ten minutes of
    a period of 160,000 cycles would have 256."""
    pulses = Pulses(160_001, 71_234, 93_211, centred=True)
    found = errors(board.run(pulses, 120.0), pulses)
    assert len(found[0]) > 2_800
    assert max(abs(error) for one in found for error in one) <= 0.5


@pytest.mark.parametrize(("axis", "pin"), [("x", "pin 2 (x)"), ("y", "pin 3 (y)")])
def test_an_output_without_pulses_is_named(board: Board, axis: str, pin: str) -> None:
    sent = board.run(Pulses(**{axis: 0}), 0.5).decode()
    assert set(sent.split("\r\n")[:-1]) == {f"no pulses on {pin}"}


OFFSET, SENSITIVITY = (0.5123, 0.4868), ((0.1312, 0.0021), (-0.0014, 0.1187))
DRIFT = (2.1e-4, -1.6e-4)
"""Duty cycle per °C from 24 °C."""


@pytest.mark.parametrize("centred", [False, True], ids=["common rise", "common centre"])
def test_mavs_through_firmware_and_driver(board: Board, centred: bool, tmp_path: Path) -> None:
    pytest.importorskip("serial", reason="the pyserial package is not installed")
    period = 163_840

    def pose(ask: dict) -> dict:
        if "ask" not in ask:
            return None
        gravity, warm = ask["gravity"], ask["temperature"] - 24.0
        highs = {
            axis: round(period * (OFFSET[row] + DRIFT[row] * warm + sum(map(product, SENSITIVITY[row], gravity))))
            for row, axis in enumerate("xy")
        }
        running.set(**highs)
        return {"answer": "ready", "temperature": ask["temperature"]}

    with board.on_a_pty(Pulses(period, 80_000, 80_000, centred=centred)) as running:
        session = lead(
            *("measure", "mavs", "--sensor", "adxl202", "--serial", "A-1005"),
            *("--address", f"serial://{running.path}?baudrate=115200", "--jig", "0.001"),
            *("--settle", "0.1", "--samples", "40", "-o", "A-1005.yaml"),
            cwd=tmp_path,
            answer=pose,
        )
    assert session.exit_code == 0, session.errors
    file = yaml.safe_load((tmp_path / "A-1005.yaml").read_text())
    found, known = file["calibration"], file["uncertainty"]
    factors = known["coverage_factor"]
    tick = 1.0 / period
    for row, channel in enumerate("xy"):
        wide = factors.get(f"offset.{channel}", 2.0) * known["offset"][channel]
        assert found["offset"][channel] == pytest.approx(OFFSET[row], abs=wide + tick)
        for column, axis in enumerate("xy"):
            wide = factors.get(f"sensitivity.{channel}.{axis}", 2.0) * known["sensitivity"][channel][axis]
            assert found["sensitivity"][channel][axis] == pytest.approx(SENSITIVITY[row][column], abs=wide + tick)


def product(a: float, b: float) -> float:
    return a * b
