"""VTI (Murata) SCA103T and SCA61T one-axis inclinometers on SPI, with the commands of the SCA100T.

The SCA103T has two elements on one axis that look opposite ways; its reading is RDAX less RDAY. A memory parity error
drives both words below 102, and their difference would be that of a level part, so each word is judged by itself. The
SCA61T has one element and is asked for nothing but RDAX and the temperature.

Sources: SCA103T data sheet, VTI 8261700 Rev. A; of the SCA61T (8261900) the title page, pages 10 to 12 and what drivers
quote of its curves. Its limits as delivered were not found: they are taken as those of the SCA100T, which has the same
element.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import radians, sin
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.device import typical_nonlinearity
from tiltcal.drivers.sca100t import (
    DRIFT_SPREAD,
    GAIN_SPREAD,
    LOWEST_SANE_WORD,
    RDAX,
    RDAY,
    STX,
    STY,
    Inclinometer,
    InclinometerPart,
    Sca100t,
    SelfTest,
    decode_word,
    inclinometer_model,
    population,
)
from tiltcal.errors import DeviceFault, UsageError

if TYPE_CHECKING:
    from tiltcal.drivers.device import Model

HIGHEST_SANE_WORD = 1945
"""Largest reading of an SCA103T; a larger one is a broken connection or a tilt out of range."""


class Sca61t(Inclinometer):
    """The driver of an SCA61T: x in counts, 0 to 2047."""

    COMMANDS: ClassVar[Mapping[str, int]] = {"x": RDAX}


class Sca103t(Sca100t):
    """The driver of an SCA103T: the difference of its two elements in counts."""

    ELEMENTS: ClassVar[tuple[tuple[str, int, int], ...]] = (("RDAX", STX, RDAX), ("RDAY", STY, RDAY))
    COMMANDS: ClassVar[Mapping[str, int]] = {name: read for name, _, read in ELEMENTS}

    def self_test(self, channel: str) -> SelfTest:
        """Push one element with its electrode, then the other; see :meth:`Sca100t.self_test`.

        Returns
        -------
        SelfTest
            Of the first element that does not pass, or of the second one.
        """
        if channel != "x":
            raise UsageError(f"an SCA103T has channel x, no {channel!r}")
        first, second = (self._pushed(*element) for element in self.ELEMENTS)
        return second if first.passed else first

    def _said(self, words: Mapping[str, int]) -> dict[str, str]:
        plus, minus = words.values()
        return {
            "x": f"{plus - minus} count",
            "elements": f"{plus} and {minus} count, together {plus + minus} (2048 but for temperature and supply)",
        }

    def _values(self, words: Mapping[str, int]) -> tuple[float, ...]:
        plus, minus = words.values()
        return (float(plus - minus),)

    def _checked(self, channel: str, frame: bytes) -> int:
        word = decode_word(frame)
        if not LOWEST_SANE_WORD <= word <= HIGHEST_SANE_WORD:
            raise DeviceFault(
                f"{channel} reads {word} count, outside {LOWEST_SANE_WORD} to {HIGHEST_SANE_WORD}: it is tilted "
                "beyond its range, or shows a memory parity error or a broken connection: bring it near level; if "
                "it stays, switch its supply off and on"
            )
        return word


def _sca103t(variant: str, extent: float, counts: float, limit: float) -> Model:
    """Return the model of a part for ±extent, whose offset and nonlinearity have one limit, degrees."""
    reach = float(HIGHEST_SANE_WORD - LOWEST_SANE_WORD + 1)
    part = InclinometerPart(
        title=f"VTI (Murata) SCA103T-{variant} one-axis inclinometer, ±{extent:g}°, SPI",
        channels=("x",),
        counts_per_g=counts,
        offset_limit=limit,
        nonlinearity=typical_nonlinearity(sin(radians(limit)), sin(radians(extent))),
        # Its offset has no tendency; the slope differs over parts.
        population=population(
            counts,
            (0.0, 0.0),
            (-0.031, 0.0032, -0.00005, -0.0000005),
            (0.002, 0.013),
            "SCA103T data sheet 8261700 Rev. A, mean temperature curve of the sensitivity",
        ),
        zero=0.0,
        rails=(-reach, reach),
    )
    return inclinometer_model(f"sca103t-{variant.lower()}", part, Sca103t, "sca103t", "Sca103tTwin")


def _sca61t(variant: str, extent: str, counts: float, offset_limit: float) -> Model:
    part = InclinometerPart(
        title=f"VTI (Murata) SCA61T-{variant} one-axis inclinometer, {extent}, SPI",
        channels=("x",),
        counts_per_g=counts,
        offset_limit=offset_limit,
        population=population(
            counts,
            (0.0514, -0.0032, 0.0000857, -0.0000005),
            (0.0362, 0.0019, -0.00011),
            (DRIFT_SPREAD, GAIN_SPREAD),
            "SCA61T data sheet 8261900, mean temperature curves as a driver quotes them; their spread over parts is "
            "the SCA100T's",
        ),
    )
    return inclinometer_model(f"sca61t-{variant.lower()}", part, Sca61t, "sca103t", "Sca61tTwin")


SCA103T_D04 = _sca103t("D04", 15.0, 6554.0, 0.057)
SCA103T_D05 = _sca103t("D05", 30.0, 3277.0, 0.11)
SCA61T_FAHH1G = _sca61t("FAHH1G", "±30°", 1638.0, 0.11)
SCA61T_FA1H1G = _sca61t("FA1H1G", "±90°", 819.0, 0.23)
