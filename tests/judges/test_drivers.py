"""Drivers by other hands read our virtual parts: the counts are the truth, and their scale is near ours."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import pytest
from kernel.accelerometers import JUDGED as LINUX
from support.virtual_device import Line

from tiltcal.drivers import scl3300
from tiltcal.errors import DeviceFault

from .boards import Board, G, foreign
from .test_johnny_five import CASES

ROOT = Path(__file__).resolve().parents[2]
ACCELEROMETER = ("2g", "4g", "8g", "16g")
LSM = {"2g": 0, "16g": 1, "4g": 2, "8g": 3}
BMI = {"2g": 3, "4g": 5, "8g": 8, "16g": 12}


def in_order(word: str) -> int:
    return ACCELEROMETER.index(word)


def by_adafruit(kind: str, setting: str = "range", code: Callable[[str], int] = in_order) -> Any:
    """Open a driver of CircuitPython, and set its range."""

    def opened(module: Any, board: Board, word: str) -> Any:
        sensor = getattr(module, kind)(board, None) if kind.endswith("SPI") else getattr(module, kind)(board)
        setattr(sensor, setting, code(word))
        return sensor

    return opened


def with_codes(codes: dict[str, int], kind: str) -> Any:
    return by_adafruit(kind, "accelerometer_range", codes.__getitem__)


def adafruits_icm20948(module: Any, board: Board, word: str) -> Any:
    """Its compass, which does not answer here, is not asked for."""
    module.ICM20948._magnetometer_init = lambda sensor: True
    return by_adafruit("ICM20948", "accelerometer_range")(module, board, word)


def fabo(module: Any, board: Board, word: str) -> Any:
    sensor = module.MPU9250()
    assert sensor.searchDevice()
    sensor.configMPU9250(module.GFS_250, in_order(word))
    return sensor


def jmdev(module: Any, board: Board, word: str) -> Any:
    sensor = module.MPU9250(bus=1, afs=in_order(word))
    sensor.abias = [0.0] * 3
    sensor.configureMPU6500(sensor.gfs, sensor.afs)
    return sensor


def bmi160(module: Any, board: Board, word: str) -> Any:
    sensor = module.Driver()
    assert sensor.get_device_id() == 0xD1
    sensor.setFullScaleAccelRange(BMI[word], float(word[:-1]))
    return sensor


def adxl355(module: Any, board: Board, word: str) -> Any:
    sensor = module.ADXL355(board)
    assert sensor.probe()
    sensor.reset()
    sensor.set_range(getattr(module.Range, f"G{word[0]}"))
    sensor.set_power_mode(module.PowerMode.MEASUREMENT)
    return sensor


def sca3300(module: Any, board: Board, word: str) -> Any:
    """It takes no notice of what its first answers say, so it reads once in vain."""
    sensor = module.SCA3300()
    sensor.mode = {"3g": module.Modes.MODE_1, "6g": module.Modes.MODE_2, "1.5g": module.Modes.MODE_3}[word]
    assert len(sensor.acceleration) == 3
    return sensor


class Judge(NamedTuple):
    """A driver by another hand, and how it is asked.

    counts: at each range, of the part, for 1 g in the driver by its own constants.
    unit: 1 g in the driver's unit; 0 where it gives counts.
    near: largest relative difference between its sensitivity and ours, where it rounds or takes another one.
    digit: of what it prints, in its unit.
    """

    model: str
    module: str
    open: Any
    counts: dict[str, float]
    unit: float = G
    letters: str = "i"
    near: float = 1e-3
    digit: float = 0.0
    values: Callable[[Any], Sequence[float]] = lambda sensor: sensor.acceleration
    celsius: Callable[[Any], float | None] = lambda sensor: None


def halved(counts: float, words: Sequence[str] = ACCELEROMETER) -> dict[str, float]:
    """From that of ±2 g."""
    return {word: counts * 2.0 / float(word[:-1]) for word in words}


def celsius(sensor: Any) -> float:
    """As most drivers have it."""
    return float(sensor.temperature)


SIXTEENTHS = {"2g": 16380 / 16, "4g": 8190 / 16, "8g": 4096 / 16, "16g": 1365 / 16}
JUDGES = (
    # It takes a digit of 1/256 g to be 4 mg; setting a range turns full resolution on.
    Judge("adxl345", "adafruit_adxl34x", by_adafruit("ADXL345"), dict.fromkeys(ACCELEROMETER, 250.0), near=0.03),
    # It takes the 1, 2, 4 and 12 mg of a digit to be 1/16 of 1/16380 g and so on, and 1 g to be 9.806 m/s².
    Judge("lis3dh", "adafruit_lis3dh", by_adafruit("LIS3DH_I2C"), SIXTEENTHS, 9.806, near=0.03),
    Judge("lis3dh", "adafruit_lis3dh", by_adafruit("LIS3DH_SPI"), SIXTEENTHS, 9.806, "s", near=0.03),
    Judge(
        "mpu6050", "adafruit_mpu6050", by_adafruit("MPU6050", "accelerometer_range"), halved(16384.0), celsius=celsius
    ),
    Judge("icm20948", "adafruit_icm20x", adafruits_icm20948, halved(16384.0)),
    Judge(
        "icm20948",
        "micropython_icm20948.icm20948",
        by_adafruit("ICM20948", "accelerometer_range"),
        halved(16384.0),
        celsius=celsius,
    ),
    Judge(
        "mpu9250",
        "FaBo9Axis_MPU9250.MPU9250",
        fabo,
        halved(16384.0),
        1.0,
        digit=1e-3,
        values=lambda sensor: [sensor.readAccel()[axis] for axis in "xyz"],
        celsius=lambda sensor: sensor.readTemperature(),
    ),
    Judge(
        "mpu9250",
        "mpu9250_jmdev.mpu_9250",
        jmdev,
        halved(16384.0),
        1.0,
        values=lambda sensor: sensor.readAccelerometerMaster(),
        celsius=lambda sensor: sensor.readTemperatureMaster(),
    ),
    Judge(
        "bmi160",
        "bmi160",
        by_adafruit("BMI160", "acceleration_range", BMI.__getitem__),
        halved(16384.0),
        celsius=celsius,
    ),
    Judge(
        "bmi160",
        "BMI160_i2c",
        bmi160,
        dict.fromkeys(ACCELEROMETER, 1.0),
        0.0,
        values=lambda sensor: sensor.getAcceleration(),
        celsius=lambda sensor: sensor.getTemperature(),
    ),
    Judge(
        "lsm6ds3tr-c", "adafruit_lsm6ds.lsm6ds3trc", with_codes(LSM, "LSM6DS3TRC"), halved(1e3 / 0.061), celsius=celsius
    ),
    Judge("lsm6dsox", "adafruit_lsm6ds.lsm6dsox", with_codes(LSM, "LSM6DSOX"), halved(1e3 / 0.061), celsius=celsius),
    # It takes the LSM6DS3's 16 counts for 1 °C to be 256, as its successors have.
    Judge("lsm6ds3", "adafruit_lsm6ds.lsm6ds33", with_codes(LSM, "LSM6DS33"), halved(1e3 / 0.061)),
    # An IIS2ICLX as its sibling with the same registers, codes and identity; only the counts are its own.
    Judge(
        "iis2iclx",
        "adafruit_lsm6ds.ism330dhcx",
        with_codes({"0.5g": 0, "1g": 2, "2g": 3, "3g": 1}, "ISM330DHCX"),
        dict.fromkeys(("0.5g", "1g", "2g", "3g"), 1.0),
        0.0,
        values=lambda sensor: sensor._raw_accel_data[:2],
        celsius=celsius,
    ),
    Judge("mma8451", "adafruit_mma8451", by_adafruit("MMA8451"), halved(4096.0, ACCELEROMETER[:3])),
    # It takes the part's 12 bits for 14.
    Judge("msa311", "adafruit_msa3xx", by_adafruit("MSA311"), halved(1024.0)),
    # 3.9 µg a digit.
    Judge(
        "adxl355",
        "adxl355",
        adxl355,
        halved(1 / 3.9e-6, ACCELEROMETER[:3]),
        1.0,
        "si",
        2e-3,
        values=lambda sensor: [getattr(sensor.read_acceleration_g(), axis) for axis in "xyz"],
        celsius=lambda sensor: sensor.read_temperature_c(),
    ),
    Judge("sca3300-d01", "sca3300", sca3300, {"3g": 2700.0, "6g": 1350.0, "1.5g": 5400.0}, letters="s"),
)


@pytest.mark.parametrize(
    ("judge", "letter", "word"),
    [
        pytest.param(judge, letter, word, id=f"{judge.model} {letter} {word} {judge.module}")
        for judge in JUDGES
        for letter in judge.letters
        for word in judge.counts
    ],
)
def test_it_reads_the_truth(judge: Judge, letter: str, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    board = Board(judge.model, f"range={word}", letter)
    board.install(monkeypatch)
    counts = judge.counts[word] / (judge.unit or 1.0)
    with foreign(judge.module) as module:
        sensor = judge.open(module, board, word)
        # Before our driver has set the part up and after it.
        for ours in (None, board.model.driver(board.part, board.clock)):
            if ours:
                reading = ours.read()
            read = [value * counts for value in judge.values(sensor)]
            assert read == pytest.approx(board.counts(), abs=0.51 + judge.digit * counts / 2)
            if (celsius := judge.celsius(sensor)) is not None:
                assert celsius == pytest.approx(board.celsius, abs=0.51 * board.model.thermometer_step + 0.001)
    assert list(reading.values) == pytest.approx(read, abs=0.51 + judge.digit * counts / 2)
    if judge.unit:
        assert judge.counts[word] == pytest.approx(board.model.sensitivity, rel=judge.near)


class SetUp(NamedTuple):
    """What our driver sets up, as a driver by another hand has it.

    name: where its names of registers are, and how they begin.
    registers: those that our driver writes, in order: - has no name there, = has the content that it leaves itself.
    rates: those of our driver, with the codes or their names; and what it reads back.
    change: what our driver has to notice.
    """

    name: str
    registers: str
    rates: dict[float, Any]
    rate: Callable[[Any], float] = lambda sensor: sensor.data_rate
    also: Callable[[Any, Any], bool] = lambda module, sensor: True
    change: Callable[[Any], None] = lambda sensor: None


def changed(name: str, value: int) -> Callable[[Any], None]:
    return lambda sensor: setattr(sensor, name, value)


def rates(name: str, words: str) -> dict[float, Any]:
    """By the number in a name."""
    return {float(word.replace("_", ".")): name.format(word) for word in words.split()}


def accelerometer_data_rate(sensor: Any) -> float:
    return float(sensor.accelerometer_data_rate)


LSM_RATES = rates("adafruit_lsm6ds:Rate.RATE_{}_HZ", "12_5 26 52 104 208 416 833")
LSM_SET_UP = SetUp(
    "adafruit_lsm6ds _LSM6DS_",
    "CTRL3_C CTRL3_C CTRL1_XL",
    LSM_RATES,
    accelerometer_data_rate,
    lambda module, sensor: sensor._bdu,
    changed("accelerometer_data_rate", 1),
)
SET_UP = {
    "adafruit_adxl34x": SetUp(
        "adafruit_adxl34x _REG_",
        "POWER_CTL= OFSX OFSY OFSZ INT_ENABLE= FIFO_CTL BW_RATE DATA_FORMAT= POWER_CTL=",
        rates("adafruit_adxl34x:DataRate.RATE_{}_HZ", "3200 1600 800 400 200 100 50 25 12_5")
        | {6.25: "adafruit_adxl34x:DataRate.RATE_6_25HZ"},
        change=lambda sensor: sensor._write_register_byte(resolve_name("adafruit_adxl34x:_REG_POWER_CTL"), 0),
    ),
    "adafruit_lis3dh": SetUp(
        "adafruit_lis3dh _REG_",
        "- CTRL5 CTRL4= CTRL1",
        rates("adafruit_lis3dh:DATARATE_{}_HZ", "1 10 25 50 100 200 400 1344"),
        change=changed("data_rate", 1),
    ),
    "adafruit_mpu6050": SetUp(
        "adafruit_mpu6050 _MPU6050_",
        "PWR_MGMT_1= PWR_MGMT_1= SMPLRT_DIV CONFIG ACCEL_CONFIG=",
        {1000.0 / (1 + divisor): divisor for divisor in (0, 1, 3, 4, 7, 9, 19, 39, 49, 99, 199, 249)},
        lambda sensor: sensor.sample_rate_divisor,
        lambda module, sensor: sensor.filter_bandwidth == module.Bandwidth.BAND_44_HZ,
        changed("sleep", 1),
    ),
    "adafruit_icm20x": SetUp(
        "adafruit_icm20x _ICM20X_",
        "REG_BANK_SEL= PWR_MGMT_1= PWR_MGMT_1= REG_BANK_SEL= ACCEL_SMPLRT_DIV_2 ACCEL_CONFIG_1 REG_BANK_SEL=",
        {rate: rate for rate in (1125.0, 562.5, 225.0, 112.5, 45.0, 22.5, 9.0, 4.5)},
        accelerometer_data_rate,
        lambda module, sensor: sensor.accel_dlpf_cutoff == module.AccelDLPFFreq.FREQ_50_4HZ_3DB,
        changed("_sleep", 1),
    ),
    "FaBo9Axis_MPU9250.MPU9250": SetUp(
        "FaBo9Axis_MPU9250.MPU9250",
        "PWR_MGMT_1= PWR_MGMT_1= SMPLRT_DIV CONFIG= ACCEL_CONFIG= ACCEL_CONFIG_2=",
        {100.0: None},
        lambda sensor: None,
    ),
    "bmi160": SetUp(
        "bmi160 _",
        "COMMAND COMMAND ACCEL_CONFIG ACC_RANGE=",
        rates("bmi160:BANDWIDTH_{}", "25 50 100 200 400 800 1600") | {12.5: "bmi160:BANDWIDTH_25_2"},
        lambda sensor: sensor._acc_odr,
        change=changed("_acc_odr", 6),
    ),
    **{f"adafruit_lsm6ds.{name}": LSM_SET_UP for name in ("lsm6ds33", "lsm6ds3trc", "lsm6dsox")},
    "adafruit_lsm6ds.ism330dhcx": LSM_SET_UP._replace(
        registers="CTRL3_C CTRL9_XL CTRL3_C= CTRL1_XL", change=lambda sensor: None
    ),
    "adafruit_mma8451": SetUp(
        "adafruit_mma8451 _MMA8451_REG_",
        "CTRL_REG1 - - - - XYZ_DATA_CFG= CTRL_REG2= CTRL_REG1",
        rates("adafruit_mma8451:DATARATE_{}HZ", "800 400 200 100 50 12_5 6_25")
        | {1.5625: "adafruit_mma8451:DATARATE_1_56HZ"},
        change=changed("data_rate", 0),
    ),
    "adafruit_msa3xx": SetUp(
        "adafruit_msa3xx _REG_",
        "- POWERMODE ODR RESRANGE=",
        rates("adafruit_msa3xx:DataRate.RATE_{}_HZ", "3_9 7_81 15_63 31_25 62_5 125 250 500 1000"),
        change=changed("power_mode", 2),
    ),
    "adxl355": SetUp(
        "adxl355:Register",
        "RESET FILTER RANGE= POWER_CTL=",
        rates("adxl355:ODR.HZ_{}", "4000 2000 1000 500 250 125 62_5 31_25 15_625 7_813 3_906"),
        lambda sensor: sensor._read_reg(0x28),
        change=lambda sensor: sensor.set_power_mode(1),
    ),
}


@pytest.mark.parametrize(
    "judge",
    [
        pytest.param(one, id=f"{one.model} {one.module}")
        for one in JUDGES
        if one.module in SET_UP and "i" in one.letters
    ],
)
def test_it_finds_what_our_driver_has_set_up(judge: Judge, monkeypatch: pytest.MonkeyPatch) -> None:
    set_up = SET_UP[judge.module]
    for rate, code in set_up.rates.items():
        # Some of them are too fast for I2C.
        board = Board(judge.model, f"rate={rate}")
        board.install(monkeypatch)
        with foreign(judge.module) as theirs:
            sensor = judge.open(theirs, board, next(iter(judge.counts)))
            left, (holder, _, prefix) = dict(board.part._held), set_up.name.partition(" ")
            known = [*vars(resolve_name(holder)).items()]
            line = Line(board.part, board.clock)
            ours = board.model.driver(line, board.clock)
            ours.read()
            written = [out[0] for out, _, _ in line.sent if len(out) == 2]
            for register, name in zip(written, set_up.registers.split(), strict=True):
                found = [one.removeprefix(prefix) for one, at in known if at == register and one.startswith(prefix)]
                assert name.rstrip("=") in (found or ["-"]), name
                assert not name.endswith("=") or board.part._held.get(register) == left.get(register), name
            assert set_up.rate(sensor) == (resolve_name(code) if isinstance(code, str) else code), rate
            assert set_up.also(theirs, sensor)
            kept = dict(board.part._held)
            set_up.change(sensor)
            if board.part._held != kept:
                with pytest.raises(DeviceFault, match="was reset or its supply failed"):
                    ours.read()
        assert board.part._part.sampling.rate == pytest.approx(rate, rel=1e-4)


def test_every_frame_of_an_scl3300_has_the_checksum_of_another_hand() -> None:
    with foreign("crccheck.crc") as theirs:
        for frame in (*scl3300.MODES, *(value for value in vars(scl3300).values() if isinstance(value, bytes))):
            assert theirs.Crc8SaeJ1850.calc(frame[:3]) == frame[3], frame.hex()


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
