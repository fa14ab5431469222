"""Times in the units of CF, in the spellings of UDUNITS, and what is said of each column."""

from datetime import UTC, datetime

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.cf_attributes import describe, in_seconds


def test_every_unit_of_time_is_counted_from_any_epoch() -> None:
    seconds = {"ns": 1e-9, "µs": 1e-6, "us": 1e-6, "ms": 1e-3, "Milliseconds": 1e-3, "s": 1.0, "second": 1.0}
    seconds |= {"min": 60.0, "minutes": 60.0, "h": 3600.0, "hours": 3600.0, "d": 86400.0, "days": 86400.0}
    count = np.array([0.0, 3.0, np.nan])
    for unit, length in seconds.items():
        since = in_seconds(count, f"{unit} since 2000-1-1 0:0:0")
        assert since == pytest.approx(946684800.0 + count * length, nan_ok=True), unit
        assert in_seconds(count, unit) == pytest.approx(count * length, nan_ok=True), unit
    for unit in (None, "", "1"):
        assert in_seconds(np.array([2.5]), unit).item() == 2.5
    # A moment is the nearest double to its count.
    assert in_seconds(np.array([1767225600020.0]), "ms since 1970-01-01").item() == 1767225600.02


def test_an_epoch_needs_no_leading_zeros() -> None:
    epochs = {
        "2000-1-1": datetime(2000, 1, 1, tzinfo=UTC),
        "2000-01-01 6": datetime(2000, 1, 1, 6, tzinfo=UTC),
        "1992-10-8 15:15:42.5 -6:00": datetime(1992, 10, 8, 21, 15, 42, 500000, tzinfo=UTC),  # of the CF conventions
        "2000-01-01T00:00:00Z": datetime(2000, 1, 1, tzinfo=UTC),
        "2000-01-01 12:30 UTC": datetime(2000, 1, 1, 12, 30, tzinfo=UTC),
        "2000-01-01 00:00:0.0": datetime(2000, 1, 1, tzinfo=UTC),
        "1-1-1": datetime(1, 1, 1, tzinfo=UTC),
    }
    for epoch, moment in epochs.items():
        assert in_seconds(np.zeros(1), f"days since {epoch}").item() == moment.timestamp(), epoch


@pytest.mark.parametrize(
    ("unit", "why"),
    [
        ("furlongs since 2000-01-01", "'furlongs' is no unit of time"),
        ("years", "'years' is no unit of time"),
        ("days since the flood", "'the flood' is no moment"),
        ("seconds since 2000-13-01", "is no moment"),
    ],
)
def test_what_counts_in_no_unit_or_from_no_moment_is_refused(unit: str, why: str) -> None:
    with pytest.raises(InputError, match=f"^deck.nc: .*{why}"):
        in_seconds(np.zeros(1), unit, "deck.nc")


MEANINGS = {
    "g_x": ("1", "share of gravity along x, up", "flag reason"),
    "tilt_x": ("degree", "tilt of the x axis, positive where it points up", "flag reason u_tilt_x U95_tilt_x"),
    "u_tilt_x": ("degree", "standard uncertainty of tilt_x", None),
    "U95_tilt_x": ("degree", "half width of the 95 % interval of tilt_x", None),
    "u_common_v_up": ("cm s-1", "standard uncertainty of v_up, common to all rows", None),
    "u_random_pitch": ("degree", "standard uncertainty of pitch, random", None),
    "pitch": ("degree", "pitch, positive where the x axis points up", "flag reason u_random_pitch"),
    "roll": ("degree", "roll, positive where the y axis points up", "flag reason"),
    "inclination": ("degree", "inclination of the z axis from the vertical", "flag reason"),
    "heading": ("degree", "heading of the x axis, clockwise from north", "flag reason"),
    "v_east": (None, "velocity, component east", "flag reason"),
    "v_up": ("cm s-1", "velocity, component up", "flag reason u_common_v_up"),
    "matched_a1_a2": ("m s-2", "matched sum of the pair a1_a2", "flag reason"),
    "gradient": ("m s-2", "gradient signal", "flag reason"),
    "gradient_sin": ("m s-2", "sin component of the gradient signal at twice the turning", "flag reason"),
    "count": ("1", "number of rows of which each row is the mean", None),
    "SN-17_tilt_y": ("degree", "tilt of the y axis, positive where it points up, of SN-17", "SN-17_flag SN-17_reason"),
}


def test_every_column_says_its_unit_its_meaning_and_its_companions() -> None:
    added = (*MEANINGS, "flag", "reason", "SN-17_flag", "SN-17_reason")
    for name, said in MEANINGS.items():
        keys = ("units", "long_name", "ancillary_variables")
        expected = {key: text for key, text in zip(keys, said, strict=True) if text is not None}
        units = {"v_east": None, "v_up": "cm s-1"}
        assert describe(name, added, {"units": "m s-2"}, units) == expected
        assert describe(name, added, {"units": "m s-2", "coordinates": "s"}, units) == expected | {"coordinates": "s"}
    for name, whose in (("flag", ""), ("SN-17_reason", ", of SN-17")):
        found = describe(name, added, {})
        codes = found.get("flag_values", found.get("flag_masks")).tolist()
        assert len(codes) == len(found["flag_meanings"].split())
        assert found["long_name"].endswith(f"quality flag{whose}" if whose else "quality flag of QARTOD")
        assert codes == ([1, 2, 4, 8, 16, 32, 64, 128, 256] if whose else [1, 3, 4, 9])
    assert describe("flag", added, {})["flag_meanings"] == "pass suspect fail missing"
