"""The figures show what their files and logs hold: their lines, marks and words as matplotlib has them."""

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import ErrorbarContainer
from support import FIXTURES
from support.html_page import drawings

from tiltcal.calibration.season import CalibrationFolder, fleet_history
from tiltcal.calibration.tilt_uncertainty import tilt_uncertainty
from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.flags import FLAGS, REASONS
from tiltcal.core.model import Limits
from tiltcal.core.noise import NoiseScale, characterise
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.report.calibration_figures import draw_tilt_error, residual_figure, temperature_figure, tilt_figure
from tiltcal.report.figure import SvgFigure
from tiltcal.report.record_figures import (
    PairDrawing,
    ReportedLog,
    change_figure,
    distribution_figure,
    draw_matching,
    draw_noise,
    log_figure,
)
from tiltcal.report.tables import Column, Table, angle_table, distribution_table, flag_table

INK, GREY, BLUE, RED, GREEN = "#000000", "#8a8a8a", "#1f6f8b", "#c0504d", "#4f6228"
LOOKS = {"x": (BLUE, "o", "-"), "y": (RED, "s", "--"), "z": (GREEN, "^", ":")}


def looks(panel: Any) -> list[tuple[Any, ...]]:
    """Label, colour, line and mark of each line of a panel."""
    shown = [(str(one.get_label()), one) for one in panel.lines]
    return [
        ("" if label.startswith("_") else label, to_hex(one.get_color()), one.get_linestyle(), one.get_marker())
        for label, one in shown
    ]


def drawn(panel: Any) -> list[np.ndarray[Any, Any]]:
    """x and y of each line of a panel, shape (2, n)."""
    return [np.array([one.get_xdata(orig=False), one.get_ydata()], float) for one in panel.lines]


def bars(panel: Any) -> list[np.ndarray[Any, Any]]:
    """The ends of the error bars of each series of a panel, shape (n, 2, 2)."""
    series = [one for one in panel.containers if isinstance(one, ErrorbarContainer)]
    return [np.array(one.lines[2][0].get_segments()) for one in series]


def bands(panel: Any) -> list[np.ndarray[Any, Any]]:
    """x, and the limits of y there, of each band of a panel, shape (n, 3)."""
    found = []
    for one in panel.collections:
        if isinstance(one, FillBetweenPolyCollection):
            x, y = np.transpose(one.get_paths()[0].vertices)
            at = np.unique(x)
            found.append(np.array([(place, y[x == place].min(), y[x == place].max()) for place in at]))
    return found


Line = tuple[str, str, str, str, Any, Any]


def require_lines(panel: Any, *lines: Line) -> None:
    """Compare the lines of a panel: label, colour, line and mark, and x and y."""
    assert looks(panel) == [line[:4] for line in lines]
    for (*_, x, y), found in zip(lines, drawn(panel), strict=True):
        np.testing.assert_allclose(found, [x, y], rtol=1e-9, atol=1e-12)


def words(panel: Any) -> tuple[str, str]:
    return panel.get_xlabel(), panel.get_ylabel()


def pictured(made: Any, name: str) -> tuple[SvgFigure, list[Any]]:
    """A figure of a page, and its panels."""
    with drawings() as kept:
        shown = made()
    assert list(kept) == [name]
    assert f'<desc id="{name}-description">' in shown.svg
    return shown, kept[name].axes


def golden(name: str) -> tuple[CalibrationRecord, dict[str, Any]]:
    path = FIXTURES / f"{name}.yaml"
    return read_calibration(path), yaml.safe_load(path.read_text(encoding="utf-8"))


def test_the_error_of_the_tilt() -> None:
    for name, known in (("complete", True), ("free", True), ("plane", False)):
        record, _ = golden(name)
        if not known:
            record = replace(record, sensor=record.sensor.replaced(model="own"), limits=Limits())
        curves = tilt_uncertainty(record)
        shown, panels = pictured(lambda record=record, curves=curves: tilt_figure(record, curves), "tilt")
        assert [words(one) for one in panels] == [
            *([("tilt [°]", "error, data sheet [°]")] * known),
            ("tilt [°]", "95 % interval, calibrated: ± [°]"),
        ]
        pairs = (
            line
            for axis, one in curves.items()
            for line in (
                (f"tilt of {axis}", *look(axis, ""), one.tilt, one.alone),
                ("", *look(axis, ""), one.tilt, one.reading),
            )
        )
        require_lines(panels[-1], *pairs)
        thick, thin = panels[-1].lines[:2]
        assert thick.get_linewidth() > 2.0 * thin.get_linewidth() > 0.5
        assert panels[-1].get_ylim()[0] == 0.0
        assert known or curves["x"].tilt[[0, 60, 120]] == pytest.approx([-30.0, 0.0, 30.0], abs=1e-9)
        largest = max(float(curve.alone.max()) for curve in curves.values())
        assert f"at most {largest:.2g}° over the range" in shown.svg
        assert shown.caption.startswith("Left: error" if known else "Half the 95 %")
        unknown = "There is no error before: no data sheet of a model own is known. No range of tilts was covered: ±30°"
        assert (unknown in shown.caption) != known
        if known:
            raw = (("", *look(axis, ""), curve.tilt, curve.before) for axis, curve in curves.items())
            require_lines(panels[0], *raw, ("", INK, "-", "None", [0, 1], [0, 0]))
        if name == "complete":  # from 1024 counts and 819 counts/g of the data sheet to what the sensor reads at -45°
            read = record.coefficients.predict(np.array([[-np.sqrt(0.5), 0.0, np.sqrt(0.5)]]))[0, 0]
            assert curves["x"].before[0] == pytest.approx(
                np.degrees(np.arcsin((read - 1024.0) / 819.0)) + 45.0, abs=1e-3
            )


def look(channel: str, mark: str) -> tuple[str, str, str]:
    """Colour, line and mark of a channel: of a curve, or of marks."""
    colour, own, line = LOOKS[channel]
    return (colour, "None", own) if mark else (colour, line, "None")


@pytest.mark.parametrize("name", ["complete", "mounting", "temperature-sweep", "free"])
def test_residuals_of_positions(name: str) -> None:
    record, data = golden(name)
    residuals, shown_for = data["fit"]["residuals"], data["sensor"]["channels"]
    shown, panels = pictured(lambda: residual_figure(record), "residuals")
    unit = record.sensor.fitted_unit
    u = {one["position"]: one.get("u", {}) for one in reversed(data["positions"])}
    assert [words(one) for one in panels] == [(f"residual of {channel} [{unit}]", "") for channel in shown_for]
    assert [one.get_text() for one in panels[0].get_yticklabels()] == list(residuals)
    assert panels[0].get_ylim() == (len(residuals) - 0.4, -0.6)
    assert panels[0].figure.get_size_inches().tolist() == [6.85, 0.75 + 0.155 * len(residuals)]
    for panel, channel in zip(panels, shown_for, strict=True):
        values = [row[channel] for row in residuals.values()]
        half = [1.959964 * u[position].get(channel, 0.0) for position in residuals]
        rows, marks = np.arange(len(values)), drawn(panel)[1:]
        np.testing.assert_array_equal(marks, np.reshape(np.transpose([values, rows]), (-1, 2, 1)))
        expected = [
            [[value - one, row], [value + one, row]] for value, one, row in zip(values, half, rows, strict=True)
        ]
        np.testing.assert_allclose(np.concatenate(bars(panel)), expected, rtol=1e-6)
        assert {one[1:] for one in looks(panel)[1:]} == {(LOOKS[channel][0], "-", LOOKS[channel][1])}
        assert drawn(panel)[0][0].tolist() == [0.0, 0.0]
        stems = [one.get_segments()[0].tolist() for one in panel.collections if to_hex(one.get_color()[0]) == GREY]
        assert stems == [[[0.0, row], [value, row]] for value, row in zip(values, rows, strict=True)]
        assert f"channel {channel}: none beyond {max(map(abs, values)):.3g}" in shown.svg


@pytest.mark.parametrize("name", ["complete", "temperature-sweep", "sensitivity-drift"])
def test_the_drift_over_temperature(name: str) -> None:
    """The polynomials of the file with their bands, and the positions around those of the offset."""
    record, data = golden(name)
    section, u, unit = data["calibration"], data["uncertainty"], record.sensor.fitted_unit
    thermal, channels, fitted = section["temperature"], data["sensor"]["channels"], data["fit"]["residuals"]
    shown, panels = pictured(lambda: temperature_figure(record), "temperature")
    gains = "sensitivity" in thermal
    assert [words(one) for one in panels] == [
        *(("" if gains else "temperature [°C]", f"offset of {channel} [{unit}]") for channel in channels),
        *(("temperature [°C]", f"sensitivity of {channel} [%]") for channel in channels if gains),
    ]
    low, high = data["limits"]["temperature"]
    assert f"from {low:.3g} to {high:.3g} °C" in shown.svg
    assert panels[0].figure.get_size_inches()[1] == (4.05 if gains else 2.2)
    t = np.linspace(low, high, 81)
    points = {one["position"]: one["temperature"] for one in data["positions"] if one["position"] in fitted}

    def offset(channel: str, at: Any) -> Any:
        powers = enumerate(thermal["offset"][channel], 1)
        return section["offset"][channel] + sum(c * (at - thermal["reference"]) ** k for k, c in powers)

    for panel, channel in zip(panels, channels, strict=False):
        at, residual = np.array([(one, fitted[position][channel]) for position, one in points.items()]).T
        measured, colour = offset(channel, at) + residual, LOOKS[channel][0]
        require_lines(
            panel,
            ("", colour, "-", "None", t, offset(channel, t)),
            ("", GREY, "-", "None", at, measured),
            ("", *look(channel, "mark"), at, measured),
            ("", GREY, ":", "None", [thermal["reference"]] * 2, [0, 1]),
        )
        half, middle = widths(panel, thermal["reference"])
        factor = u["coverage_factor"][f"offset.{channel}"]
        assert half == pytest.approx(factor * u["offset"][channel], rel=0.02)
        assert middle == pytest.approx(section["offset"][channel], rel=1e-3)
    for panel, channel in zip(panels[2:], channels, strict=False):
        (gain,) = thermal["sensitivity"][channel]
        np.testing.assert_allclose(drawn(panel)[0], [t, 100.0 * gain * (t - thermal["reference"])], atol=1e-12)
        factor = u["coverage_factor"][f"temperature.sensitivity.{channel}.1"]
        half, middle = widths(panel, high)
        distance = 100.0 * (high - thermal["reference"])
        assert half == pytest.approx(factor * u["temperature"]["sensitivity"][channel][0] * abs(distance), rel=1e-3)
        assert middle == pytest.approx(gain * distance, rel=1e-6)


def widths(panel: Any, at: float) -> tuple[float, float]:
    """Half the width and the middle of the band of a panel, at the temperature that is nearest."""
    (band,) = bands(panel)
    _, low, high = band[np.argmin(np.abs(band[:, 0] - at))]
    return (high - low) / 2.0, (high + low) / 2.0


def test_what_a_log_holds() -> None:
    """Rows of which some are suspect and one is lost, one by one, and the numbers of the figure and of its words."""
    angles = np.array([[0.0, 5.0], [1.5, 5.1], [np.nan, np.nan], [-3.25, 5.2], [2.0, 5.3]])
    overview = ColumnStatistics(("tilt_x", "roll"))
    time = 1767225600.0 + np.array([0.0, 90.0, 180.0, 270.0, 360.0])
    overview.add(time, angles, np.array([1, 3, 9, 1, 1]), np.array([0, 8, 32, 0, 0]))
    shown, panels = pictured(lambda: log_figure(ReportedLog("a.csv", "", overview, timed=True), 1), "log1")
    (first, histogram, second, _, strip, _) = panels
    least_mean_most = [("Tilt of x", "−3.250", "0.062", "2.000"), ("Roll", "5.000", "", "5.300")]
    assert shown_cells(angle_table(overview)) == least_mean_most
    counts = [("Flag", FLAGS, {1: 3, 3: 1, 9: 1}), ("Reason", REASONS, {8: 1, 32: 1})]
    assert shown_cells(flag_table(overview)) == [
        (f"{kind} {code}", said[code], str(count), f"{20 * count}.000")
        for kind, said, found in counts
        for code, count in found.items()
    ]
    minutes = np.array([0.0, 1.5, 3.0, 4.5, 6.0])
    assert "5 rows; tilt of x from −3.250° to 2.000°; roll from 5.000° to 5.300°." in shown.svg
    assert (shown.svg.count("Tilt over time in a.csv"), panels[0].figure.get_size_inches()[1]) == (1, 0.55 + 2.3)
    for panel, name, column in ((first, "tilt of x", angles[:, 0]), (second, "roll", angles[:, 1])):
        assert words(panel) == ("", f"{name} [°]")
        require_lines(panel, ("", BLUE, "None", ".", minutes, column))
    (patch,) = histogram.patches
    steps = patch.get_data()
    np.testing.assert_array_equal(steps.values, np.histogram(angles[np.isfinite(angles[:, 0]), 0], steps.edges)[0])
    assert (len(steps.values), patch.orientation) == (48, "horizontal")
    assert histogram.get_ylim() == first.get_ylim()
    assert histogram.get_xlim()[0] == 0.0
    assert words(strip) == ("time from 2026-01-01 00:00:00 UTC [min]", "")
    assert [one.get_text() for one in strip.get_yticklabels()] == ["flags"]
    flagged = [(to_hex(one.get_color()[0]), [row.tolist() for row in one.get_segments()]) for one in strip.collections]
    assert flagged == [(GREY, [[[1.5, 0.0], [1.5, 0.45]]]), (RED, [[[3.0, 0.0], [3.0, 1.0]]])]
    assert strip.get_ylim() == (0.0, 1.0)


@pytest.mark.parametrize(
    ("times", "timed", "said", "last"),
    [
        ([5.0, 305.0], True, "time from the first row [s]", 300.0),
        ([0.0, 330.0], True, "time from the first row [min]", 5.5),
        ([0.0, 14400.0], True, "time from the first row [min]", 240.0),
        ([0.0, 14760.0], True, "time from the first row [h]", 4.1),
        ([np.nan, 345600.0], True, "time from the first row [s]", 0.0),
        ([0.0, 345600.0], True, "time from the first row [h]", 96.0),
        ([0.0, 432000.0], True, "time from the first row [d]", 5.0),
        ([0.0, 1.0], False, "row", 1.0),
    ],
)
def test_the_clock_of_a_log(times: list[float], timed: bool, said: str, last: float) -> None:
    overview = ColumnStatistics(("tilt_x",))
    overview.add(np.array(times), np.ones((2, 1)), np.array([1, 1]), np.array([0, 0]))
    _, panels = pictured(lambda: log_figure(ReportedLog("a.csv", "", overview, timed), 2), "log2")
    assert words(panels[2])[0] == said
    assert drawn(panels[0])[0][0][-1] == last


def shown_cells(table: Table) -> list[tuple[str, ...]]:
    return [tuple(re.sub("<.*?>", "", cell) for cell, _ in row) for row in table.rows]


def test_a_share_of_rows_is_never_rounded_to_none_or_all_and_a_short_table_is_kept_on_one_page() -> None:
    overview = ColumnStatistics(("tilt_x",))
    flags = np.append(np.ones(300_000, int), 3)
    overview.add(np.arange(300_001.0), np.zeros((300_001, 1)), flags, np.zeros(300_001, int))
    assert [row[2:] for row in shown_cells(flag_table(overview))] == [("300\u202f000", "99.999"), ("1", "0.001")]
    assert [Table([Column("", ["x"] * rows)], style="wide").classes for rows in (16, 17)] == ["wide keep", "wide"]


def test_many_rows_are_a_band() -> None:
    overview = ColumnStatistics(("tilt_x",))
    overview.add(np.arange(101.0), np.linspace(0.0, 1.0, 101)[:, None], np.ones(101, int), np.zeros(101, int))
    _, panels = pictured(lambda: log_figure(ReportedLog("a.csv", "", overview, timed=False), 1), "log1")
    assert not panels[0].lines
    np.testing.assert_allclose(bands(panels[0]), [np.transpose([np.arange(101.0), *[np.linspace(0.0, 1.0, 101)] * 2])])


def test_the_allan_deviation(tmp_path: Path) -> None:
    """Each channel with its kinds of noise, and degrees beside the one whose sensitivity is known."""
    draw = np.random.default_rng(4).normal(size=(2, 5000))
    noises = {"x": characterise(draw[0], 0.01), "y": characterise(np.cumsum(draw[1]) * 0.02 + draw[0], 0.01)}
    with drawings() as kept:
        draw_noise(tmp_path / "noise.svg", noises, NoiseScale("V", {"x": 2.0}))
    first, second, beside = kept["tiltcal"].axes
    assert kept["tiltcal"].get_size_inches().tolist() == [8.0, 8.2]
    names = {"N": ("white noise", "--"), "B": ("flicker noise", ":"), "K": ("random walk", "-."), "R": ("drift", "-")}
    for panel, (channel, noise) in zip((first, second), noises.items(), strict=True):
        assert words(panel) == ("averaging time [s]" if channel == "y" else "", f"Allan deviation of {channel} [V]")
        tau = np.geomspace(noise.tau[noise.terms.first], noise.tau[-1], 200)
        parts = noise.terms.parts(tau)
        follows = "fitted" if noise.terms.follows else "which does not follow it"
        kinds = [(*names[kind], part) for kind, part in parts.items()] if len(parts) > 1 else []
        whole = "sum" if kinds else names[next(iter(parts))][0]
        total = np.sqrt(sum(part**2 for part in parts.values()))
        require_lines(
            panel,
            *((name, GREY, dashes, "None", tau, part) for name, dashes, part in kinds),
            (f"{whole}, {follows}", RED, "-", "None", tau, total),
            ("", BLUE, "None", "o", noise.tau, noise.deviation),
        )
        limits = np.stack([noise.low, noise.high], axis=1)
        np.testing.assert_allclose(bars(panel)[0][:, :, 1], limits)
        assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
        assert panel.get_ylim() == pytest.approx((limits.min() / 1.6, limits.max() * 1.6))
        assert all(line.get_visible() for line in panel.get_xgridlines())
        assert panel.get_legend().get_texts()[-1].get_text() == "measured, 95 %"
    assert words(beside)[1] == "near level [°]"
    assert beside.get_ylim() == pytest.approx(np.degrees(np.array(first.get_ylim()) / 2.0))
    assert (beside.get_yscale(), beside.spines["right"].get_visible()) == ("log", True)


def test_the_spectra_of_a_pair_and_the_course_of_its_estimates(tmp_path: Path) -> None:
    frequency, density = np.array([0.0, 0.1, 0.2]), np.array([9.0, 4.0, 0.25])
    densities = {"a1": density, "sum after p": 2 * density, "sum after p and q": 3 * density}
    course = [(0.5, 0.1, 0.3, 0.2), (0.2, 0.1, 0.25, 0.15), (0.1, 0.1, 0.2, 0.101)]
    drawing = PairDrawing(frequency, densities, 0.125, "Hz", course, 0.05)
    with drawings() as kept:
        draw_matching(tmp_path / "pair.svg", drawing)
    spectra, turns = kept["tiltcal"].axes
    assert kept["tiltcal"].get_size_inches().tolist() == [8.0, 8.0]
    assert (words(spectra), words(turns)) == (
        ("frequency [Hz]", "amplitude density [reading/√(Hz)]"), ("turns", "distance from the end")
    )  # fmt: skip
    colours = zip(densities, (GREY, RED, BLUE), (1.0, 2.0, 3.0), strict=True)
    require_lines(
        spectra,
        ("spin frequency", INK, ":", "None", [0.125, 0.125], [0, 1]),
        *((name, colour, "-", "None", [0.1, 0.2], np.sqrt(k * density[1:])) for name, colour, k in colours),
    )
    away = np.abs(np.array(course) - [0.2, 0.101, 0.2, 0.101])
    series = ("p, loops", RED, "-"), ("q, loops", RED, "--"), ("p, recursive", BLUE, "-"), ("q, recursive", BLUE, "--")
    away = np.maximum(away, 0.01).T
    require_lines(
        turns,
        *((*one, "None", [1, 2, 3], distance) for one, distance in zip(series, away, strict=True)),
        ("stated uncertainty", INK, ":", "None", [0, 1], [0.05, 0.05]),
    )
    assert turns.get_ylim()[0] == 0.01
    with drawings() as kept:
        draw_matching(tmp_path / "pair.svg", PairDrawing(frequency, densities, 0.125, "1/row"))
    (spectra,) = kept["tiltcal"].axes
    assert words(spectra) == ("frequency [1/row]", "amplitude density [reading/√(1/row)]")


def test_a_fleet(tmp_path: Path) -> None:
    """Twelve sensors, one of them far off and one calibrated twice."""
    plain, drift = (FIXTURES / "mavs.yaml").read_text(encoding="utf-8"), np.random.default_rng(2).normal(1.0, 0.2, 12)
    own = yaml.safe_load(plain)["calibration"]
    drift[7] = 9.0
    for number, value in enumerate(drift):
        text = plain.replace("SIM-42", f"U-{number:02}").replace("x: [2.52339]", f"x: [{value:.5f}]")
        (tmp_path / f"{number}.yaml").write_text(text.replace("2000-01-01", "2020-03-01"), encoding="utf-8")
    offset = f"offset: {{x: {own['offset']['x']}"
    assert plain.count(offset) == 1
    later = plain.replace(offset, f"offset: {{x: {own['offset']['x'] + 12.0}").replace("2000-01", "2021-01")
    later = later.replace("SIM-42", "U-00").replace("x: [2.52339]", f"x: [{drift[0]:.5f}]")
    (tmp_path / "later.yaml").write_text(later, encoding="utf-8")
    now = datetime(2021, 6, 1, tzinfo=UTC)
    (fleet,) = fleet_history(CalibrationFolder(tmp_path), timedelta(days=365), now).models
    _, (offsets, gradient) = pictured(lambda: distribution_figure(fleet, 1), "distribution-1")
    assert [one.get_xlabel() for one in (offsets, gradient)] == [
        "offset [count]", "temperature coefficient of the offset [count/°C]"
    ]  # fmt: skip
    assert [one.get_text() for one in gradient.get_yticklabels()] == ["Drift of offset x, ΔT"]
    values = np.round(drift, 5)
    assert gradient.figure.get_size_inches()[1] == pytest.approx(2 * 0.55 + (len(offsets.get_yticks()) + 1) * 0.32)
    bar, middle, dots, ring = drawn(gradient)
    quarters = np.percentile(values, [25, 50, 75])
    spread = (quarters[2] - quarters[0]) / 1.349
    np.testing.assert_allclose(bar, [quarters[1] + 2 * spread * np.array([-1, 1]), [0, 0]], rtol=1e-3)
    assert middle.ravel().tolist() == pytest.approx([quarters[1], 0.0])
    np.testing.assert_array_equal(np.sort(dots[0]), np.sort(values))
    beside = dots[1][np.argsort(dots[0])]
    assert beside.tolist() == [-0.11, 0.0, 0.11] * 4
    assert ring.ravel().tolist() == [9.0, 0.0]
    assert looks(gradient)[:3] == [("", GREY, "-", "None"), ("", INK, "None", "|"), ("", BLUE, "None", "o")]
    hollow = gradient.lines[-1]
    assert (hollow.get_markerfacecolor(), to_hex(hollow.get_markeredgecolor())) == ("none", RED)
    assert hollow.get_markersize() > 1.5 * gradient.lines[2].get_markersize()
    assert [one.get_text() for one in gradient.texts] == ["U-07"]
    assert gradient.get_ylim() == (0.6, -0.6)
    table = {row[0]: row[2:] for row in shown_cells(distribution_table(fleet))}
    numbers = (f"{quarters[1]:.2f}", f"{spread:.2f}", f"{values.min():.2f}", "9.00")
    assert table["Drift of offset x, ΔT"] == (*numbers, "count/°C", "U-07")
    alike = f"{own['sensitivity']['x']['x']:.4g}"  # in the whole fleet
    assert table["Sensitivity of x"] == (alike, "0", alike, alike, "count/g", "")
    shown, panels = pictured(lambda: change_figure(fleet, 1), "drift-1")
    assert [words(one) for one in panels] == [("", f"change of the offset of {channel} [mg]") for channel in "xy"]
    milligravity = 1000.0 / own["sensitivity"]["x"]["x"]
    zero, change = drawn(panels[0])
    assert zero[1].tolist() == [0.0, 0.0]
    assert change[1].tolist() == pytest.approx([0.0, 12.0 * milligravity])
    u = milligravity * yaml.safe_load(plain)["uncertainty"]["offset"]["x"]
    assert np.diff(bars(panels[0])[0][:, :, 1]).ravel().tolist() == pytest.approx([2 * u, 2 * u], rel=1e-3)
    assert looks(panels[0])[1] == ("", BLUE, "-", "o")
    assert "Change of the offsets of 12 sca100t-d02" in shown.svg


def test_the_errors_of_the_demonstration(tmp_path: Path) -> None:
    time, warm = np.array([0.0, 60.0, 120.0]), np.array([20.0, 21.0, 22.0])
    before, after = ({axis: scale * np.arange(3.0) for axis in "xy"} for scale in (3.0, 0.5))
    with drawings() as kept:
        draw_tilt_error(tmp_path / "error.svg", time, warm, before, after, "On the bench")
    *errors, temperature = kept["tiltcal"].axes
    for panel, axis in zip(errors, "xy", strict=True):
        require_lines(
            panel,
            ("", INK, "-", "None", [0, 1], [0, 0]),
            ("data sheet's coefficients", RED, "-", "None", [0, 1, 2], before[axis]),
            ("calibrated", BLUE, "-", "None", [0, 1, 2], after[axis]),
        )
        assert words(panel) == ("", f"error of {axis} tilt [°]")
    np.testing.assert_array_equal(drawn(temperature), [[[0, 1, 2], warm]])
    assert words(temperature) == ("time [min]", "T [°C]")
    assert (kept["tiltcal"].get_suptitle(), kept["tiltcal"].get_size_inches()[1]) == ("On the bench", 5.4)
