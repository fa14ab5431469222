"""A session with a device that prints few digits: no model states its step, and rounding counts all the same."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from pathlib import Path
from typing import Any

import pytest
from support.pty_device import printing

import tiltcal

OFFSET, SENSITIVITY = 2.5034, 2.0046
"""V, and V/g: what the device reads before it rounds to 0.01 V."""


class Table:
    """Sets the attitude of the device, which has no noise at all, exactly as asked."""

    def __init__(self) -> None:
        self.gravity = (0.0, 0.0, 1.0)

    def position(self, ask: Mapping[str, Any]) -> Mapping[str, str]:
        self.gravity = ask["gravity"]
        return {"answer": "ready"}

    def line(self) -> bytes:
        return b"%.2f,%.2f\r\n" % tuple(OFFSET + SENSITIVITY * component for component in self.gravity[:2])


def test_the_rounding_of_a_device_that_states_no_step_is_in_its_uncertainty(tmp_path: Path) -> None:
    table = Table()
    with printing(table.line, 500.0, waits=False) as port:
        found = tiltcal.measure(
            "plane",
            sensor="serial-columns",
            address=f"serial:{port}?columns=x,y&unit=V&offset=2.5&sensitivity=2",
            serial="C-1",
            operator=table,
            output=tmp_path / "C-1.yaml",
            samples=5,
            settle=0.05,
            jig=0.0,
        )
    # The device reads 3.51, 1.50 and 2.50 V; a step is the last digit that it prints, and not a difference of these.
    assert isinstance(found, tiltcal.Calibration)
    u = [one.u["x"] for one in found.positions if one.u is not None]
    assert u == pytest.approx([0.01 / sqrt(12)] * 4, rel=1e-3)
    assert abs(found.offset["x"] - OFFSET) < 1.96 * found.uncertainty["offset.x"]
