"""TI ADS1115 analog-to-digital converter: four inputs, 16 bits, I2C.

Two registers are used, of two bytes each, most significant first, and a pointer that is written first::

    conversion 0x00   the last result, a signed number; 32768 steps are the full scale
    config     0x01   15 OS, 14:12 input, 11:9 full scale, 8 single shot, 7:5 rate, 4:0 comparator (00011: off)

Writing OS as 1 starts a conversion; OS reads 0 until it is done.

Source: ADS111x data sheet; the fields' values as in Linux's drivers/iio/adc/ti-ads1015.c.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.converter import FrontEnd
from tiltcal.drivers.device import from_twin
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

CONVERSION, CONFIG = 0x00, 0x01
"""Registers."""

START = DONE = 0x8000
"""OS: writing it starts a conversion; reading it shows that none is running."""

RESET = 0x8583
"""Content of the config register after power-up."""

INPUTS = 4

RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
"""Full scales, V, by their code. An input may never exceed the converter's own supply, whatever the full scale."""

RATES = (8, 16, 32, 64, 128, 250, 475, 860)
"""Conversions per second, by their code."""

ADDRESSES = (0x48, 0x49, 0x4A, 0x4B)
"""Bus addresses, by what ADDR is tied to: GND, VDD, SDA, SCL."""

_SINGLE_ENDED, _SINGLE_SHOT, _COMPARATOR_OFF = 0b100, 0x0100, 0b00011


class Ads1115:
    """The driver of an ADS1115, with one single-shot conversion per input.

    Parameters
    ----------
    full_scale : float
        One of :data:`RANGES`, V.
    rate : int
        One of :data:`RATES`, conversions per second.
    """

    TOLERANCE = 0.1
    """The converter's clock may be this much slower than nominal."""
    POLLS = 20
    """Polls of a conversion, a tenth of its duration apart, before it counts as failed."""

    def __init__(self, link: Link, clock: Clock, full_scale: float = 6.144, rate: int = 128) -> None:
        self._link = link
        self._clock = clock
        self._full_scale = full_scale
        self._rate = rate

    def volts(self, number: int) -> float:
        """Convert one input against ground, V.

        BusError: the transaction failed, the bus is stuck, or the conversion does not end.
        DeviceFault: the converter lost its settings, or the input is beyond the full scale.
        """
        config = config_word(number, self._full_scale, self._rate)
        self._link.exchange(bytes([CONFIG]) + config.to_bytes(2, "big"))
        self._clock.sleep((1.0 + self.TOLERANCE) / self._rate)
        self._wait_until_done(config)
        code = decode_code(self._register(CONVERSION))
        if code in (-0x8000, 0x7FFF):
            raise DeviceFault(
                f"input {number} is at or beyond ±{self._full_scale:g} V, the full scale of the ADS1115: "
                f"{self._advice()}, and check the wiring"
            )
        return code * self._full_scale / 32768

    def _wait_until_done(self, config: int) -> None:
        """Wait until the conversion of this config is done."""
        for _ in range(self.POLLS):
            held = int.from_bytes(self._register(CONFIG), "big")
            _check_held(held, config)
            if held & DONE:
                return
            self._clock.sleep(0.1 / self._rate)
        raise BusError(
            f"the ADS1115 is still busy after {(1.0 + self.TOLERANCE + 0.1 * self.POLLS) / self._rate * 1e3:.3g} ms "
            f"with a conversion that takes {1e3 / self._rate:.3g} ms: switch its supply off and on"
        )

    def _register(self, pointer: int) -> bytes:
        answer = self._link.exchange(bytes([pointer]), 2)
        if len(answer) != 2:
            raise BusError(f"2 bytes were asked for and {len(answer)} came: the I2C adapter is at fault")
        return answer

    def _advice(self) -> str:
        larger = [full_scale for full_scale in RANGES if full_scale > self._full_scale]
        return f"take a larger one (range={min(larger):g})" if larger else "its inputs may not exceed its supply"


def config_word(number: int, full_scale: float, rate: int) -> int:
    """Return the config register that starts one single-shot conversion of an input, 0 to 3, against ground."""
    return (
        START
        | (_SINGLE_ENDED | number) << 12
        | RANGES.index(full_scale) << 9
        | _SINGLE_SHOT
        | RATES.index(rate) << 5
        | _COMPARATOR_OFF
    )


def decode_code(answer: bytes) -> int:
    """Return the content of the conversion register, -32768 to 32767."""
    return int.from_bytes(answer, "big", signed=True)


def _check_held(held: int, config: int) -> None:
    """Raise an error for a dead bus, a converter that was reset, or another device."""
    if held in (0x0000, 0xFFFF):
        level = "low" if held == 0 else "high"
        raise BusError(f"the I2C data line is stuck {level}: check SDA, its pull-up, and the ADS1115's supply")
    if held & ~DONE == RESET & ~DONE != config & ~DONE:
        raise DeviceFault("the ADS1115 lost its settings, so its supply failed for a moment: check its supply")
    if held & ~DONE != config & ~DONE:
        raise DeviceFault(
            f"the config register reads {held:04X} where {config:04X} was written: does another program use this "
            "converter, or is another device at this address?"
        )


def front_end(address: Address) -> FrontEnd:
    """Return the ADS1115 with the ``range=`` (V) and ``rate=`` (conversions per second) of an address.

    UsageError: a bus address, full scale or rate that it does not have.
    """
    if "address" in address.options and not address.simulated and address.integer("address") not in ADDRESSES:
        address.refuse(
            f"an ADS1115 is at {_listed([hex(known) for known in ADDRESSES])}, not at {address.text('address')}"
        )
    full_scale, rate = address.number("range", RANGES[0]), address.integer("rate", 128)
    if full_scale not in RANGES:
        address.refuse(f"option range={address.text('range')} is not a full scale of an ADS1115 ({_listed(RANGES)} V)")
    if rate not in RATES:
        address.refuse(f"option rate={address.text('rate')} is not a rate of an ADS1115 ({_listed(RATES)} per second)")
    return FrontEnd(
        name="ads1115",
        description=f"ADS1115, ±{full_scale:g} V, {rate} conversions per second",
        inputs=INPUTS,
        full_scale=full_scale,
        step=full_scale / 32768,
        reference=None,
        options=("range", "rate"),
        spi=None,
        driver=partial(Ads1115, full_scale=full_scale, rate=rate),
        twin=from_twin("ads1115", "Ads1115Twin"),
    )


def _listed(choices: tuple[float, ...] | list[str]) -> str:
    *first, last = (str(choice) for choice in choices)
    return f"{', '.join(first)} or {last}"
