"""A sensor model of a third party, as small as one can be: a pendulum that prints its sine as text over I2C."""

from __future__ import annotations

from collections.abc import Mapping

from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link, require_length
from tiltcal.drivers.device import Model, Reading
from tiltcal.drivers.twin.fixture import HeldPose
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import BusError, DeviceFault


class Pendulum:
    """The driver: asks for the reading with ``?`` and takes seven characters."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link

    def probe(self) -> Mapping[str, str]:
        return {"x": f"{self.read().values[0]:g} V"}

    def read(self) -> Reading:
        text = require_length(self._link.exchange(b"?", 7), 7)
        try:
            return Reading((float(text),))
        except ValueError:
            raise DeviceFault(f"the pendulum said {text!r}, not a number: is it another device?") from None

    def discard(self) -> None:
        """Nothing queues up."""


class PendulumTwin:
    """The virtual pendulum."""

    letter = "i"

    def __init__(self, truth: Truth, held: HeldPose, clock: Clock) -> None:
        self._truth, self._held, self._clock = truth, held, clock

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        now_ns = self._clock.now_ns()
        self._clock.sleep(1e-3)
        if self._truth.fault_on_link(now_ns, "pendulum").kind == "silent":
            raise BusError("the pendulum does not answer, a fault that its truth sets")
        value = self._truth.sample("x", self._held.gravity, self._held.temperature(), now_ns, now_ns)
        return f"{value:+7.4f}".encode()

    def close(self) -> None:
        """Nothing to release."""


PENDULUM = Model(
    name="pendulum",
    title="Example pendulum of a third party",
    channels=("x",),
    unit="V",
    schemes=("i2c",),
    addresses=("i2c:///dev/i2c-1?address=0x30",),
    offset=0.0,
    sensitivity=5.0,
    offset_spread=0.02,
    sensitivity_spread=0.02,
    rails=(-9.9, 9.9),
    resolution=1e-4,
    interval=0.01,
    thermometer=False,
    driver=Pendulum,
    twin=PendulumTwin,
    not_modelled=("everything but offset and sensitivity", "the memory fault (parity) of other parts"),
    default_truth=lambda seed: Truth(("x",), {"x": 0.05}, {"x": {"x": 5.1, "y": 0.0, "z": 0.0}}, seed=seed),
)
