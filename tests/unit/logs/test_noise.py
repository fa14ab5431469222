"""A log of a sensor at rest as evenly spaced samples."""

import numpy as np
import pytest

import tiltcal
from tiltcal.core.noise import AllanFit, Average, ChannelNoise, NoiseScale
from tiltcal.errors import InputError
from tiltcal.logs.noise import Pace, SensorNoise, evenly_spaced


def paced(times: list[float]) -> tuple[Pace, list[float]]:
    """The pace of rows with the readings 0, 1, 2, ..., and these at even distances."""
    (samples,), pace = evenly_spaced([np.arange(float(len(times)))], np.array(times), "log.csv")
    return pace, samples.tolist()


def test_a_gap_is_filled_with_what_is_missing() -> None:
    pace, samples = paced([0.0, 0.5, 1.0, 3.0, 3.5])
    assert samples == pytest.approx([0, 1, 2, np.nan, np.nan, np.nan, 3, 4], nan_ok=True)
    assert pace == Pace(interval=0.5, rows=5, gaps=1, lost=3)
    assert paced([100.0, 101, 102, 103, 104, 0, 1, 2, 3, 4])[0] == Pace(interval=1.0, rows=10, gaps=1, lost=1)
    # A row is late from one and a half intervals on, and the millisecond to which times may be written.
    for late, lost in ((3.5, 0), (3.501, 0), (3.502, 1), (4.4, 1), (4.6, 2)):
        assert paced([0.0, 1.0, 2.0, late])[0].lost == lost


def test_a_row_without_a_time_keeps_its_place() -> None:
    pace, samples = paced([0, 1, 2, np.nan, 4, 5, 8])
    assert samples == pytest.approx([0, 1, 2, 3, 4, 5, np.nan, np.nan, 6], nan_ok=True)
    assert pace == Pace(interval=1.0, rows=7, gaps=1, lost=2)


def test_jitter_and_times_to_the_millisecond_are_no_gaps() -> None:
    assert paced([k * 0.01 + (0.004 if k % 3 else 0.0) for k in range(300)])[0].gaps == 0
    for rate in (400.0, 714.0, 1000.0, 2500.0):
        pace, _ = paced([round(5 + k / rate, 3) for k in range(5000)])
        assert pace.gaps == 0, rate
        assert pace.interval == pytest.approx(1.0 / rate, rel=1e-3)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([3.0, 2.0, 1.0], "goes back at row 1"),
        ([0.0, 0.0, 0.0], "do not change"),
        ([np.nan, np.nan], "no row has a time"),
        ([0.0], "no two rows"),
        (
            [start + k * 0.01 for start in (0, 1_767_000_000) for k in range(1000)],
            r"leaps by 1\.767e\+09 s at row 1000: cut the log there, or state rate HZ",
        ),
    ],
)
def test_times_that_show_no_pace(times: list[float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        paced(times)


def test_times_to_the_second_are_those_of_faster_rows() -> None:
    """A logger that writes whole seconds at 100 Hz: no row is lost between two of them."""
    columns, pace = evenly_spaced([np.arange(1000.0)], np.repeat(np.arange(10.0), 100), "log.csv")
    assert (len(columns[0]), pace.gaps) == (1000, 0)
    assert pace.interval == pytest.approx(9.0 / 999.0)
    assert tiltcal.noise({"x": np.random.default_rng(1).normal(size=64)}, rate=1.0).channels["x"].count == 64


def channel(sigma: float, follows: bool, step: float, **terms: float) -> ChannelNoise:
    """Independent samples each 10 ms, of which averages of a hundred scatter half as much again."""
    tau, sizes = 0.01 * 2.0 ** np.arange(9), ((1, sigma), (10, sigma / 10**0.5), (100, 0.15 * sigma))
    averages = [Average(n, 5000 // n, 1024.0, std, 5.0 * sigma / n**0.5) for n, std in sizes]
    allan, fit = sigma * np.sqrt(0.01 / tau), AllanFit(terms, 0, np.full(9, 40.0), follows)
    return ChannelNoise(1024.0, 5000, step, averages, tau, allan, 0.9 * allan, 1.2 * allan, fit)


WORDS = """\
5000 samples of x, y, 0.01 s apart (100 Hz), 50.03 s
     samples  averages     std [count]    if white   range [count]     std [°]   range [°]
x          1      5000             0.6         0.6               3       0.042        0.21
          10       500          0.1897      0.1897          0.9487      0.0133      0.0664
         100        50            0.09        0.06             0.3      0.0063       0.021
y          1      5000             0.9         0.9             4.5
          10       500          0.2846      0.2846           1.423
         100        50           0.135        0.09            0.45

x   white noise 0.0849 count/√Hz (0.104 mg/√Hz, 0.00594 °/√Hz)
    bias instability not reached: below 0.045 count (0.0549 mg, 0.00315 °) after 2.56 s
    step 1 count, of which averaging leaves 0.0012 count
y   white noise 0.127 count/√Hz
    flicker noise at any time 0.0133 count
    random walk 0.03 count/√s
    drift 0.04 count/s
    bias instability 0.0563 count at 2.56 s

measure --samples 256: a position takes 2.56 s at this pace
  its mean is uncertain by x 0.0375 count (0.0458 mg, 0.00262 °), y 0.0563 count
  y: the longest that this record supports; more samples still help: record longer
  samples by the range of averages: x 18, y 100
  degrees of an axis near level, by the nominal sensitivity of sca100t-d02"""


def test_noise_is_told_in_whole_words() -> None:
    """√2 times 0.06 count√s are 0.0849 count/√Hz, of 819 count/g 0.104 mg; 0.9 count over √256 are 0.0563."""
    channels = {"x": channel(0.6, True, 1.0, N=0.06), "y": channel(0.9, False, 0.0, N=0.09, B=0.02, K=0.03, R=0.04)}
    scale = NoiseScale("count", {"x": 819.0}, "nominal sensitivity of sca100t-d02")
    moved, stuck, pace = [(100, 250), (400, 420)], (500, 600), Pace(0.01, 5000, gaps=1, lost=3)
    found = SensorNoise(pace, channels, {"y": 2}, 1, moved, stuck, scale, 0.05, ["said before"])
    assert str(found) == WORDS
    assert found.remarks == [
        "said before",
        "it was not still: moved or knocked from 1 to 2.5 s, and 1 times more; the numbers are of noise and motion "
        "together: take a record at rest, or its rows at rest",
        "the readings were stuck from 5 to 6 s: no channel changed",
        "1 gap in its times, 3 rows long",
        "y is missing in 2 rows",
        "y: no sum of white noise, flicker noise, random walk and drift follows its Allan deviation; a vibration may "
        "be in it, or a filter",
    ]
    per = np.degrees(1.0 / 819.0)
    of_x = {"samples": 1, "limit": "target", "samples_by_range": 18, "met": True}
    of_x |= {
        "uncertainty": pytest.approx(0.0375, rel=1e-3),
        "uncertainty_degrees": pytest.approx(0.0375 * per, rel=1e-3),
    }
    of_y = {
        "samples": 256,
        "limit": "record",
        "samples_by_range": 100,
        "met": None,
        "uncertainty": pytest.approx(0.05625),
    }
    advice = {"samples": 256, "seconds": 2.56, "channel": "y", "limit": "record", "target_degrees": 0.05, "met": True}
    told = found.as_data()
    x, y = (told["channels"].pop(name) for name in "xy")
    tau, sizes = 0.01 * 2.0 ** np.arange(9), 0.6 / np.sqrt([1.0, 10.0, 100.0 / 2.25])
    allan = np.stack([tau, 0.06 / np.sqrt(tau), 0.054 / np.sqrt(tau), 0.072 / np.sqrt(tau), np.full(9, 40.0)], axis=1)
    assert np.array([[*row.values()] for row in x.pop("allan")]) == pytest.approx(allan)
    assert [row["std_degrees"] for row in x["averages"]] == pytest.approx(sizes * per)
    assert [row["averages"] for row in x.pop("averages")] == [5000, 500, 50]
    lowest = {"reached": False, "tau": 2.56, "deviation": 0.0375, "deviation_degrees": 0.0375 * per}
    assert x.pop("bias_instability") == pytest.approx(lowest | {"coefficient": 0.0375 * np.sqrt(np.pi / np.log(4.0))})
    assert (x.pop("noise_density"), x.pop("rounding")) == ({"value": 0.06 * 2.0**0.5}, found.channels["x"].rounding)
    none = dict.fromkeys(("flicker", "bias_random_walk", "drift"))
    assert x == {"mean": 1024.0, "samples": 5000, "step": 1.0, "velocity_random_walk": {"value": 0.06}} | none
    assert [y[name] for name in ("step", *none)] == [None, {"value": 0.02}, {"value": 0.03}, {"value": 0.04}]
    assert told == {
        "samples": 5000, "interval": 0.01, "seconds": 50.03, "gaps": {"count": 1, "rows": 3}, "missing": {"y": 2},
        "bad_rows": 1, "moved": [[1.0, 2.5], [4.0, 4.2]], "hung": [5.0, 6.0], "remarks": found.remarks, "unit": "count",
        "sensitivity": {"source": "nominal sensitivity of sca100t-d02", "x": 819.0}, "channels": {},
        "recommendation": advice | {"channels": {"x": of_x, "y": of_y}},
    }  # fmt: skip
