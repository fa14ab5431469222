"""Four accelerometers on a rotary stage: a device prints their readings and the stage angle on a line.

This is :mod:`tiltcal.drivers.columns` with the columns of a gravity gradient instrument, and with a virtual stage for
``sim:``. The address may name other columns::

    serial:///dev/ttyUSB0?columns=theta,a1,a2,-,a4&separator=semicolon

Source: Misalignment Angle Compensation during Scale Factor Matching (2018), figure 1.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.columns import (
    SEPARATORS,
    SERIAL_COLUMNS,
    UNKNOWN,
    UNSTATED,
    ColumnLayout,
    ColumnsSensor,
    columns_of,
)
from tiltcal.drivers.device import Model, from_twin

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address

PRINTED = "time,theta,a1,a2,a3,a4"
"""Default columns: seconds, the stage angle in degrees, the four readings."""


def _configured(address: Address) -> Model:
    """Return the model with the options of the address."""
    columns = columns_of(address, PRINTED)
    return replace(
        GRADIOMETER,
        channels=columns.channels,
        unit=address.text("unit", "mA" if address.simulated else UNSTATED),
        driver=partial(ColumnsSensor, columns),
        twin=from_twin("gradiometer", "gradiometer_twin", columns),
    )


_PRINTED = ColumnLayout(tuple(PRINTED.split(",")), SEPARATORS["any"])

GRADIOMETER = replace(
    SERIAL_COLUMNS,
    name="gradiometer",
    title="four accelerometers on a rotary stage, as numbers on a line",
    channels=_PRINTED.channels,
    unit="mA",
    addresses=(f"serial:///dev/ttyUSB0?columns={PRINTED}",),
    # Matching a pair does not need the value of 1 g.
    sensitivity=UNKNOWN,
    scaled=False,
    thermometer=False,
    driver=partial(ColumnsSensor, _PRINTED),
    twin=from_twin("gradiometer", "gradiometer_twin", _PRINTED),
    not_modelled=(
        "a stage that starts, stops or changes its speed: it turns steadily from the beginning of the session",
        "the stage's bearing, vibration and angular acceleration",
        "output and pendulous axes: only the misalignment in the plane of the disk couples",
        "bandwidth and delay of the accelerometers, and of the encoder behind them",
        "temperature, and the memory fault (parity) of other parts",
        "loss and damage on the line",
    ),
    default_truth=from_twin("gradiometer", "draw_truth"),
    options=("columns", "separator", "unit"),
    configure=_configured,
)
