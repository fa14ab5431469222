"""Options that are declared once."""

import inspect

import pytest

import tiltcal
from tiltcal.bench.options import MeasureOptions, PlanOptions
from tiltcal.errors import UsageError
from tiltcal.logs.options import ApplyOptions, FitOptions
from tiltcal.options import complete, options_of


@pytest.mark.parametrize(
    ("function", "declaration"),
    [
        (tiltcal.apply_log, ApplyOptions),
        (tiltcal.Calibration.apply, ApplyOptions),
        (tiltcal.CalibrationLibrary.apply, ApplyOptions),
        (tiltcal.fit, FitOptions),
        (tiltcal.measure, MeasureOptions),
        (tiltcal.plan, PlanOptions),
    ],
)
def test_signature_and_documentation_are_those_of_the_declaration(function: object, declaration: type) -> None:
    parameters = inspect.signature(function).parameters  # type: ignore[arg-type]
    text = inspect.getdoc(function) or ""
    for name, (option, _) in options_of(declaration).items():
        assert parameters[name].default == option.default
        assert f"\n{name} : " in text
        assert option.help.split()[-1] in text


def test_an_unknown_option_and_a_wrong_value_are_refused() -> None:
    with pytest.raises(
        TypeError, match=r"no option 'uncertain' \(did you mean 'uncertainty'\?\); the options are columns,"
    ):
        complete(ApplyOptions, {"uncertain": True})
    with pytest.raises(UsageError, match="reading_noise takes 0 or a number from 1e-09"):
        complete(ApplyOptions, {"reading_noise": -1.0})
    assert complete(FitOptions, {"jig": 0.1})["columns"] == ""
