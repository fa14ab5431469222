"""Drivers by other hands read our virtual parts: the counts are the truth, and their scale is near ours."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from kernel.accelerometers import JUDGED as LINUX

from .boards import Board, G, foreign
from .test_johnny_five import CASES

ROOT = Path(__file__).resolve().parents[2]

Values = tuple[float, ...]


class Judge(NamedTuple):
    """A driver by another hand, and how it is asked.

    options, letter: of our virtual part, which it sets to this range by itself; its bus.
    module, read: where it is; ``read(module, board)`` returns x, y and z, and the temperature where it has one.
    counts: of the part, for 1 in the driver's unit, by its own constants.
    unit: 1 g in the driver's unit.
    near: largest relative difference between its sensitivity and ours, where it rounds.
    """

    model: str
    options: str
    module: str
    read: Any
    counts: float
    unit: float = G
    letter: str = "i"
    near: float = 1e-3


RANGES = {"2g": 0, "4g": 1, "8g": 2, "16g": 3}


def adafruit(kind: str, prepare: Any) -> Any:
    """Read a driver of Adafruit's, which gives m/s² and °C."""

    def read(module: Any, board: Board) -> tuple[Values, float | None]:
        sensor = getattr(module, kind)(board)
        prepare(module, sensor)
        return sensor.acceleration, getattr(sensor, "temperature", None)

    return read


def with_range(word: str) -> Any:
    def prepare(module: Any, sensor: Any) -> None:
        sensor.range = RANGES[word]

    return prepare


def mpu6050_range(word: str) -> Any:
    def prepare(module: Any, sensor: Any) -> None:
        sensor.accelerometer_range = RANGES[word]

    return prepare


def lsm6ds(kind: str, word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float | None]:
        sensor = getattr(module, kind)(board)
        sensor.accelerometer_range = {"2g": 0, "16g": 1, "4g": 2, "8g": 3}[word]
        # It takes the LSM6DS3's 16 counts for 1 °C to be 256, as its successors have.
        return sensor.acceleration, None if kind == "LSM6DS33" else sensor.temperature

    return read


def lis3dh_on_spi(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, None]:
        sensor = module.LIS3DH_SPI(board, None)
        sensor.range = RANGES[word]
        return sensor.acceleration, None

    return read


def fabo(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.MPU9250()
        assert sensor.searchDevice()
        sensor.configMPU9250(module.GFS_250, RANGES[word])
        return tuple(sensor.readAccel()[axis] for axis in "xyz"), sensor.readTemperature()

    return read


def jmdev(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.MPU9250(bus=1, afs=getattr(module, f"AFS_{word.upper()}"))
        sensor.abias = [0.0] * 3
        sensor.configureMPU6500(sensor.gfs, sensor.afs)
        return tuple(sensor.readAccelerometerMaster()), sensor.readTemperatureMaster()

    return read


def bmi160(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.Driver()
        assert sensor.get_device_id() == 0xD1
        sensor.setFullScaleAccelRange({"2g": 3, "4g": 5, "8g": 8, "16g": 12}[word], float(word[:-1]))
        return tuple(sensor.getAcceleration()), sensor.getTemperature()

    return read


def bmi160_on_circuitpython(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.BMI160(board)
        sensor.acceleration_range = getattr(module, f"ACCEL_RANGE_{word.upper()}")
        return sensor.acceleration, sensor.temperature

    return read


def icm20948(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, None]:
        sensor = module.ICM20948(board)
        sensor.accelerometer_range = getattr(module, f"RANGE_{word.upper()}")
        return sensor.acceleration, None

    return read


def icm20948_by_adafruit(word: str) -> Any:
    """Its temperature is not read by the driver; its compass is asked for, and does not answer."""

    def read(module: Any, board: Board) -> tuple[Values, None]:
        module.ICM20948._magnetometer_init = lambda sensor: True
        sensor = module.ICM20948(board)
        sensor.accelerometer_range = getattr(module.AccelRange, f"RANGE_{word.upper()}")
        return sensor.acceleration, None

    return read


def ism330dhcx(code: int) -> Any:
    """Read an IIS2ICLX as its sibling with the same registers and identity; only the counts are its own."""

    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.ISM330DHCX(board)
        sensor.accelerometer_range = code
        return tuple(map(float, sensor._raw_accel_data[:2])), sensor.temperature

    return read


def adxl355(word: str) -> Any:
    def read(module: Any, board: Board) -> tuple[Values, float]:
        sensor = module.ADXL355(board)
        assert sensor.probe()
        sensor.reset()
        sensor.set_range(getattr(module.Range, f"G{word[0]}"))
        sensor.set_power_mode(module.PowerMode.MEASUREMENT)
        value = sensor.read_acceleration_g()
        return (value.x, value.y, value.z), sensor.read_temperature_c()

    return read


def sca3300(word: str) -> Any:
    """It takes no notice of its first answers, so it reads twice."""

    def read(module: Any, board: Board) -> tuple[Values, None]:
        sensor = module.SCA3300()
        sensor.mode = {"3g": module.Modes.MODE_1, "6g": module.Modes.MODE_2, "1.5g": module.Modes.MODE_3}[word]
        assert len(sensor.acceleration) == 3
        return sensor.acceleration, None

    return read


def every(model: str, module: str, read: Any, counts: float, words: str = "2g 4g 8g 16g", **facts: Any) -> list[Judge]:
    """One judge for each range; ``counts`` is for 1 g at ±2 g, and half at the next."""
    return [
        Judge(
            model, f"range={word}", module, read(word), counts * 2.0 / float(word[:-1]) / facts.get("unit", G), **facts
        )
        for word in words.split()
    ]


JUDGES = (
    # Its default range is ±2 g of ten bits, and 4 mg a digit; setting a range turns full resolution on.
    *(
        Judge(
            "adxl345", f"range={word}", "adafruit_adxl34x", adafruit("ADXL345", with_range(word)), 250.0 / G, near=0.03
        )
        for word in RANGES
    ),
    # It takes the 1, 2, 4 and 12 mg of a digit to be 1/16 of 1/16380 g and so on.
    *(
        Judge("lis3dh", f"range={word}", "adafruit_lis3dh", read, divisor / 16.0 / 9.806, letter=letter, near=0.03)
        for word, divisor in (("2g", 16380.0), ("4g", 8190.0), ("8g", 4096.0), ("16g", 1365.0))
        for letter, read in (("i", adafruit("LIS3DH_I2C", with_range(word))), ("s", lis3dh_on_spi(word)))
    ),
    *every("mpu6050", "adafruit_mpu6050", lambda word: adafruit("MPU6050", mpu6050_range(word)), 16384.0),
    *every("icm20948", "adafruit_icm20x", icm20948_by_adafruit, 16384.0),
    *every("icm20948", "micropython_icm20948.icm20948", icm20948, 16384.0),
    *every("mpu9250", "FaBo9Axis_MPU9250.MPU9250", fabo, 16384.0, unit=1.0),
    *every("mpu9250", "mpu9250_jmdev.mpu_9250", jmdev, 16384.0, unit=1.0),
    *every("bmi160", "bmi160", bmi160_on_circuitpython, 16384.0),
    *(Judge("bmi160", f"range={word}", "BMI160_i2c", bmi160(word), 1.0, 0.0) for word in RANGES),
    *(
        judge
        for name, module, kind in (
            ("lsm6ds3tr-c", "lsm6ds3trc", "LSM6DS3TRC"),
            ("lsm6ds3", "lsm6ds33", "LSM6DS33"),
            ("lsm6dsox", "lsm6dsox", "LSM6DSOX"),
        )
        for judge in every(
            name, f"adafruit_lsm6ds.{module}", lambda word, kind=kind: lsm6ds(kind, word), 1000.0 / 0.061
        )
    ),
    *every("mma8451", "adafruit_mma8451", lambda word: adafruit("MMA8451", with_range(word)), 4096.0, "2g 4g 8g"),
    # It reads 14 bits of a part that has 12.
    *every("msa311", "adafruit_msa3xx", lambda word: adafruit("MSA311", with_range(word)), 1024.0),
    *(
        Judge("adxl355", f"range={word}g", "adxl355", adxl355(f"{word}g"), 2.0 / 3.9e-6 / word, 1.0, letter, 2e-3)
        for word in (2, 4, 8)
        for letter in "si"
    ),
    *(
        Judge("iis2iclx", f"range={word}", "adafruit_lsm6ds.ism330dhcx", ism330dhcx(code), 1.0, 0.0)
        for word, code in (("0.5g", 0), ("1g", 2), ("2g", 3), ("3g", 1))
    ),
    *(
        Judge("sca3300-d01", f"range={word}", "sca3300", sca3300(word), counts / G, letter="s")
        for word, counts in (("3g", 2700.0), ("6g", 1350.0), ("1.5g", 5400.0))
    ),
)


@pytest.mark.parametrize("judge", JUDGES, ids=lambda one: f"{one.model} {one.letter} {one.options} {one.module}")
def test_it_reads_the_truth(judge: Judge, monkeypatch: pytest.MonkeyPatch) -> None:
    board = Board(judge.model, judge.options, judge.letter)
    board.install(monkeypatch)
    with foreign(judge.module) as module:
        values, celsius = judge.read(module, board)
    counts = [value * judge.counts for value in values]
    # A driver may print few digits.
    rounding = 0.51 + (0.0005 * judge.counts if "FaBo" in judge.module else 0.0)
    assert counts == pytest.approx(board.counts(), abs=rounding)
    if judge.unit:
        assert judge.counts * judge.unit == pytest.approx(board.model.sensitivity, rel=judge.near)
    if celsius is not None:
        assert celsius == pytest.approx(board.celsius, abs=0.51 * board.model.thermometer_step + 0.001)
    # What it has set up, ours reads as well.
    ours = board.model.driver(board.part, board.clock).read()
    assert list(ours.values) == pytest.approx(counts, abs=rounding)


WHOSE = {
    "adafruit": "Adafruit",
    "adxl355": "`adxl355`",
    "BMI160_i2c": "`bmi160-i2c`",
    "bmi160": "`circuitpython-bmi160`",
    "FaBo9Axis": "FaBo",
    "micropython": "`micropython-icm20948`",
    "mpu9250": "`mpu9250-jmdev`",
    "sca3300": "`sca3300`",
}
"""By the first part of a module's name."""


def test_the_documentation_says_whose_drivers_judge_a_model() -> None:
    page = (ROOT / "docs" / "which-sensor.md").read_text(encoding="utf-8")
    rows = [cells for line in page.splitlines() if len(cells := line.split("|")[1:-1]) == 6]
    said = {name: cells[5] for cells in rows for name in re.findall("`([^`]+)`", cells[2])}
    judged = {(judge.model, WHOSE[re.split(r"[._](?!i2c)", judge.module)[0]]) for judge in JUDGES}
    judged |= {(judge.model, "Linux") for judge in LINUX} | {(case[0], "johnny-five") for case in CASES}
    assert [(model, name) for model, name in sorted(judged) if name not in said[model]] == []
    assert len({model for model, _ in judged}) >= 20
