"""Murata SCL3300-D01 inclinometer and SCA3300-D01 accelerometer, three axes on SPI: one protocol, and a virtual part.

A frame has 32 bits, most significant first. The answer to a frame arrives with the NEXT frame; it echoes the operation
that it answers, and its return status says whether its data are good::

    bit  31     30-26    25-24          23-8    7-0
         write  address  return status  data    CRC-8 of the 24 bits above: x⁸+x⁴+x³+x²+1, start 0xFF, inverted

Only the frames below are ever sent; other values of the command register belong to the factory. The driver reads
acceleration, not the SCL3300's angles: those are computed inside the part from axes that are not calibrated, so offset
and cross-axis sensitivity can no longer be taken out of them.

Source: SCA3300-D01 data sheet, Murata doc. 3165 Rev. 3. Of the SCL3300-D01 (doc. 4921) what drivers that quote it and a
captured start-up agree on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import NamedTuple

from tiltcal.drivers.bus import Link, SpiPort, check_data_line, require_length
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.model import (
    Model,
    Reading,
    Sensor,
    deviation_within,
    in_words,
    link_in_words,
    typical_nonlinearity,
)
from tiltcal.drivers.virtual import HeldPose, Tolerances, Truth, VirtualPart, uniform
from tiltcal.errors import Argument, BusError, DeviceFault

ACC_X, ACC_Y, ACC_Z = (bytes.fromhex(frame) for frame in ("040000F7", "080000FD", "0C0000FB"))
TEMPERATURE, STATUS, WHOAMI = (bytes.fromhex(frame) for frame in ("140000EF", "180000E5", "40000091"))
SERIAL1, SERIAL2 = bytes.fromhex("640000A7"), bytes.fromhex("680000AD")
BANK_0, BANK_1 = bytes.fromhex("FC000073"), bytes.fromhex("FC00016E")
RESET = bytes.fromhex("B4002098")
MODES = tuple(bytes.fromhex(frame) for frame in ("B400001F", "B4000102", "B4000225", "B4000338"))
"""Set Murata's mode 1, 2, 3, 4."""
MODE = bytes.fromhex("340000DF")  # read the mode
WAKE_UP = MODES[0]  # the only frame that a part in power-down takes
SAMPLE = (ACC_X, ACC_Y, ACC_Z, TEMPERATURE)
NORMAL, ERROR = 0b01, 0b11  # return status; 0b00 is a part that starts up, 0b10 is reserved
FLAGS = {
    0x200: "digital block (DIGI1)",
    0x100: "digital block (DIGI2)",
    0x080: "clock (CLK)",
    0x040: "signal path saturated (SAT)",
    0x020: "temperature path saturated (TEMP_SAT)",
    0x010: "supply (PWR)",
    0x008: "memory (MEM)",
    0x004: "power-down (PD)",
    0x002: "mode change (MODE_CHANGE)",
    0x001: "internal connection (PIN_CONTINUITY)",
}
"""Bits of STATUS in words."""

SATURATED = 0x040 | 0x020
RESTARTED = 0x010 | 0x004 | 0x002
"""Flags of a part that was reset, switched off or put into another mode since it was set up."""


GAP = 10e-6  # seconds of chip select high before a frame; with less the data are corrupt
RESET_SECONDS = 3e-3  # seconds after a software reset
ATTEMPTS = 12  # unusable samples in a row before an error. If one frame in fifty is damaged, so is one sample in ten.


class Answer(NamedTuple):
    """One decoded answer frame: write and address of its request, return status, 16 bits, and whether the CRC fits."""

    operation: int
    status: int
    data: int
    intact: bool

    @property
    def signed(self) -> int:
        """The data as two's complement."""
        return self.data - 0x10000 if self.data & 0x8000 else self.data

    def answers(self, request: bytes) -> bool:
        """Return whether it is intact and belongs to this request: it echoes the operation and the written data."""
        unlike = bool(request[0] & 0x80) and self.data != int.from_bytes(request[1:3], "big")
        return self.intact and self.operation == request[0] >> 2 and not unlike


def crc8(head: bytes) -> int:
    """Return the CRC-8 of the first three bytes of a frame."""
    crc = 0xFF
    for byte in head:
        crc = _shifted(crc ^ byte)
    return crc ^ 0xFF


@cache
def _shifted(crc: int) -> int:
    for _ in range(8):
        crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc


def decode(frame: bytes) -> Answer:
    """Decode an answer frame of four bytes."""
    return Answer(frame[0] >> 2, frame[0] & 0b11, frame[1] << 8 | frame[2], crc8(frame[:3]) == frame[3])


def flags_in_words(status: int) -> str:
    """Return the flags of a STATUS word as text."""
    return ", ".join(words for bit, words in FLAGS.items() if status & bit)


class MeasuringRange(NamedTuple):
    """One of the part's modes.

    word: of the option ``range``, beside ``mode1`` to ``mode4``.
    bandwidth, settling, noise: -3 dB of its first-order filter (Hz); after it was set (s); g.
    """

    mode: int
    word: str
    extent: str
    counts_per_g: float
    bandwidth: float
    settling: float
    noise: float

    def __str__(self) -> str:
        return f"{self.extent} (mode {self.mode}), {self.counts_per_g:.0f} count/g, {self.bandwidth:.0f} Hz"


class Scl3300Part(NamedTuple):
    """The constants of one part: what WHOAMI says, and its ranges, mode 1 first.

    sensitivity_limit: largest relative error of either sign.
    nonlinearity: typical square and cube of the response; empty where no source states them.
    """

    name: str
    kind: str
    identity: int
    ranges: tuple[MeasuringRange, ...]
    sensitivity_limit: float
    nonlinearity: tuple[float, ...] = ()


class Scl3300(Sensor):
    """The driver of an SCL3300-D01 or SCA3300-D01 in one of its modes.

    It sets the part up before the first sample and again after any error. A damaged frame is asked for again; a part
    that was reset in between is an error, since the frames before it may be of another mode.
    """

    def __init__(self, part: Scl3300Part, measuring: MeasuringRange, link: Link, clock: Clock) -> None:
        self._part = part
        self._range = measuring
        self._link = link
        self._clock = clock
        self._ready = False
        self._counts = {"samples": 0, "damaged": 0, "saturated": 0, "restarts": 0}

    def probe(self) -> Mapping[str, str]:
        """Set the part up; return what it is and a sample as text. The errors are those of :meth:`read`."""
        self._ready = False
        reading = self.read()
        said = {"part": self._part.name, "serial": self.serial_number(), "range": str(self._range)}
        return said | in_words(reading, trimmed=True) | {"link": link_in_words(self._counts)}

    def serial_number(self) -> str:
        """Return the serial number as it is printed on the part."""
        # The last answer is fetched with the first request again, so the part ends in bank 0: no other has a reset.
        _, _, low, high = self._answers_to((BANK_0, BANK_1, SERIAL1, SERIAL2))
        return f"{(high.data << 16 | low.data)}B33"

    def read(self) -> Reading:
        """Take one sample: x, y and z in counts, -32768 to 32767, and the temperature in °C."""
        x, y, z, temperature = self._answers_to(SAMPLE)
        self._counts["samples"] += 1
        return Reading((float(x.signed), float(y.signed), float(z.signed)), -273.0 + temperature.signed / 18.9)

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of samples, of those that were asked for again, and of restarts of the part."""
        return dict(self._counts)

    def _answers_to(self, requests: Sequence[bytes]) -> list[Answer]:
        """Return the answers to requests, which are repeated until all are good; after an error, set the part up first.

        DeviceFault: the part was reset, reports a fault, or is saturated.
        BusError: too many frames are damaged.
        """
        ready, self._ready = self._ready, False
        if not ready:
            self._set_up()
        saturated = False
        for _ in range(ATTEMPTS):
            # The answer to the frame that fetches the last one comes with the next sample.
            late, answers = self._ask(requests, requests[0])
            statuses = {answer.status for answer in (late, *answers) if answer.intact}
            if statuses <= {NORMAL} and all(map(Answer.answers, answers, requests)):
                self._ready = True
                return answers
            flags = self._flags() if ERROR in statuses else 0
            if not statuses <= {NORMAL, ERROR} or (flags or 0) & RESTARTED:
                self._counts["restarts"] += 1
                raise DeviceFault(
                    f"the {self._part.name} was reset or its supply failed since it was set up "
                    f"({flags_in_words(flags or 0) or 'it is starting up'}): check the supply and its wires; it is set "
                    "up anew"
                )
            if flags is None:
                self._set_up()
            elif flags & ~SATURATED:
                raise DeviceFault(
                    f"the {self._part.name} reports a fault: {flags_in_words(flags)}: it is reset; if the fault stays, "
                    "replace the part"
                )
            saturated |= bool(flags)
            self._counts["saturated" if flags else "damaged"] += 1
        if saturated:
            raise DeviceFault(
                "the part's signal path is saturated (SAT): it is shaken, or beyond its range; hold it still, or take "
                "a wider range="
            )
        raise BusError(
            f"{ATTEMPTS} samples in a row were damaged ({link_in_words(self._counts)}): try a slower clock (such as "
            "speed=500000), shorter wires, and a pull-up on chip select"
        )

    def _flags(self) -> int | None:
        """Return the flags of STATUS before this call; None where the line has damaged too much of them.

        Of three readings the first two find the flags of what is over, and all three those of a fault that stays. A
        request that was damaged on the way is answered with any data, so what two answers agree on counts.
        """
        _, answers = self._ask((STATUS, STATUS, STATUS), STATUS, checked=False)
        known = [answer.data for answer in answers if answer.answers(STATUS)]
        return next((flags for flags in known if known.count(flags) > 1), None)

    def _set_up(self) -> None:
        """Reset the part, set its mode, and check its identity; repeat this until the part measures."""
        standing = 0
        for attempt in range(ATTEMPTS):
            if attempt:
                # Another program may have left the part in bank 1, where nothing resets it, or in power-down.
                self._exchange(BANK_0)
                self._exchange(WAKE_UP)
                self._clock.sleep(RESET_SECONDS)
            flags = self._start(first=not attempt)
            if flags is None:
                return
            standing = flags or standing
        if standing:
            raise DeviceFault(
                f"the {self._part.name} reports a fault that its start does not clear: {flags_in_words(standing)}: "
                "switch its supply off and on; if it stays, replace the part"
            )
        raise BusError(
            f"the {self._part.name} could not be set up in {ATTEMPTS} attempts ({link_in_words(self._counts)}): try a "
            "slower clock (such as speed=500000), shorter wires, and check chip select and the supply"
        )

    def _start(self, *, first: bool) -> int | None:
        """Start the part once; return None where it measures, else the flags of its error, 0 where it shows none.

        The first start may fail in any way, because the part may be in bank 1 or in power-down.
        """
        mode = MODES[self._range.mode - 1]
        self._exchange(RESET)
        self._clock.sleep(RESET_SECONDS)
        # What answers the reset is not defined.
        self._exchange(mode)
        self._clock.sleep(self._range.settling)
        requests = (STATUS, STATUS, STATUS, WHOAMI)
        echo, answers = self._ask(requests, WHOAMI, checked=not first)
        _, second, third, whoami = answers
        if not echo.answers(mode) or not all(map(Answer.answers, answers, requests)):
            return 0
        right = whoami.data == self._part.identity
        if not first and whoami.status == NORMAL and not right:
            raise self._other_part(whoami.data)
        # Reading STATUS clears what the start has set: the second answer has to be free of errors.
        if right and second.status == third.status == whoami.status == NORMAL:
            return None
        return third.data if third.status == ERROR else 0

    def _ask(self, requests: Sequence[bytes], fetch: bytes, *, checked: bool = True) -> tuple[Answer, list[Answer]]:
        """Send requests and a frame that fetches the last answer; return the answer to the frame before, and theirs.

        ``checked`` refuses wires that are stuck or shorted.
        """
        first, *raw = [self._exchange(request) for request in (*requests, fetch)]
        if checked:
            check_data_line(b"".join(raw))
            # An answer is one frame late: what comes at once is the request itself.
            if raw[:-1] == list(requests[1:]):
                raise BusError("each frame comes back as it was sent: MISO is connected to MOSI")
        return decode(first), [decode(frame) for frame in raw]

    def _other_part(self, identity: int) -> DeviceFault:
        other = next((part.name for part in (_SCL3300, _SCA3300) if part.identity == identity), None)
        named = (f"an {other}: name it with ", Argument("sensor"))
        unknown = "no part that is known: is the wiring right?"
        said = f"WHOAMI reads 0x{identity:02X}, and an {self._part.name} answers 0x{self._part.identity:02X}"
        return DeviceFault(said, advice=("the part is ", *(named if other else (unknown,))))

    def _exchange(self, frame: bytes) -> bytes:
        self._clock.sleep(GAP)
        return require_length(self._link.exchange(frame), len(frame), "frame")


POWER, MODE_CHANGE, MEMORY = 0x10, 0x02, 0x08  # bits of STATUS
WORDS_PER_SECOND = 2000.0


class VirtualScl3300(VirtualPart):
    """A part on the SPI bus at 2 MHz, in its state after power-up.

    measuring: what the driver is going to set; the truth is in counts of this mode.
    """

    letter, bit_seconds = "s", 1.0 / 2_000_000

    def __init__(
        self, part: Scl3300Part, measuring: MeasuringRange, truth: Truth, fixture: HeldPose, clock: Clock
    ) -> None:
        super().__init__(truth, fixture, clock)
        self._part = part
        self._truth_range = measuring
        serial = int(uniform(truth.seed, "serial number", 0) * 2**32)
        self._identity = {(WHOAMI, 0): part.identity, (SERIAL1, 1): serial & 0xFFFF, (SERIAL2, 1): serial >> 16}
        self._reset()

    def _answered(self, out: bytes, count: int) -> bytes:
        """Answer the frame before this one."""
        if self._fault().kind == "parity":
            self._raise(MEMORY)
        answer = self._answer()[: len(out)]
        self._take(out)
        return answer

    def _reset(self) -> None:
        """Take the state after power-up: mode 1, bank 0, the flag of the supply set."""
        self._range = self._part.ranges[0]
        self._bank = 0
        self._standing = self._held = POWER
        # What a real part answers before its first valid answer; the data sheet leaves it undefined.
        self._answer: Callable[[], bytes] = lambda: bytes.fromhex("0300007D")

    def _raise(self, flag: int) -> None:
        self._standing |= flag
        self._held |= flag

    def _take(self, request: bytes) -> None:
        """Execute a request; its answer is made when the next frame fetches it."""
        operation = request[0] >> 2 if request else 0
        if len(request) != 4 or crc8(request[:3]) != request[3]:
            self._answer = partial(_frame, operation, ERROR, 0)
            return
        # The part decodes a read by its operation alone; hosts leave old bytes in the rest, with a CRC that fits.
        written, data = bool(operation & 0x20), int.from_bytes(request[1:3], "big")
        request = _frame(operation, 0, data if written else 0)
        if request == RESET and self._bank == 0:
            self._reset()
        elif written:
            if request in MODES and self._bank == 0:
                self._range = self._part.ranges[MODES.index(request)]
                self._raise(MODE_CHANGE)
            elif request in (BANK_0, BANK_1):
                self._bank = data
            self._answer = partial(_frame, operation, self._status(), data)
        elif request == STATUS:
            self._answer = partial(_frame, operation, self._status(), self._held)
            self._held, self._standing = self._standing, 0
        else:
            status, bank = self._status(), self._bank
            self._answer = lambda: _frame(operation, status, self._content(request, bank) & 0xFFFF)

    def _status(self) -> int:
        return ERROR if self._standing else NORMAL

    def _content(self, request: bytes, bank: int) -> int:
        """Return the register that a request asks a bank for."""
        if request == MODE:
            return self._range.mode - 1
        if request == TEMPERATURE:
            return round((self._celsius() + 273.0) * 18.9)
        if request in SAMPLE:
            scale = self._range.counts_per_g / self._truth_range.counts_per_g
            return self._word("xyz"[SAMPLE.index(request)], WORDS_PER_SECOND, -32768, 32767, scale)
        return self._identity.get((request, bank), 0)


def _frame(operation: int, status: int, data: int) -> bytes:
    head = bytes([operation << 2 | status, data >> 8, data & 0xFF])
    return head + bytes([crc8(head)])


_LIMITS = Tolerances(offset=0.020, sensitivity=0.007, drift=0.1e-3, gain=3e-5, thermometer=10.0)
"""Those of the SCA3300, which are used for the SCL3300 too."""

_SCL3300 = Scl3300Part(
    name="SCL3300-D01",
    kind="inclinometer",
    identity=0xC1,
    # The noise is 17 µg/√Hz over the filter's noise bandwidth.
    ranges=(
        MeasuringRange(1, "1.2g", "±1.2 g", 6000.0, 40.0, 25e-3, 135e-6),
        MeasuringRange(2, "2.4g", "±2.4 g", 3000.0, 70.0, 15e-3, 178e-6),
        MeasuringRange(3, "inclination", "inclination", 12000.0, 10.0, 100e-3, 80e-6),
        MeasuringRange(4, "low-noise", "inclination, low noise", 12000.0, 10.0, 100e-3, 80e-6),
    ),
    # Its own limits were not found: one that separates it from its sibling.
    sensitivity_limit=0.02,
)
_SCA3300 = Scl3300Part(
    name="SCA3300-D01",
    kind="accelerometer",
    identity=0x51,
    ranges=(
        MeasuringRange(1, "3g", "±3 g", 2700.0, 70.0, 15e-3, 0.5e-3),
        MeasuringRange(2, "6g", "±6 g", 1350.0, 70.0, 15e-3, 0.7e-3),
        MeasuringRange(3, "1.5g", "±1.5 g", 5400.0, 70.0, 15e-3, 0.4e-3),
        MeasuringRange(4, "1.5g-10hz", "±1.5 g, 10 Hz", 5400.0, 10.0, 100e-3, 0.15e-3),
    ),
    sensitivity_limit=0.007,
    nonlinearity=typical_nonlinearity(0.001, 1.0),
)


def _model(name: str, part: Scl3300Part, address: Address) -> Model:
    """Return the model in the mode of the address."""
    words = {one.word: one for one in part.ranges} | {f"mode{one.mode}": one for one in part.ranges}
    measuring = address.choice("range", words, part.ranges[0])
    noise = measuring.counts_per_g * measuring.noise
    return Model(
        name=name,
        title=f"Murata {part.name} three-axis {part.kind}, {measuring.extent}, SPI",
        channels=("x", "y", "z"),
        addresses=("spi:///dev/spidev0.0", f"spi:///dev/spidev0.0?range={part.ranges[-1].word}"),
        sensitivity=measuring.counts_per_g,
        offset_spread=deviation_within(_LIMITS.offset),
        sensitivity_spread=deviation_within(part.sensitivity_limit),
        nonlinearity=part.nonlinearity,
        rails=(-32768.0, 32767.0),
        resolution=1.0,
        # A first-order filter: after half a period of its corner frequency the noise has changed by 96 %.
        interval=0.5 / measuring.bandwidth,
        thermometer=True,
        thermometer_step=1.0 / 18.9,
        driver=partial(Scl3300, part, measuring),
        twin=partial(VirtualScl3300, part, measuring),
        not_modelled=(
            "what a real part sends after damaged requests and frames that are not 32 bits, which no source says",
            "saturation, self-test output (STO), angle outputs; the gain of one mode against another",
            *(("offset over temperature beyond a line",) if part is _SCA3300 else ("the limits of a real part",)),
        ),
        memory_fault=True,
        default_truth=partial(_LIMITS.draw, ("x", "y", "z"), measuring.counts_per_g, noise),
        spi=SpiPort(modes=(0,), fastest=8_000_000, speed=2_000_000, slowest=100_000),
        options=("range",),
        configure=partial(_model, name, part),
    )


MODELS = {
    name: _model(name, part, parse_address("sim:")) for name, part in (("scl3300", _SCL3300), ("sca3300-d01", _SCA3300))
}
