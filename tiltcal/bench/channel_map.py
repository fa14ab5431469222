"""The channels of a turning stage, and the reading of a device that each of them is.

A channel is called as `tiltcal record` names its column: ``a1`` of a single device, ``S-7_a1`` of several; where only
one device has a channel of the name, the name alone will do. The pairs that come of it carry the names of the columns,
so that a pair file fits the logs that are recorded on the same bench.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tiltcal.bench.recording import column_name
from tiltcal.bench.sensor_set import Sample
from tiltcal.core.pair.model import Pair
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.rotation import Rotation


@dataclass(frozen=True)
class ChannelRef:
    """One reading of one device.

    Attributes
    ----------
    column : str
        As `tiltcal record` calls it.
    device, place : int
        The numbers of the device, and of the value in its reading.
    """

    column: str
    device: int
    place: int

    def value(self, sample: Sample) -> float:
        """Return this reading of a sample, in its unit."""
        return sample[self.device].values[self.place]


@dataclass(frozen=True)
class ChannelMap:
    """The devices and values that give the readings of a rotation.

    Attributes
    ----------
    phase : ChannelRef
        The stage angle, degrees.
    readings : tuple of ChannelRef
        Of all pairs, each once.
    pairs : tuple of Pair
        Those whose channels are there, by their columns.
    left_out : tuple of str
        Why others are not matched.
    """

    phase: ChannelRef
    readings: tuple[ChannelRef, ...]
    pairs: tuple[Pair, ...]
    left_out: tuple[str, ...] = ()


def map_channels(rotation: Rotation, devices: Sequence[tuple[str, Model]]) -> ChannelMap:
    """Find the channels of a rotation among the devices of a bench.

    Parameters
    ----------
    devices : sequence of (str, Model)
        Serial number and model as it is wired, in the order of the bench.

    UsageError: no stage angle, or not one pair has its channels.
    """
    channels = _Channels(devices)
    phase = channels.find(rotation.phase)
    if phase is None:
        raise UsageError(
            f"no device has the stage angle {rotation.phase!r} (there are {channels.names}): where a device prints it, "
            f"name it in the address, such as columns={rotation.phase},...; of a stage without an encoder record the "
            "turning with `tiltcal record`, and match the log with `tiltcal match` without --phase, which estimates "
            "the spin"
        )
    refs: dict[str, ChannelRef] = {}
    pairs, left_out = [], []
    for pair in rotation.pairs:
        found = {name: channels.find(name) for name in pair.channels}
        missing = [name for name, ref in found.items() if ref is None]
        if missing:
            left_out.append(f"{pair.first} and {pair.second} are not matched: there is no {' and no '.join(missing)}")
            continue
        known = {name: ref for name, ref in found.items() if ref is not None}
        refs |= {ref.column: ref for ref in known.values()}
        pairs.append(Pair(*(known[name].column for name in pair.channels)))
    if not pairs:
        raise UsageError(
            f"no pair has its channels: {'; '.join(left_out)} (there are {channels.names}): name them in the address, "
            "or copy the procedure and name your own pairs"
        )
    return ChannelMap(phase, tuple(refs.values()), tuple(pairs), tuple(left_out))


class _Channels:
    """Every reading of a bench, by the names it goes by."""

    def __init__(self, devices: Sequence[tuple[str, Model]]) -> None:
        self._by_column: dict[str, ChannelRef] = {}
        self._by_channel: dict[str, list[ChannelRef]] = {}
        for number, (serial, model) in enumerate(devices):
            for place, channel in enumerate(model.channels):
                ref = ChannelRef(column_name(serial, channel, alone=len(devices) == 1), number, place)
                self._by_column[ref.column] = ref
                self._by_channel.setdefault(channel, []).append(ref)

    @property
    def names(self) -> str:
        return ", ".join(self._by_column) or "no readings"

    def find(self, name: str) -> ChannelRef | None:
        """Return the reading of a name; None where there is none.

        UsageError: several devices have it.
        """
        if name in self._by_column:
            return self._by_column[name]
        found = self._by_channel.get(name, [])
        if len(found) > 1:
            columns = " or ".join(ref.column for ref in found)
            raise UsageError(f"{len(found)} devices have a channel {name!r}: name one in the procedure: {columns}")
        return found[0] if found else None
