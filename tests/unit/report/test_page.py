"""The page of a tilt calibration says what its file says, and is a page that anyone can read, print and keep."""

import re
from dataclasses import replace
from decimal import Decimal
from functools import cache
from typing import Any

import pytest
from support import FIXTURES, WITHOUT_PRIORS
from support.golden_file import as_data, coefficients
from support.html_page import Page, undrawn

from tiltcal.calibration.wording import label
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import (
    CrossValidation,
    FileRecord,
    FitRecord,
    Hysteresis,
    LevelFit,
    PositionRecord,
    PositionSet,
    ProcedureRecord,
    Provenance,
    Reference,
    SegmentsRecord,
    SuspectPosition,
)
from tiltcal.report import sentences
from tiltcal.report.numbers import at_place, half_width, measured, three_digits
from tiltcal.report.page import tilt_page

SOURCE = FileRecord(name="S.yaml", sha256="0" * 64)


def golden(name: str) -> CalibrationRecord:
    return read_calibration(FIXTURES / f"{name}.yaml")


def page_of(calibration: CalibrationRecord, **more: Any) -> Page:
    return Page(tilt_page(calibration, SOURCE, **more))


@cache
def text_of(name: str) -> str:
    """The page of a golden file, without its figures."""
    with undrawn():
        return tilt_page(golden(name), SOURCE)


@pytest.fixture(scope="module")
def complete() -> Page:
    return Page(text_of("complete"))


def number(text: str) -> Decimal:
    return Decimal(text.replace("−", "-"))


def read(text: str) -> tuple[Decimal, Decimal]:
    """Value and standard uncertainty of ``1026.115(75)``."""
    value, brackets = text.removesuffix(")").split("(")
    return number(value), Decimal(int(brackets)).scaleb(number(value).as_tuple().exponent)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["complete", "multi-angle", "temperature-sweep", "free", "mounting", "level"])
def test_every_table_has_the_numbers_of_the_file(name: str) -> None:
    """As test_numbers.py has their digits."""
    data, page, record = as_data(name), Page(text_of(name)), golden(name)
    unit, k = record.sensor.fitted_unit, data["uncertainty"]["coverage_factor"]
    numbered = [(*label(one, unit), value, u, k.get(one)) for one, value, u in coefficients(data)]
    found = [
        [words, "".join(symbol), *cells(value, u, of, factor)] for words, _, symbol, of, value, u, factor in numbered
    ]
    assert page.below("Coefficients") == [["Quantity", "", "Value", "Unit", "95 % interval: ±", "k"], *found]
    budget, (_, sources, *shares) = data["fit"]["budget"], page.below("Uncertainty budget")
    assert {*sources} == {source.replace("adc", "ADC") for row in budget.values() for source in row}
    for row, one in zip(shares, [one for one, *_ in coefficients(data) if one in budget], strict=True):
        words, _, symbol, _ = label(one)
        stated = [f"{100 * budget[one][of]:.1f}" if of in budget[one] else "" for of in map(str.lower, sources)]
        assert row == [words, "".join(symbol), *stated]
    derived, own = data["derived"], data["derived"].get("intrinsic", {})
    turned = {"rotation_degrees": data["calibration"].get("mounting", {})}
    turned["uncertainty"] = {"rotation_degrees": data["uncertainty"].get("mounting", {}), "coverage_factor": {}}
    turned["uncertainty"]["coverage_factor"]["rotation_degrees"] = {axis: k.get(f"mounting.{axis}") for axis in ANGLES}
    for heading, section, kinds in (
        ("Cross-axis error", derived, {"cross_axis_percent": ("Cross-axis sensitivity of {}", "%"), **MISALIGNED}),
        (
            "Intrinsic parameters",
            own,
            {"offset": ("Offset of {}", unit), "sensitivity": (ALONG, f"{unit}/g"), **ANGLED},
        ),
        ("Mounting", turned, {"rotation_degrees": ("{}", "°")}),
    ):
        stated = section.get("uncertainty", {})
        expected = [
            [words.format(" and ".join(one) if len(one) == 2 else one), *cells(
                value, stated[kind].get(one), of, stated["coverage_factor"][kind].get(one)
            )]
            for kind, (words, of) in kinds.items()
            for one, value in section.get(kind, {}).items()
        ]  # fmt: skip
        if expected:
            rows = page.below(heading)[1:]
            assert rows == [[words.capitalize() if heading == "Mounting" else words, *row] for words, *row in expected]
    positions, residuals = data["positions"], dict(data["fit"]["residuals"])
    completing = data["procedure"].get(name, {}).get("positions", [])
    decimals = three_digits(v for row in residuals.values() for v in row.values())
    for number, (row, one) in enumerate(zip(page.below("Procedure and positions")[2:], positions, strict=True)):
        at, residual = data["procedure"]["set"].get(one["position"], {}), residuals.pop(one["position"], {})
        said = sentences.as_set(PositionSet(**{**at, "gravity": tuple(at["gravity"]) if "gravity" in at else None}))
        if number >= len(positions) - len(completing):
            said, residual = {"mounting": "for the mounting", "level": "level, for the offset"}[name], {}
        means = [measured(mean, one.get("u", {}).get(channel), 7) for channel, mean in one["mean"].items()]
        off = [at_place(residual[channel], decimals) if residual else "" for channel in record.sensor.channels]
        warmth = at_place(one["temperature"], 2) if "temperature" in one else ""
        assert row == [one["position"], said, warmth, str(one["n"]), *means, *off]


MISALIGNED = {"misalignment_degrees": ("Misalignment of {}", "°")}
ALONG = "Sensitivity of {} along its own direction"
ANGLED = {"angle_degrees": ("Angle between {}", "°"), "rotation_degrees": ("Rotation in the jig’s frame, {}", "°")}


def cells(value: float, u: float | None, unit: str, factor: float | None) -> list[str]:
    """Value, unit, half the interval and coverage factor of a quantity on the page."""
    interval = [half_width(factor * u), f"{factor:.2f}"] if factor and u else ["", ""]
    return [measured(value, u), unit, *interval]


class TestRecords:
    def test_the_head_says_what_was_calibrated(self, complete: Page) -> None:
        provenance = as_data("complete")["provenance"]
        ended = re.match(r"2000-01-01T(\d\d:\d\d:\d\d)\.", provenance["ended"])
        assert ended is not None
        expected = {
            "Serial number": "SIM-42",
            "Operator": provenance["operator"],
            "Software": provenance["software"],
            "Journal": provenance["journal"]["name"],
            "Journal: sha256": provenance["journal"]["sha256"],
            "SHA-256 of the file": "0" * 64,
            "Calibrated": f"2000-01-01 00:00:00 to 2000-01-01 {ended[1]} UTC",
        }
        assert complete.headings[0] == (1, "sca100t-d02 SIM-42")
        assert {name: complete.facts[name] for name in expected} == expected
        notes = [one.text for one in complete.root.find("p") if one.attributes.get("role") == "note"]
        assert notes == ["Made by the virtual bench: no real sensor was measured."]

    @pytest.mark.usefixtures("undrawn")
    def test_nothing_of_the_provenance_is_left_out_and_a_real_sensor_is_no_virtual_one(self) -> None:
        known = golden("complete")
        more = known.provenance.replaced(
            made_by="measurement", link_statistics={"damaged": 3}, segments=SegmentsRecord(found="so")
        )
        real = page_of(replace(known, provenance=more))
        assert (real.facts["Link statistics: damaged"], real.facts["Segments: found"]) == ("3", "so")
        assert real.facts["Made by"] == "measurement"
        assert not [one for one in real.root.find("p") if one.attributes.get("role") == "note"]
        assert "virtual" not in " ".join(one.text for one in real.root.find("li"))


@pytest.mark.usefixtures("undrawn")
def test_the_verdict_names_what_speaks_against_the_fit() -> None:
    known = golden("plane")
    suspects = {"x-tilt2": SuspectPosition(off_degrees=0.512, chi_square=33.0)}
    for fit, expected in (
        ({"chi_square": 2.69, "p_value": 0.26}, ["Degrees of freedom 2, uncertainty from residuals, chi-square 2.69."]),
        (
            {"chi_square": 40.1, "p_value": 2e-9, "suspect_positions": suspects},
            [
                "Chi-square 40.1 with 2 degrees of freedom (probability 2e-09) is not credible: noise, jig or",
                "Further off than the stated jig allows, the worst first: x-tilt2 (0.512°).",
            ],
        ),
    ):
        page = page_of(replace(known, fit=known.fit.replaced(degrees_of_freedom=2, **fit)))
        said = " ".join(one.text for one in page.root.find("p"))
        assert all(sentence in said for sentence in expected)
        assert ("not credible" in said) == ("not credible" in page.facts["Verdict"]) == (len(expected) > 1)


UNTURNED = "The mounting in an application: tilt is that of the sensor’s own frame."
BEYOND, COLD = "Tilts beyond the ranges above; apply flags them.", "Temperature: its effect was not measured."
STRAIGHT = "Nonlinearity: each channel is assumed linear."


@pytest.mark.parametrize(
    ("name", "absent"),
    [
        ("mounting", [BEYOND, COLD]),
        ("multi-angle", [BEYOND, COLD, UNTURNED]),
        ("free", [BEYOND, COLD, STRAIGHT, UNTURNED]),
        ("sensitivity-drift", [BEYOND, UNTURNED]),
        (
            "temperature-sweep",
            [
                "The tilt: no range of tilts was covered.",
                "Drift of the sensitivity with temperature.",
                STRAIGHT,
                "Sensitivity to z: it was not measured and counts as zero.",
                UNTURNED,
            ],
        ),
    ],
)
def test_what_is_covered_and_what_is_not(name: str, absent: list[str]) -> None:
    record, limits = golden(name), as_data(name)["limits"]
    assert list(sentences.not_covered(record)) == absent
    tilt = {f"Tilt of {axis}": f"{low:.2f} to {high:.2f}°" for axis, (low, high) in limits.get("tilt", {}).items()}
    if name == "free":
        tilt = {f"Tilt of {axis}": "-90 to 90°" for axis in "xyz"}
    low, high = next(iter(limits["reading"].values())) if isinstance(limits["reading"], dict) else limits["reading"]
    rails = ", ".join(f"{channel} {low:g} to {high:g} count" for channel in record.sensor.channels)
    warm = {"Temperature": "{:g} to {:g} °C".format(*limits["temperature"])} if "temperature" in limits else {}
    warm |= {"Reference temperature": "24 °C"} if warm else {}
    expected = {**tilt, **warm, "Readings between their rails": rails}
    found = {fact.label: fact.value for fact in sentences.covered(record)}
    assert found == {label: value.replace("-", "−") for label, value in expected.items()}
    no_jig = "The angles of the jig: none was stated, and they are not in the uncertainty."
    assert list(sentences.not_covered(read_calibration(WITHOUT_PRIORS)))[-1] == no_jig


def test_what_a_fit_says_is_there_in_whole_sentences() -> None:
    fit = FitRecord(
        jig_degrees=0.01,
        thermometer_celsius=0.1,
        misfit_rms_mg=1.23456,
        distinct_attitudes=14,
        cross_validation=CrossValidation(order=2, error_by_order={"1": 4.5678, "2": 1.02}),
        hysteresis={"x": Hysteresis(difference=-1.26, between=("a", "b"))},
        level=LevelFit(change={"x": 1.26, "y": -0.4}, change_uncertainty={"x": 0.11, "y": 0.2}, verdict="changed"),
        notes=("one",),
        warning="two",
    )
    record = replace(golden("temperature-sweep"), fit=fit)
    assert list(sentences.verdict(record)) == [
        "Stated standard uncertainty of a set angle: 0.01°.",
        "Standard uncertainty of a temperature: 0.1 °C.",
        "The misfit of the length of gravity is 1.23 mg rms in 14 attitudes.",
        "Cross-validation chose a drift of order 2; the mean square error of predicting a left-out position, over its "
        "variance, is 4.57 for order 1, 1.02 for order 2.",
        "Hysteresis of x: −1.3 count between a and b.",
        "A level position has renewed the offset: it changed in x by 1.26 ± 0.11 count and in y by −0.40 ± 0.20 count; "
        "changed.",
    ]
    assert [three_digits(some) for some in ([], [0.0], [0.0888, -0.2], [4321.0], [1e-15])] == [2, 2, 3, 0, 12]
    assert sentences.remarks(record) == ["one", "two", "assumed: sensitivity: nominal of the model"]
    for position, said in (
        (PositionSet(tilt={"x": 45.0, "y": -2.5}, heading=90.0, stage=-45.0, temperature=-5.5), TURNED),
        (PositionSet(gravity=(0.0, 0.70711, -0.70711)), "up (0, 0.707, −0.707)"),
        (PositionSet(), ""),
    ):
        assert sentences.as_set(position) == said
    table = Reference(id="7", certificate="C-1", uncertainty=0.01, due="2027-01-01")
    provenance = Provenance(references={"table": table, "thermometer": Reference(id="8", uncertainty=0.05)})
    facts = {fact.label: fact.value for fact in sentences.provenance_facts(provenance, SOURCE)}
    assert facts["Reference: table"] == "7, certificate C-1, ±0.01° (95 %), due 2027-01-01"
    assert facts["Reference: thermometer"] == "8, ±0.05 °C (95 %)"


TURNED = "x 45°, y −2.5°, heading 90°, stage −45°, −5.5 °C"


def test_markup_in_a_file_is_text() -> None:
    nasty = '<script>alert("1")</script><img src=x onerror=alert(1)>$\\frac{$'  # and mathematics
    known = golden("complete")
    calibration = replace(
        known,
        sensor=known.sensor.replaced(serial=nasty, model=nasty, unit=nasty),
        fit=FitRecord(notes=(nasty,), budget={nasty: {nasty: 1.0}}, residuals={nasty: {"x": 1.0}}),
        procedure=ProcedureRecord(name=nasty, title=nasty, set={nasty: PositionSet(tilt={"x": 1.0})}),
        positions=(PositionRecord(position=nasty, mean={"x": 1.0}, n=1),),
        provenance=Provenance(made_by=f"virtual {nasty}", operator=nasty),
    )
    page = page_of(calibration)
    assert not page.root.find("script", "img")
    assert not [one for one in page.root.find("p", "td", "text", "svg", "rect") if "onerror" in one.attributes]
    assert page.headings[0][1] == f"{nasty} {nasty}"
    assert nasty in [one.text for one in page.root.find("li")]
