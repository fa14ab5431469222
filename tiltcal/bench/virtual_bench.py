"""The virtual bench: twins behind ``sim:`` addresses, held by one jig in one chamber."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from math import radians

from tiltcal.bench.device_setup import DeviceSetup
from tiltcal.core.attitude import Vector
from tiltcal.core.model import Mounting
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link
from tiltcal.drivers.model import Model
from tiltcal.drivers.virtual import Fixture, Truth
from tiltcal.files.twin import read_twin


class VirtualBench:
    """Makes the twins of a session and the fixture that holds them.

    Parameters
    ----------
    devices : sequence of DeviceSetup
        The devices; ``sim:`` addresses take ``twin=FILE`` and ``seed=N``.
    """

    def __init__(self, clock: Clock, devices: Sequence[DeviceSetup]) -> None:
        self._clock = clock
        self._first = next((device for device in devices if parse_address(device.address).simulated), None)

    @cached_property
    def fixture(self) -> Fixture:
        """The jig and the chamber, with the errors that the truth of the first virtual sensor states."""
        if self._first is None:
            return Fixture(self._clock)
        truth = truth_of(parse_address(self._first.address), self._first.model)
        return Fixture(
            self._clock, seed=truth.seed, jig=truth.jig, ambient=truth.ambient, time_constant=truth.time_constant
        )

    def twin(self, device: DeviceSetup) -> Link:
        """Return the virtual sensor behind a ``sim:`` address."""
        truth = truth_of(parse_address(device.address), device.model)
        return device.model.twin(truth, self.fixture.turned(_to_sensor(device, truth)), self._clock)


def _to_sensor(device: DeviceSetup, truth: Truth) -> Callable[[Vector], Vector]:
    """Return the function that takes a vector of the fixture's frame into the sensor's."""
    if truth.mounting == (0.0, 0.0, 0.0):
        return device.orientation.seen
    from tiltcal.core.mounting_angles import mounting_matrix

    roll, pitch, yaw = map(radians, truth.mounting)
    to_sensor = mounting_matrix(Mounting(roll, pitch, yaw)).T.tolist()

    def seen(vector: Vector) -> Vector:
        straight = device.orientation.seen(vector)
        x, y, z = (sum(a * b for a, b in zip(row, straight, strict=True)) for row in to_sensor)
        return x, y, z

    return seen


def truth_of(address: Address, model: Model) -> Truth:
    """Return the truth of the virtual sensor behind a ``sim:`` address.

    UsageError: an unknown option, or a twin file of another model or with too few channels.
    InputError: the twin file is wrong.
    """
    address.allow("twin", "seed", *model.options)
    seed = address.integer("seed", 0)
    if "twin" not in address.options:
        if model.default_truth is None:
            address.refuse(f"{model.name} has no default twin; name one with twin=FILE")
        return model.default_truth(seed)
    named, truth = read_twin(address.text("twin"), seed if "seed" in address.options else None)
    if named is not None and named != model.name:
        address.refuse(f"the twin file is of a {named}, not of a {model.name}")
    missing = [channel for channel in model.channels if channel not in truth.channels]
    if missing:
        address.refuse(f"the twin file has no {' and no '.join(missing)}, which a {model.name} reads")
    return truth
