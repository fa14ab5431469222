"""The rows of a ramp that count: temperatures that a thermometer did not convert do not."""

import numpy as np
import pytest

from tiltcal.core.ramp.record import ramp_record
from tiltcal.errors import EstimateError

SECONDS = np.arange(2400.0)
CHAMBER = 5.0 + 40.0 * np.abs((SECONDS / 1200.0 + 1.0) % 2.0 - 1.0)


def test_what_a_ds18b20_reads_that_fails_is_left_out_and_named():
    """0.5 % of the rows read 85 °C, as its data sheet has it after power-on; one reads -127 °C, a wire that is off."""
    failed, temperature = np.random.default_rng(2).choice(2400, 12, replace=False), CHAMBER.copy()
    temperature[failed], temperature[0], temperature[1700:1703] = 85.0, 85.0, -127.0
    failed = np.unique([0, *failed, 1700, 1701, 1702])
    record = ramp_record(SECONDS, temperature, [temperature], 100)
    assert record.rows == 2400 - len(failed)
    assert record.temperature == pytest.approx(np.delete(CHAMBER, failed))
    assert record.jumps.endswith(f"are left out: {len(failed)}, the first in row 100, 85 °C beside 5.1 °C")
    temperature[300::10] = 85.0
    with pytest.raises(EstimateError, match=r"of 2400 .* the first in row 0, 85 °C beside 5.1 °C"):
        ramp_record(SECONDS, temperature, [temperature])
    short = np.where(np.isin(np.arange(39), (10, 20)), 85.0, 5.0)  # two are more than one, and than 5 % of so few
    with pytest.raises(EstimateError, match=r"of 39 .*2, the first in row 10"):
        ramp_record(SECONDS[:39], short, [short])


def test_a_gap_and_a_fast_ramp_are_no_jumps():
    """Rows that miss values, after which the chamber is elsewhere; and one row for every 20 °C."""
    temperature = CHAMBER.copy()
    temperature[500:900] = np.nan
    assert ramp_record(SECONDS, temperature, [temperature]).rows == 2000
    assert ramp_record(SECONDS[:32], CHAMBER[:32], [CHAMBER[:32]]).rows == 32
    fast = 1200.0 * np.abs((np.arange(120.0) / 60.0 + 1.0) % 2.0 - 1.0)
    assert ramp_record(60.0 * np.arange(120.0), fast, [fast]).rows == 120


def test_a_record_of_any_length_becomes_few_means():
    """The means of 100,000 rows are those of numpy."""
    seconds = np.arange(100_000.0)
    readings = np.random.default_rng(5).normal(size=100_000) + seconds
    record = ramp_record(seconds, seconds * 2.0, [readings])
    size = round(record.time[1] - record.time[0])
    assert 4096 <= len(record.time) < 8192
    expected = readings[: 100_000 // size * size].reshape(-1, size).mean(axis=1)
    assert record.readings[: len(expected), 0] == pytest.approx(expected)
