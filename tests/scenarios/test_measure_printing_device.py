"""A device that prints few digits, with an offset that nobody states."""

from collections.abc import Mapping
from math import sqrt
from pathlib import Path
from typing import Any

import pytest
from support.pty_device import printing

import tiltcal

COARSE = (2.5034, 2.0046)
"""V, and V/g: what the device reads before it rounds to 0.01 V."""


class Table:
    """Sets each position; the last digit but one flickers."""

    gravity, lines = (0.0, 0.0, 1.0), 0

    def position(self, ask: Mapping[str, Any]) -> Mapping[str, str]:
        self.gravity = ask["gravity"]
        return {"answer": "ready"}

    def line(self) -> bytes:
        self.lines += 1
        offset, sensitivity = COARSE
        return b"%.2f,%.2f\r\n" % tuple(offset + sensitivity * g + 0.001 * (self.lines % 2) for g in self.gravity[:2])


def test_the_rounding_of_a_device_that_states_no_step_is_in_its_uncertainty(tmp_path: Path) -> None:
    table, remarks = Table(), list[str]()
    with printing(table.line, 500.0, waits=False) as port:
        address = f"serial:{port}?columns=x,y&unit=V&sensitivity=2"
        stated: Any = {"sensor": "serial-columns", "address": address, "serial": "C-1", "output": tmp_path / "C-1.yaml"}
        found = tiltcal.measure(
            "plane", operator=table, samples=5, settle=0.05, jig=0.0, remark=remarks.append, **stated
        )
    assert any("C-1: no offset= is stated, so that positions are compared with each other" in one for one in remarks)
    # The device reads 3.51, 1.50 and 2.50 V; a step is the last digit that it prints, and not a difference of these.
    assert isinstance(found, tiltcal.Calibration)
    u = [one.u["x"] for one in found.positions if one.u is not None]
    assert u == pytest.approx([0.01 / sqrt(12)] * 4, rel=1e-3)
    assert abs(found.offset["x"] - COARSE[0]) < 1.96 * found.uncertainty["offset.x"]
