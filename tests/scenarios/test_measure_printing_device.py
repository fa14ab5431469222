"""Devices that print numbers: few digits, or an offset and a sensitivity that nobody states."""

from collections.abc import Mapping
from math import sqrt
from pathlib import Path
from typing import Any

import pytest
from support.pty_device import printing

import tiltcal
from tiltcal.errors import Stopped


class Table:
    """Sets one position of a procedure the other way round, and what is refused once more; the last digit flickers."""

    def __init__(self, wrong: str, offset: float, sensitivity: float, printed: bytes = b"%.3f,%.3f\r\n") -> None:
        self.wrong, self.offset, self.sensitivity, self.printed = wrong, offset, sensitivity, printed
        self.gravity, self.lines = (0.0, 0.0, 1.0), 0
        self.refusals: list[tuple[str, str]] = []

    def position(self, ask: Mapping[str, Any]) -> Mapping[str, str]:
        x, y, z = ask["gravity"]
        self.gravity = (-x, -y, z) if ask["position"] == self.wrong else (x, y, z)
        return {"answer": "quit" if self.refusals else "ready"}

    def refused(self, event: Mapping[str, Any]) -> None:
        self.refusals.append((event["position"], event["why"]))

    def line(self) -> bytes:
        self.lines += 1
        flicker = 0.001 * (self.lines % 2)
        return self.printed % tuple(self.offset + self.sensitivity * g + flicker for g in self.gravity[:2])


def session(table: Table, options: str, folder: Path, *, stops: bool = True) -> list[str]:
    """Return the remarks of a session of ``plane``."""
    remarks: list[str] = []
    with printing(table.line, 500.0, waits=False) as port:
        address = f"serial:{port}?columns=x,y&{options}"
        stated = {"sensor": "serial-columns", "address": address, "serial": "C-1", "output": folder / "C-1.yaml"}
        if stops:
            with pytest.raises(Stopped):
                tiltcal.measure("plane", operator=table, samples=4, settle=0.05, remark=remarks.append, **stated)
        else:
            tiltcal.measure("plane", operator=table, samples=4, settle=0.05, remark=remarks.append, **stated)
    return remarks


def test_a_wrong_position_is_refused_in_a_unit_of_acceleration(tmp_path: Path) -> None:
    table = Table("x-tilt1", 0.1, 9.8)
    remarks = session(table, "unit=m/s²", tmp_path)
    assert table.refusals == [
        (
            "x-tilt1",
            "this looks like x-tilt2: is the sensor turned round? "
            "If the +X side really points down now, choose x-tilt2",
        )
    ]
    assert not any("is stated, so that" in remark for remark in remarks)


@pytest.mark.parametrize(("wrong", "refused"), [("x-tilt1", "x-tilt2"), ("y-tilt1", "y-tilt1")])
def test_a_stated_sensitivity_compares_positions_with_each_other(wrong: str, refused: str, tmp_path: Path) -> None:
    """The first position can be compared with none: it is the second that contradicts it."""
    table = Table(wrong, 2.5, 2.0)
    remarks = session(table, "unit=V&sensitivity=2", tmp_path)
    ((position, why),) = table.refusals
    assert position == refused
    assert "or was a position before it wrong (go back)?" in why
    assert any("C-1: no offset= is stated, so that positions are compared with each other" in one for one in remarks)


COARSE = (2.5034, 2.0046)
"""V, and V/g: what the device reads before it rounds to 0.01 V."""


def test_the_rounding_of_a_device_that_states_no_step_is_in_its_uncertainty(tmp_path: Path) -> None:
    table = Table("", *COARSE, b"%.2f,%.2f\r\n")
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
    assert abs(found.offset["x"] - COARSE[0]) < 1.96 * found.uncertainty["offset.x"]
