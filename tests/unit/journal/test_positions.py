"""What the samples of a position give, and which channels never move, by written readings of two devices."""

from dataclasses import replace
from statistics import mean, stdev
from typing import Any

import pytest

from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.samples import ReadingStep
from tiltcal.drivers.model import Reading
from tiltcal.errors import InputError
from tiltcal.files.bench import BenchSensor
from tiltcal.files.procedure import Position, find_procedure
from tiltcal.journal.lines import OperatorAnswer
from tiltcal.journal.playback import Sample
from tiltcal.journal.positions import ReadingSpans, as_set, result_of

ADDRESS = "sim:columns=x,y,temperature&unit=V&sensitivity=2&low=-3&high=3"
PRINTS, COUNTS = BenchSensor("P", "serial-columns", ADDRESS, axes=("-y", "x")), BenchSensor("C", "sca100t-d02", "sim:")
X_UP = find_procedure("plane").positions[0]
LEVEL = replace(X_UP, tilt={"x": 0, "y": 0}, gravity=(0, 0, 1))
VOLTS = [0.5, 0.75, 1.0, 0.5, 0.75, 1.25]


def samples(last: float = 0.0) -> list[Sample]:
    """Six samples of both, the last reading of x by so much more."""
    rows = [(volts + last * (n == 5), 2.0 * volts) for n, volts in enumerate(VOLTS)]
    printed = [Reading(row, 20.0 + n, 0.25) for n, row in enumerate(rows)]
    return [Sample({"P": one, "C": Reading((1000.0 + n, 1024.0), None)}) for n, one in enumerate(printed)]


def test_a_position_is_what_its_samples_give_in_the_frame_of_each_sensor() -> None:
    """A step is the least that x or y takes, where no model states one; a ramp leaves out what is at a rail."""
    steps = {serial: ReadingStep() for serial in "PC"}
    stated: Any = {"left_out": 2, "takes": 3, "steps": steps}
    found = result_of([PRINTS, COUNTS], X_UP, X_UP, samples(), "then", **stated)
    printed, counted = (found.measurements[serial] for serial in "PC")
    x, y, z = X_UP.gravity
    assert (printed.gravity, printed.tilt, printed.temperature) == (pytest.approx((-y, x, z)), None, 22.5)
    assert (counted.gravity, counted.tilt, counted.temperature) == (pytest.approx(X_UP.gravity), X_UP.tilt, None)
    assert printed.noted == counted.noted == {"time": "then", "left_out": 2, "takes": 3}
    scatter = {"x": pytest.approx(stdev(VOLTS)), "y": pytest.approx(2.0 * stdev(VOLTS))}
    celsius = {"temperature": 22.5, "left_out": 2}
    assert found.values() == {
        "P": {"mean": {"x": mean(VOLTS), "y": 2.0 * mean(VOLTS)}, "std": scatter, "n": 6, **celsius},
        "C": {"mean": {"x": 1002.5, "y": 1024.0}, "std": {"x": pytest.approx(3.5**0.5), "y": 0.0}, "n": 6,
              "temperature": None, "left_out": 2},
    }  # fmt: skip
    assert found.mean("P").tolist() == [mean(VOLTS), 2.0 * mean(VOLTS)]
    stepped = found.with_steps(steps).measurements
    assert [stepped[serial].summaries["x"].resolution for serial in "PC"] == [0.25, 1.0]
    typed = result_of([PRINTS], X_UP, X_UP, samples(), "then", typed=5.0, steps=steps)
    one = typed.measurements["P"]
    assert (typed.typed, one.temperature, one.noted) == (True, 5.0, {"time": "then"})
    ramp = result_of([PRINTS], X_UP, X_UP, samples(last=1.75), "then").measurements["P"]
    assert (ramp.summaries["x"].n, ramp.temperature) == (5, 22.0)
    assert ramp.summaries["x"].mean == pytest.approx(mean(VOLTS[:5]))


@pytest.mark.parametrize(("span", "quiet"), [(0.0, 1), (0.01, 2), (0.02, None)])
def test_a_channel_that_no_position_tilts_is_quiet_at_one_value_or_two(span: float, quiet: int | None) -> None:
    """A device that states no step shows one, 0.01 V; what is at a rail is no reading."""
    spans = ReadingSpans([PRINTS, COUNTS])
    for x, y in ((1.0, 1.0), (1.0 + span, 2.0), (3.0, 1.0)):
        spans.add(Sample({"P": Reading((x, y), None, 0.01), "C": Reading((1024.0, 1024.0 + 2.0 * x))}))
    named = {} if quiet is None else {"x": quiet}
    assert spans.quiet_channels([LEVEL, LEVEL]) == {"P": named, "C": {"x": 1}}
    assert spans.quiet_channels([LEVEL, X_UP]) == {"P": named, "C": {}}  # the fixture's x is the printer's y


def test_a_position_is_as_the_operator_has_set_it() -> None:
    """A tilt that is not typed stays; a direction, and a tilt that agrees with it within 0.006°."""
    near, tilt = {"x": 30.0, "y": 2.0}, {"x": 29.5, "y": 1.0}
    asked, up = replace(X_UP, tilt=near, gravity=gravity_from_tilt(near), temperature=20.0), gravity_from_tilt(tilt)

    def answered(position: Position = asked, **said: Any) -> Position:
        return as_set(position, OperatorAnswer(answer="ready", **said))

    assert [answered(**one).temperature for one in ({}, {"temperature": 21.5})] == [20.0, 21.5]
    assert answered(X_UP, temperature=21.5) == X_UP
    assert answered(tilt={"x": 29.5}).tilt == {"x": 29.5, "y": 2.0}
    turned = answered(gravity=tuple(2.0 * one for one in up))
    assert (turned.gravity, turned.tilt) == (pytest.approx(up), None)
    for gravity in (up, asked.gravity, None):
        assert answered(gravity=gravity, tilt=tilt).gravity == pytest.approx(up)
    for wrong in (29.51, -29.5):
        with pytest.raises(InputError, match="a tilt and a gravity that contradict each other"):
            answered(gravity=up, tilt={"x": wrong, "y": 1.0})
