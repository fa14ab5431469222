"""The accelerometers of hobby boards and robots: a row each, with the source of its numbers.

A count is the digit of the data sheet, right-justified. None of these rows polls for a new sample: boards and their
clones differ in that. A virtual part has limits and noise of the data sheet where one is quoted, else ours.

ADXL345: Analog Devices, Rev. D; Linux ``adxl345_core.c``. MPU6050: InvenSense PS-MPU-6000A 3.4, RM-MPU-6000A 4.2.
MPU6500, MPU9250: PS-MPU-9250A 1.0; Linux ``inv_mpu_iio.h`` (identities, thermometer). ICM20948: DS-000189 1.3. LIS3DH:
ST DocID17530 Rev 2; Linux ``st_accel_core.c``. LSM6DS3, LSM6DSOX: ST DocID026899 Rev 8, DS12140 (LSM6DSO); Linux
``st_lsm6dsx_core.c``. MMA8451: NXP MMA8451Q Rev. 10.3. BMI160: Bosch BST-BMI160-DS000-07; Linux ``bmi160_core.c``.
MSA311: Linux ``msa311.c``, whose author quotes the data sheet. Thermometer of the LSM6DS3 family: public drivers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from tiltcal.drivers.bus import SpiPort
from tiltcal.drivers.register_facts import (
    I2C,
    SPI,
    Field,
    Frame,
    Range,
    Sampling,
    StartUp,
    Thermometer,
    VirtualFacts,
    Write,
)
from tiltcal.drivers.registers import RegisterPart, RegisterSensor
from tiltcal.drivers.virtual import Tolerances

COUNTING_ON = {"i": 0x80, "s": 0x40}  # the bit of the first byte that makes a burst count on, of parts that need one
MPU = {b"\x68": "mpu6050", b"\x70": "mpu6500", b"\x71": "mpu9250", b"\x73": "mpu9250"}
LSM6DS = {b"\x69": "lsm6ds3", b"\x6a": "lsm6ds3tr-c", b"\x6c": "lsm6dsox"}
"""What says which identity: boards are sold by one name with one of the others."""


def _axes(first: int, bits: int = 16, order: Literal["big", "little"] = "little") -> dict[str, Field]:
    """Return x, y and z in two registers each, left-justified."""
    return {axis: Field(first + 2 * n, bits, shift=16 - bits, order=order) for n, axis in enumerate("xyz")}


def _ranges(counts_per_g: float, codes: Sequence[int] = (0, 1, 2, 3)) -> dict[str, Range]:
    """Return ±2, ±4, ±8, ±16 g, each with half the sensitivity of the one before."""
    return {f"{2 << n}g": Range(code, counts_per_g / 2**n) for n, code in enumerate(codes)}


ADXL345 = RegisterPart(
    name="adxl345",
    title="Analog Devices ADXL345 (GY-291) three-axis accelerometer, ±2 to ±16 g, I2C or SPI",
    short="ADXL345",
    # At full resolution a digit is 3.9 mg at each range, and the sign is extended to 16 bits.
    channels=_axes(0x32),
    bursts=((0x32, 6),),
    sampling=Sampling(
        ranges={f"{2 << code}g": Range(code, 256.0, (-(512 << code), (512 << code) - 1)) for code in range(4)},
        rates={3200 * 0.5**n: 15 - n for n in range(10)},
        rate=100.0,
    ),
    addresses=(f"{I2C}0x53", SPI),
    frame=Frame(several={"s": 0x40}, spi=SpiPort((3,), fastest=5_000_000, speed=1_000_000)),
    start_up=StartUp(
        identity=(0x00, (b"\xe5",)),
        # In standby: no user offsets, no interrupts, no FIFO; rate, range; then it measures. It has no reset.
        set_up=(
            tuple(Write(register, 0x00, kept=False) for register in (0x2D, 0x1E, 0x1F, 0x20, 0x2E, 0x38)),
            (Write(0x2C, 0x00, rate=1, kept=False), Write(0x31, 0x08, range=1)),
            (Write(0x2D, 0x08),),
        ),
        settling=4,
        watched=0x2D,
    ),
    virtual=VirtualFacts(asleep=(0x2D, 0x08, 0x00), limits=Tolerances(offset=0.15, sensitivity=0.1)),
)

MPU6050 = RegisterPart(
    name="mpu6050",
    title="InvenSense MPU-6050 (GY-521), its accelerometer, ±2 to ±16 g, I2C",
    short="MPU6050",
    channels=_axes(0x3B, order="big"),
    bursts=((0x3B, 8),),
    thermometer=Thermometer(Field(0x41, 16), zero=0, slope=340.0, reference=36.53),
    sampling=Sampling(
        ranges=_ranges(16384.0),
        rates={1000 / n: n - 1 for n in (1, 2, 4, 5, 8, 10, 20, 40, 50, 100, 200, 250)},
        rate=100.0,
    ),
    addresses=(f"{I2C}0x68",),
    start_up=StartUp(
        identity=(0x75, (b"\x68",)),
        family=MPU,
        reset=Write(0x6B, 0x80, seconds=0.1),
        # Awake, with the clock of the gyroscope; rate; 44 Hz filter; range.
        set_up=(
            (Write(0x6B, 0x01, seconds=0.03), Write(0x19, 0x00, rate=1, kept=False), Write(0x1A, 0x03, kept=False)),
            (Write(0x1C, 0x00, range=0x08),),
        ),
        settling=4,
        watched=0x6B,
    ),
    virtual=VirtualFacts(
        held={0x6B: 0x40},
        asleep=(0x6B, 0x40, 0x40),
        limits=Tolerances(offset=0.08, sensitivity=0.03, cross=0.02, drift=0.9e-3, gain=2e-4, thermometer=3.0),
        noise_density=400e-6,
        corner=0.44,
        nonlinearity=0.005,
    ),
)

MPU6500 = replace(
    MPU6050,
    name="mpu6500",
    title="InvenSense MPU-6500, its accelerometer, ±2 to ±16 g, I2C",
    short="MPU6500",
    thermometer=Thermometer(Field(0x41, 16), zero=0, slope=333.87, reference=21.0),
    start_up=replace(
        MPU6050.start_up,
        identity=(0x75, (b"\x70",)),
        # The filter of the accelerometer has a register of its own, which a reset clears; PWR_MGMT_1 is then as set up.
        set_up=(*MPU6050.start_up.set_up, (Write(0x1D, 0x03),)),
        watched=0x1D,
    ),
    virtual=replace(
        MPU6050.virtual,
        held={0x6B: 0x01},
        limits=Tolerances(offset=0.08, sensitivity=0.03, cross=0.02, drift=1.5e-3, gain=2.6e-4, thermometer=3.0),
        noise_density=300e-6,
    ),
)

MPU9250 = replace(
    MPU6500,
    name="mpu9250",
    title="InvenSense MPU-9250 or MPU-9255, its accelerometer, ±2 to ±16 g, I2C",
    short="MPU9250",
    start_up=replace(MPU6500.start_up, identity=(0x75, (b"\x71", b"\x73"))),
)


def in_first_bank(sensor: RegisterSensor) -> None:
    """Begin with an ICM20948 that another program may have left in another bank of registers."""
    sensor.write(Write(0x7F, 0x00))
    sensor.begin()


ICM20948 = replace(
    MPU6500,
    name="icm20948",
    title="TDK InvenSense ICM-20948, its accelerometer, ±2 to ±16 g, I2C",
    short="ICM20948",
    channels=_axes(0x2D, order="big"),
    bursts=((0x2D, 6), (0x39, 2)),
    thermometer=Thermometer(Field(0x39, 16), zero=0, slope=333.87, reference=21.0),
    sampling=replace(MPU6500.sampling, rates={1125 / n: n - 1 for n in (1, 2, 5, 10, 25, 50, 125, 250)}, rate=112.5),
    start_up=replace(
        MPU6500.start_up,
        identity=(0x00, (b"\xea",)),
        family={},
        begin=in_first_bank,
        reset=Write(0x06, 0x80, seconds=0.1),
        # Awake; in bank 2 rate, range and 50 Hz filter; back in bank 0.
        set_up=(
            (Write(0x06, 0x01, seconds=0.03),),
            (Write(0x7F, 0x20, kept=False), Write(0x11, 0x00, rate=1, kept=False), Write(0x14, 0x19, range=0x02)),
            (Write(0x7F, 0x00, kept=False),),
        ),
        watched=0x06,
    ),
    virtual=replace(
        MPU6500.virtual,
        held={0x06: 0x41},
        asleep=(0x06, 0x40, 0x40),
        bank=0x7F,
        limits=Tolerances(offset=0.05, sensitivity=0.005, cross=0.02, drift=0.8e-3, gain=2.6e-4, thermometer=3.0),
        noise_density=230e-6,
    ),
)

LIS3DH = RegisterPart(
    name="lis3dh",
    title="ST LIS3DH three-axis accelerometer, ±2 to ±16 g, I2C or SPI",
    short="LIS3DH",
    channels=_axes(0x28, bits=12),
    bursts=((0x28, 6),),
    sampling=Sampling(
        # A digit is 1, 2, 4 and 12 mg.
        ranges={**_ranges(1000.0, (0, 1, 2)), "16g": Range(3, 1000 / 12)},
        rates={1.0: 1, 10.0: 2, 25.0: 3, 50.0: 4, 100.0: 5, 200.0: 6, 400.0: 7, 1344.0: 9},
        rate=100.0,
    ),
    addresses=(f"{I2C}0x18", SPI),
    frame=Frame(several=COUNTING_ON, spi=SpiPort((3, 0), fastest=10_000_000, speed=1_000_000)),
    start_up=StartUp(
        identity=(0x0F, (b"\x33",)),
        # No high-pass filter, no FIFO; whole samples at high resolution; rate and axes. It has no reset.
        set_up=(
            (Write(0x21, 0x00, kept=False), Write(0x24, 0x00, kept=False)),
            (Write(0x23, 0x88, range=0x10), Write(0x20, 0x07, rate=0x10)),
        ),
        # At high resolution it needs seven sample periods to turn on.
        settling=8,
        watched=0x20,
    ),
    virtual=VirtualFacts(held={0x20: 0x07}, asleep=(0x20, 0xF0, 0x00)),
)


def _lsm6ds(name: str, title: str, identity: int, counts_per_degree: float) -> RegisterPart:
    """Return a part of the family, which differ in identity and thermometer."""
    return RegisterPart(
        name=name,
        title=f"ST {title}, its accelerometer, ±2 to ±16 g, I2C or SPI",
        short=name.upper(),
        channels=_axes(0x28),
        bursts=((0x28, 6), (0x20, 2)),
        thermometer=Thermometer(Field(0x20, 16, order="little"), zero=0, slope=counts_per_degree),
        sampling=Sampling(
            # A digit is 0.061, 0.122, 0.244 and 0.488 mg.
            ranges=_ranges(1000 / 0.061, (0, 2, 3, 1)),
            rates={12.5: 1, 26.0: 2, 52.0: 3, 104.0: 4, 208.0: 5, 416.0: 6, 833.0: 7},
            rate=104.0,
        ),
        addresses=(f"{I2C}0x6a", SPI),
        frame=Frame(spi=SpiPort((3, 0), fastest=10_000_000, speed=1_000_000)),
        start_up=StartUp(
            identity=(0x0F, (bytes([identity]),)),
            family=LSM6DS,
            reset=Write(0x12, 0x01, seconds=0.05),
            # Whole samples, counting up; rate and range.
            set_up=((Write(0x12, 0x44, kept=False), Write(0x10, 0x00, rate=0x10, range=0x04)),),
            settling=6,
            watched=0x10,
        ),
        virtual=VirtualFacts(asleep=(0x10, 0xF0, 0x00)),
    )


MMA8451 = RegisterPart(
    name="mma8451",
    title="NXP MMA8451Q (GY-45) three-axis accelerometer, ±2, ±4 or ±8 g, I2C",
    short="MMA8451",
    channels=_axes(0x01, bits=14, order="big"),
    bursts=((0x01, 6),),
    sampling=Sampling(
        ranges=_ranges(4096.0, (0, 1, 2)),
        rates={800.0: 0, 400.0: 1, 200.0: 2, 100.0: 3, 50.0: 4, 12.5: 5, 6.25: 6, 1.5625: 7},
        rate=100.0,
    ),
    addresses=(f"{I2C}0x1d",),
    start_up=StartUp(
        identity=(0x0D, (b"\x1a",)),
        # In standby: no FIFO, no user offsets; range, without high-pass filter; high resolution; then rate and active.
        set_up=(
            tuple(Write(register, 0x00, kept=False) for register in (0x2A, 0x09, 0x2F, 0x30, 0x31)),
            (Write(0x0E, 0x00, range=1), Write(0x2B, 0x02, kept=False)),
            (Write(0x2A, 0x01, rate=0x08),),
        ),
        settling=4,
        watched=0x2A,
    ),
    virtual=VirtualFacts(held={0x00: 0x0F}, asleep=(0x2A, 0x01, 0x00), reset=Write(0x2B, 0x40), noise_density=99e-6),
)

BMI160 = RegisterPart(
    name="bmi160",
    title="Bosch BMI160, its accelerometer, ±2 to ±16 g, I2C",
    short="BMI160",
    channels=_axes(0x12),
    bursts=((0x12, 6), (0x20, 2)),
    thermometer=Thermometer(Field(0x20, 16, order="little"), zero=0, slope=512.0, reference=23.0),
    sampling=Sampling(
        ranges=_ranges(16384.0, (3, 5, 8, 12)),
        rates={12.5: 5, 25.0: 6, 50.0: 7, 100.0: 8, 200.0: 9, 400.0: 10, 800.0: 11, 1600.0: 12},
        rate=100.0,
    ),
    addresses=(f"{I2C}0x68",),
    start_up=StartUp(
        identity=(0x00, (b"\xd1",)),
        reset=Write(0x7E, 0xB6, seconds=0.1),
        # Normal mode, which takes 3.8 ms; rate with the narrowest filter, which a reset widens; range.
        set_up=(
            (Write(0x7E, 0x11, seconds=0.005, kept=False),),
            (Write(0x40, 0x00, rate=1, seconds=0.001), Write(0x41, 0x00, range=1, seconds=0.001)),
        ),
        settling=8,
        watched=0x40,
    ),
    # Hosts wait until PMU_STATUS says that accelerometer and gyroscope are on.
    virtual=VirtualFacts(held={0x03: 0x14, 0x40: 0x28, 0x41: 0x03}, noise_counts=30.0),
)

MSA311 = RegisterPart(
    name="msa311",
    title="MEMSensing MSA311 three-axis accelerometer, ±2 to ±16 g, I2C",
    short="MSA311",
    channels=_axes(0x02, bits=12),
    bursts=((0x02, 6),),
    sampling=Sampling(
        ranges=_ranges(1024.0),
        rates={3.9: 2, 7.81: 3, 15.63: 4, 31.25: 5, 62.5: 6, 125.0: 7, 250.0: 8, 500.0: 9, 1000.0: 10},
        rate=125.0,
    ),
    addresses=(f"{I2C}0x62",),
    start_up=StartUp(
        identity=(0x01, (b"\x13",)),
        reset=Write(0x00, 0x24, seconds=0.02),
        # Normal mode; all axes and rate; range.
        set_up=((Write(0x11, 0x00), Write(0x10, 0x00, rate=1, kept=False), Write(0x0F, 0x00, range=1)),),
        settling=4,
        watched=0x11,
    ),
    virtual=VirtualFacts(held={0x11: 0xC0}, asleep=(0x11, 0x80, 0x80)),
)

MODELS = {
    part.name: part.model()
    for part in (
        ADXL345,
        MPU6050,
        MPU6500,
        MPU9250,
        ICM20948,
        LIS3DH,
        _lsm6ds("lsm6ds3", "LSM6DS3", 0x69, 16.0),
        _lsm6ds("lsm6ds3tr-c", "LSM6DS3TR-C", 0x6A, 256.0),
        _lsm6ds("lsm6dsox", "LSM6DSOX", 0x6C, 256.0),
        MMA8451,
        BMI160,
        MSA311,
    )
}
