"""Holds and segments of a log: what counts of them, what is measured in them, and what is refused in whole words."""

from dataclasses import replace

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.files.procedure import find_procedure
from tiltcal.files.tables import Segment
from tiltcal.logs.columns import RecordedColumns
from tiltcal.logs.positions import Trimmed, intervals_of, placed, rise, trimmed

ROWS = 80
DRAW = np.random.default_rng(5)
RAILS = {"x": (0.0, 5.0), "y": (0.0, 5.0)}


def held(names: str) -> tuple[dict[str, np.ndarray], list[Segment]]:
    """Readings at 2 and 3 V with a noise of 1 mV, in holds of 80 rows one after the other."""
    readings = {c: level + DRAW.normal(0.0, 1e-3, ROWS * len(names)) for c, level in (("x", 2.0), ("y", 3.0))}
    return readings, [Segment(name, ROWS * k, ROWS * k + ROWS, None, k + 2) for k, name in enumerate(names)]


def test_the_rise_is_that_of_the_line_less_its_scatter() -> None:
    """A slope of 0.01 per sample with little scatter, from numpy's fit; three samples show none."""
    values = 0.01 * np.arange(300.0) + np.random.default_rng(4).normal(0.0, 0.05, 300)
    (slope, _), covariance = np.polyfit(np.arange(300), values, 1, cov=True)
    assert rise(values) == pytest.approx(299 * (slope - 3.0 * np.sqrt(covariance[0, 0])), rel=1e-9)
    assert rise(-values) == -rise(values)
    assert (rise(np.arange(3.0)), rise(np.arange(4.0)), rise(values - 0.01 * np.arange(300.0))) == (0.0, 3.0, 0.0)


def test_holds_are_trimmed_to_what_stands_still_or_left_out() -> None:
    readings, segments = held("abcdefghija")
    x, y, at = readings["x"], readings["y"], ROWS * np.arange(11)
    x[at[1] + 7] = 5.0
    y[at[2] : at[3]] = 3.0
    x[at[3] + 60 : at[4]] += 0.1
    y[at[4] : at[4] + 20] -= 0.1
    x[at[5] : at[5] + 5], y[at[5] + 5] = np.nan, 4.0
    x[at[6] + 30 : at[6] + 50] = np.nan
    y[at[7] : at[8]] = np.nan
    x[at[8] : at[8] + 3], y[at[8] + 79] = np.nan, 4.0  # four of 80 are few
    y[at[9] + 5] = 0.0
    found = trimmed(RecordedColumns(readings, "log.csv", 0), "xy", segments, RAILS, 31)
    assert [*found.in_words()] == [
        "5 of 11 holds are left out: b (x is at its rail), c (y stood at one value), g (20 of its 80 samples are far "
        "off or missing), h (80 of its 80 samples are far off or missing), j (y is at its rail)",
        "3 of 11 holds are trimmed: d (x jumps in it: rows 240 to 300), e (y jumps in it: rows 340 to 400), f (6 of "
        "its 80 samples are far off or missing: rows 406 to 480)",
    ]
    assert found.faults == {"b": "x", "c": "y", "j": "y"}
    a, _, _, d, e, f, _, _, i, _, again = segments
    ends = replace(d, end=300), replace(e, start=340), replace(f, start=406)
    assert found.segments == (a, *ends, i, again)
    assert trimmed(RecordedColumns(readings, "log.csv", 0), "xy", segments[6:7], RAILS, 30).segments == (
        replace(segments[6], end=510),
    )
    assert [*trimmed(RecordedColumns(readings, "log.csv", 0), "xy", segments[:2], RAILS, 31).in_words()] == [
        "1 of 2 holds is left out: b (x is at its rail)"
    ]


def test_a_small_jump_is_none() -> None:
    """Twice the noise is where one begins, however long the hold is."""
    for jump, trims in ((1.8, 0), (2.2, 1)):
        values = np.tile([1.0, -1.0], 1600) + np.repeat([0.0, jump], 1600) * 2.0**0.5
        log = RecordedColumns({"x": values + 1e-3 * DRAW.normal(size=3200)}, "log.csv", 0)
        assert len(trimmed(log, "x", [Segment("a", 0, 3200, None, None)], {}, 25).trimmed) == trims


def test_lost_holds_speak_against_a_sensor() -> None:
    """More than a third of all, or more than two by one channel."""
    for holds, channels, lost in (
        (12, "xxyy", None),
        (11, "xxyy", "4 of 11"),
        (20, "xxx", "3 of 20"),
        (2, "x", "1 of 2"),
    ):
        faults = {str(number): channel for number, channel in enumerate(channels)}
        which = ", ".join(sorted(set(channels)))
        said = lost and f"{lost} holds are left out for a rail or standstill, which is not credible ({which})"
        assert Trimmed(holds, (), {}, {}, faults).not_credible == said


def test_what_is_measured_in_segments() -> None:
    """Two parts of one placement, and the same again; a sample far off and a thermometer's fault are left out."""
    readings, _ = held("abc")
    readings["x"][50], readings["y"][100] = 2.5, np.nan
    readings |= {"time": 1767225600.0 + np.arange(240.0), "temperature": 20.0 + 0.001 * np.arange(240.0)}
    readings["temperature"][45] = 85.0
    up = (0.0, 0.6, 0.8)
    parts = [
        Segment("a", *span, gravity, None)
        for span, gravity in (((0, 40), None), ((40, 80), None), ((90, 170), up), ((170, 240), None))
    ]
    first, up_again, again = intervals_of(
        RecordedColumns(readings, "log.csv", 0), "xy", parts, RAILS, file="s.csv", soak=0.0
    )
    assert [one.measurement.position for one in (first, up_again, again)] == ["a", "a (2)", "a (3)"]
    assert [one.stated for one in (first, up_again, again)] == [parts[0], *parts[2:]]
    assert [one.measurement.noted for one in (first, up_again, again)] == [
        {"rows": ((0, 40), (40, 80)), "left_out": 1, "time": "2026-01-01T00:01:19.000Z"},
        {"rows": (90, 170), "left_out": 1, "time": "2026-01-01T00:02:49.000Z"},
        {"rows": (170, 240), "time": "2026-01-01T00:03:59.000Z"},
    ]
    assert first.times == (1767225600.0, 1767225679.0)
    kept = np.delete(readings["x"][:80], 50)
    summary = first.measurement.summaries["x"]
    assert (summary.n, summary.mean, summary.std) == (79, pytest.approx(kept.mean()), pytest.approx(kept.std(ddof=1)))
    assert first.measurement.temperature == pytest.approx(np.delete(readings["temperature"][:80], 45).mean())
    assert first.warming == pytest.approx(0.078, abs=2e-3)
    procedure = find_procedure("two-temperature")
    warm, cold = procedure.positions
    segments = [replace(parts[0], name=warm.name), replace(parts[2], name=cold.name)]
    two = intervals_of(RecordedColumns(readings, "log.csv", 0), "xy", segments, RAILS, file="s.csv", soak=0.0)
    set_, stated = placed([replace(one, warming=0.0) for one in two], procedure, file="s.csv")
    assert (set_.gravity, set_.tilt, stated.gravity, stated.tilt) == (warm.gravity, warm.tilt, up, None)
    without = {name: column for name, column in readings.items() if name != "temperature"}
    two = intervals_of(RecordedColumns(without, "log.csv", 0), "xy", segments, RAILS, file="s.csv", soak=0.0)
    assert [one.temperature for one in placed(two, procedure, file="s.csv")] == [warm.temperature, None]


def test_a_temperature_is_judged_over_its_soak() -> None:
    """It rises by 10 mK a row and second; without time up to the segment before, and never beyond a restart."""
    readings, _ = held("abc")
    time, temperature = np.arange(240.0), 20.0 + 0.01 * np.arange(240.0)
    restarted = np.where(time < 70.0, time, time - 70.0)
    segments = [Segment(name, *rows, None, None) for name, *rows in (("a", 0, 50), ("b", 90, 105), ("b", 105, 120))]
    for times, soak, begin in (
        (time, 0.0, 90),
        (time, 20.0, 90),
        (time, 60.0, 59),
        (time, 119.0, 0),
        (time, 500.0, 0),
        (restarted, 60.0, 70),
        (np.where(time == 100.0, np.nan, time), 60.0, 101),
        (np.where(time == 119.0, np.nan, time), 60.0, 50),
        (None, 60.0, 50),
    ):
        columns = {**readings, "temperature": temperature} | ({} if times is None else {"time": times})
        _, found = intervals_of(RecordedColumns(columns, "log.csv", 0), "xy", segments, RAILS, file="s.csv", soak=soak)
        assert found.warming == pytest.approx(0.01 * (119 - min(begin, 90))), (soak, begin)


AT = slice(80, 160)
BAD = [
    ({}, (80, 241), "ends at row 241; log.csv has 240 rows"),
    ({}, (80, 81), "has 1 row; at least 2 are needed"),
    (
        {"x": (AT, 5.25)},
        (80, 160),
        "x reads 5.25 in 80 of its rows, at its rail or beyond (0 to 5): is this the sensor, are these its readings in "
        "its unit, and is the angle within its range?",
    ),
    (
        {"y": (slice(84, 89), np.nan)},
        (80, 160),
        "5 of its 80 samples are far off or missing: y has no number; choose other rows",
    ),
    ({"y": (80, np.nan)}, (80, 82), "1 of its 2 samples are far off or missing: y has no number; choose other rows"),
    (
        {"x": (AT, np.where(np.arange(80) < 6, [4.0], np.tile([2.0, 2.001], 40)))},
        (80, 160),
        "6 of its 80 samples are far off or missing: x reads 4 where the other samples read 2.001; choose other rows",
    ),
    (
        {"temperature": (AT, np.where(np.arange(80) < 6, [85.0, 84.0] * 40, 20.0))},
        (80, 160),
        "6 of its 80 samples are far off or missing: the thermometer reads 85 °C; choose other rows",
    ),
    ({"x": (AT, 2.0)}, (80, 160), "all samples of x are identical, and elsewhere they scatter by 0.00"),
    (
        {"temperature": (AT, np.nan)},
        (80, 160),
        "there is no temperature in its rows, and level-warm has one; choose rows that have it, or fill it in",
    ),
    (
        {"temperature": (AT, 20.0 + np.arange(80) / 79.0)},
        (80, 160),
        "the temperature drifts by +1.00 °C up to its end, more than the 0.06 °C that two-temperature allows in 360 s: "
        "thermometer and sensor are apart while they change; take rows where both stand still, or go slower",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "rows", "said"), BAD, ids=[said[:30] for *_, said in BAD])
def test_a_segment_that_shows_nothing_is_refused(changes: dict, rows: tuple[int, int], said: str) -> None:
    readings, _ = held("abc")
    readings |= {"temperature": np.full(240, 20.0), "time": np.arange(240.0)}
    for name, (place, value) in changes.items():
        readings[name][place] = value
    segments = [Segment("level-warm", 0, 80, None, 2), Segment("level-cold", *rows, None, 3)]
    record = RecordedColumns(readings, "log.csv", 0)
    with pytest.raises(InputError) as refused:
        placed(
            intervals_of(record, "xy", segments, RAILS, file="s.csv", soak=60.0),
            find_procedure("two-temperature").in_positions(),
            file="s.csv",
        )
    assert str(refused.value).startswith(f"s.csv:3: segment level-cold: {said}")
