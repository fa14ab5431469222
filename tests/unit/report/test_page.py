"""The page of a tilt calibration says what its file says, and is a page that anyone can read, print and keep."""

import re
from dataclasses import replace
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support import FIXTURES, WITHOUT_PRIORS
from support.html_page import Page, undrawn

from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.wording import label
from tiltcal.files.calibration import CalibrationRecord, read_calibration
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
from tiltcal.report.page import tilt_page

SOURCE = FileRecord(name="S.yaml", sha256="0" * 64)


def golden(name: str) -> CalibrationRecord:
    return read_calibration(FIXTURES / f"{name}.yaml")


def as_data(name: str) -> dict[str, Any]:
    """A golden file, read by another reader than ours."""
    data: dict[str, Any] = yaml.safe_load((FIXTURES / f"{name}.yaml").read_text(encoding="utf-8"))
    return data


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


def test_every_coefficient_has_its_value_uncertainty_and_interval() -> None:
    for name in ("complete", "multi-angle", "temperature-sweep", "free"):
        data, shown = as_data(name), Page(text_of(name))
        rows = {row[0]: row[1:] for row in shown.below("Coefficients")}
        checked = 0
        for dotted, value, u in coefficients(data):
            if not u:
                assert number(rows[label(dotted).words][1]) == Decimal(repr(value)).normalize()
                continue
            _, shown_value, _, half, factor = rows[label(dotted).words]
            mean, bracket = read(shown_value)
            assert bracket == Decimal(f"{u:.1e}"), dotted
            assert abs(mean - Decimal(repr(value))) * 2 <= Decimal(1).scaleb(bracket.adjusted() - 1), dotted
            k = data["uncertainty"]["coverage_factor"][dotted]
            assert Decimal(half) == Decimal(f"{k * u:.1e}")
            assert float(factor) == pytest.approx(k, abs=0.00501)
            checked += 1
        assert checked == len(data["uncertainty"]["covariance"]["parameters"])


def coefficients(data: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Name, value and uncertainty of all that the section ``calibration`` holds, but the mounting."""
    section, u = data["calibration"], data["uncertainty"]
    found = [(f"offset.{c}", v, u["offset"][c]) for c, v in section["offset"].items()]
    for c, row in section["sensitivity"].items():
        found += [(f"sensitivity.{c}.{axis}", v, u["sensitivity"][c][axis]) for axis, v in row.items()]
    for c, row in section.get("nonlinearity", {}).items():
        found += [(f"nonlinearity.{c}.{k}", v, u["nonlinearity"][c][k - 2]) for k, v in enumerate(row, start=2)]
    for what in ("offset", "sensitivity"):
        for c, row in section.get("temperature", {}).get(what, {}).items():
            doubts = u["temperature"].get(what, {}).get(c, [0.0] * len(row))
            found += [(f"temperature.{what}.{c}.{k + 1}", v, doubts[k]) for k, v in enumerate(row)]
    return found


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

    def test_positions_are_there_as_they_were_set_and_measured(self, complete: Page) -> None:
        data = as_data("complete")
        rows = complete.below("Procedure and positions")[2:]
        assert [row[0] for row in rows] == [one["position"] for one in data["positions"]]
        assert [row[1] for row in rows][:3] == ["x 45°", "x −45°", "y 45°"]
        assert rows[4][1] == "up (0, 0, −1)"
        for row, record in zip(rows, data["positions"], strict=True):
            for channel, cell in zip("xy", row[4:6], strict=True):
                assert read(cell)[1] == Decimal(f"{record['u'][channel]:.1e}")
            residual = data["fit"]["residuals"][record["position"]]
            assert [float(number(cell)) for cell in row[6:]] == pytest.approx([residual["x"], residual["y"]], abs=6e-4)

    def test_the_budget_has_the_shares(self, complete: Page) -> None:
        budget = as_data("complete")["fit"]["budget"]
        head, names, *rows = complete.below("Uncertainty budget")
        assert head[-1] == "Share of the variance / %"
        shares = {row[0]: row[2:] for row in rows}
        stated, sources = budget["sensitivity.x.z"], [name.lower() for name in names]
        assert shares["Sensitivity of x to z"] == [f"{100 * stated[s]:.1f}" if s in stated else "" for s in sources]
        assert len(rows) == len(budget)

    def test_derived_quantities(self, complete: Page) -> None:
        derived = as_data("complete")["derived"]
        rows = {row[0]: row[1:] for row in complete.below("Cross-axis error")}
        value, u = read(rows["Cross-axis sensitivity of y"][0])
        assert value == round(Decimal(repr(derived["cross_axis_percent"]["y"])), 3)
        assert u == Decimal(f"{derived['uncertainty']['cross_axis_percent']['y']:.1e}")
        assert rows["Misalignment of x"][1] == "°"

    def test_positions_that_were_not_fitted_say_what_they_are_for(self) -> None:
        for name, said in (("mounting", "for the mounting"), ("level", "level, for the offset")):
            rows = Page(text_of(name)).below("Procedure and positions")[2:]
            completing = as_data(name)["procedure"][name]["positions"]
            assert [row[1] for row in rows[-len(completing) :]] == [said] * len(completing)
            assert said not in [row[1] for row in rows[: -len(completing)]]

    def test_mounting_and_intrinsic_parameters(self) -> None:
        mounted, stated = Page(text_of("mounting")).below("Mounting"), as_data("mounting")
        for row, angle in zip(mounted[1:], ("roll", "pitch", "yaw"), strict=True):
            self.assert_told(row[1], stated["calibration"]["mounting"][angle], stated["uncertainty"]["mounting"][angle])
        free, own = Page(text_of("free")), as_data("free")["derived"]["intrinsic"]
        rows = {row[0]: row[1] for row in free.below("Intrinsic parameters")}
        told = rows["Angle between x and z"]
        self.assert_told(told, own["angle_degrees"]["xz"], own["uncertainty"]["angle_degrees"]["xz"])
        assert any("undetermined" in one.text for one in free.root.find("p"))

    @staticmethod
    def assert_told(text: str, value: float, u: float) -> None:
        mean, brackets = read(text)
        assert brackets == Decimal(f"{u:.1e}")
        assert abs(float(mean) - value) <= 0.06 * u


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


class TestAnyFile:
    """Only sensor and calibration are needed."""

    def test_markup_in_a_file_is_text(self, tmp_path: Path) -> None:
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


@pytest.mark.usefixtures("undrawn")
class TestDrift:
    def test_what_changed_is_named_and_marked(self, tmp_path: Path) -> None:
        before = golden("plane")
        offset = before.coefficients.offset + np.array([15.0, 0.0])
        after = replace(before, coefficients=replace(before.coefficients, offset=offset))
        page = page_of(after, earlier=[(before, "spring.yaml")])
        rows = {row[0]: row for row in page.below("Change since earlier calibrations")}
        (offset,) = (one for one in compare_records(before, after).changes if one.name == "offset.x")
        assert float(number(rows["Offset of x"][-1])) == pytest.approx(offset.ratio, rel=1e-3)
        assert read(rows["Offset of x"][4])[0] == Decimal("15.0")
        assert read(rows["Offset of y"][4])[0] == 0
        assert any(one.text.startswith("Changed: offset.x by more than") for one in page.root.find("p"))
        marked = [row.find("th")[0].text for row in page.root.find("tr") if row.attributes.get("class") == "mark"]
        assert marked == ["Offset of x"]
