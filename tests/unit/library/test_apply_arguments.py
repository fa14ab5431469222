"""A type checker knows the arguments that ``Calibration.apply`` has at run time."""

from __future__ import annotations

import inspect
from typing import get_overloads, get_type_hints

import tiltcal
from tiltcal.library.apply_arguments import ApplyArguments


def test_they_are_those_of_apply() -> None:
    (_, frame, *arguments) = inspect.signature(tiltcal.Calibration.apply).parameters.values()
    assert frame.name == "frame"
    assert ApplyArguments.__annotations__.keys() == {argument.name for argument in arguments}
    hints = get_type_hints(tiltcal.Calibration.apply)
    for name, hint in get_type_hints(ApplyArguments).items():
        assert hints[name] == hint, name


def test_hints_of_overloads_can_be_resolved() -> None:
    for kind in (tiltcal.Calibration, tiltcal.CalibrationLibrary, tiltcal.PairCalibration):
        of_columns, of_frame = map(get_type_hints, get_overloads(kind.apply))
        assert of_columns["return"] != of_frame["return"] == of_frame["frame"]
