"""One device of a session: its model, where it is connected, and how it sits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tiltcal.core.orientation import STRAIGHT, Orientation, orientation
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.device import Model
from tiltcal.files.journal_header import DeviceHeader


@dataclass(frozen=True)
class DeviceSetup:
    """One device of a plan.

    Attributes
    ----------
    output : str
        The calibration file, relative to the journal's folder; empty where none is made.
    orientation : Orientation
        How the sensor sits on the fixture.
    """

    model_name: str
    serial: str
    address: str
    output: str = ""
    orientation: Orientation = STRAIGHT

    @cached_property
    def model(self) -> Model:
        """The model as it is wired at the address."""
        return find_model(self.model_name).at(parse_address(self.address))

    def record(self) -> dict[str, Any]:
        """As plain data, for the journal."""
        straight = self.orientation.straight
        return {
            "model": self.model_name,
            "serial": self.serial,
            "address": self.address,
            "output": self.output,
            **({} if straight else {"axes": list(self.orientation.names)}),
        }

    @classmethod
    def from_header(cls, device: DeviceHeader) -> DeviceSetup:
        """Return the setup of a device as a journal's header has it."""
        turned = STRAIGHT if device.axes is None else orientation(device.axes)
        return cls(device.model, device.serial, device.address, device.output, turned)
