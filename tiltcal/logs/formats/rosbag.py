"""Bags of ROS 1 and 2: the ``sensor_msgs/Imu`` messages of one topic as rows, through the package ``rosbags``.

The columns are ``time`` (of the message's header, s since 1970), ``x``, ``y``, ``z`` (linear acceleration, m/s²) and
``wx``, ``wy``, ``wz`` (angular velocity, rad/s). ``run.mcap::/imu/data`` names a topic; without one the bag must have a
single topic of this type.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.errors import Argument, InputError, UsageError
from tiltcal.extras import how_to_add
from tiltcal.logs.log import LogBlock, LogReader, LogSource
from tiltcal.logs.streams import refusing, sha256_of

IMU = "sensor_msgs/msg/Imu"
TOPIC_MARK = "::"
UNITS = {"time": None, **dict.fromkeys(("x", "y", "z"), "m/s2"), **dict.fromkeys(("wx", "wy", "wz"), "rad/s")}
"""The columns with their units."""

_ROWS = 1 << 15


class RosbagReader(LogReader):
    """The messages of a topic; see :class:`tiltcal.logs.log.LogReader`."""

    names = tuple(UNITS)

    def __init__(self, source: LogSource) -> None:
        super().__init__(source)
        place, _, topic = source.path.partition(TOPIC_MARK)
        self._path = Path(place)
        if not self._path.exists():
            raise UsageError(f"{place}: no such file")
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as cause:
            raise UsageError(f"bags of ROS need the package rosbags: {how_to_add('tiltcal[rosbag]')}") from cause
        with self._refusing_damage():
            self._bag = AnyReader([self._path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._bag.open()
        try:
            self._topic = self._found(topic)
        except InputError:
            self.close()
            raise
        self.notes = {"topic": self._topic}

    def _found(self, wanted: str) -> str:
        """Return the topic that is wanted, or the only one of this type where none is."""
        topics = sorted({one.topic for one in self._bag.connections if one.msgtype == IMU})
        if not topics or (wanted and wanted not in topics):
            there = ", ".join(sorted({f"{one.topic} ({one.msgtype})" for one in self._bag.connections})) or "none"
            what = f"topic {wanted!r} of" if wanted else "topic of"
            raise InputError(f"there is no {what} sensor_msgs/Imu; the topics are {there}", file=self.name)
        if not wanted and len(topics) > 1:
            why = "several topics are sensor_msgs/Imu: name one, "
            raise InputError((why, Argument("topic", " or ".join(topics))), file=self.name)
        return wanted or topics[0]

    @property
    def sha256(self) -> str | None:
        """The checksum of the bag; of a folder that of its files, in the order of their names."""
        if self._path.is_file():
            return sha256_of(self._path)
        return sha256("".join(sha256_of(path) for path in sorted(self._path.iterdir())).encode()).hexdigest()

    def unit(self, column: int) -> str | None:
        return UNITS[self.names[column]]

    def close(self) -> None:
        self._bag.close()

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        import polars as pl

        messages, done = self._messages(), 0
        while rows := list(islice(messages, _ROWS)):
            done += len(rows)
            table = np.array(rows).T.copy()  # each column is contiguous
            frame = pl.DataFrame(dict(zip(self.names, table, strict=True))) if frames else None
            yield LogBlock({index: table[index] for index in columns}, frame=frame)
        if not done:
            raise InputError(f"topic {self._topic} has no message", file=self.name)

    def _messages(self) -> Iterator[tuple[float, ...]]:
        connections = [one for one in self._bag.connections if one.topic == self._topic]
        with self._refusing_damage():
            for connection, received, raw in self._bag.messages(connections):
                message: Any = self._bag.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                seconds = stamp.sec + stamp.nanosec * 1e-9 if stamp.sec else received * 1e-9
                acceleration, rate = message.linear_acceleration, message.angular_velocity
                yield seconds, acceleration.x, acceleration.y, acceleration.z, rate.x, rate.y, rate.z

    @contextmanager
    def _refusing_damage(self) -> Iterator[None]:
        damaged = "this is no bag of ROS, or a damaged or truncated one"
        try:
            with refusing(damaged, self.name):
                yield
        except MemoryError as failure:  # a length in the file is read as it stands
            raise InputError(f"{damaged}: a length in it is beyond all memory", file=self.name) from failure
