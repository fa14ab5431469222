"""``tiltcal plan``: what a procedure will determine, before anyone starts."""

import json
from itertools import pairwise
from math import cos, degrees, hypot, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.command import measure, tiltcal


def plan(*options: str, sensor: str = "sca100t-d02") -> dict:
    result = tiltcal("plan", *options, "--sensor", sensor, "--json", code=0)
    return json.loads(result.stdout)


CLOSED_FORMS = {
    # Level and 45° with noise near zero: the offset is uncertain by 0.125 duty/g times the jig.
    "zero-45 --noise 1e-4 --samples 1000000 --jig 0.2": {"offset.x": 0.125 * radians(0.2)},
    # In five positions up to 30°: about z gravity has a lever of 1/2 in four of them, so 4 (1/2)² = 1; about x of
    # cos 30° in two and of 1 in three, so 2 (3/4) + 3 = 4.5; about y the same.
    **{
        words: {"mounting.yaw": u, "mounting.roll": u / sqrt(4.5), "mounting.pitch": u / sqrt(4.5)}
        for words, u in (("mounting --jig 0.1 --noise 0", 0.1), ("mounting --noise 8.19 --samples 100", degrees(1e-3)))
    },
}  # fmt: skip


@pytest.mark.parametrize("options", CLOSED_FORMS)
def test_an_uncertainty_is_its_closed_form(options: str) -> None:
    found = plan(*options.split(), sensor="sca100t-d02" if options.startswith("mount") else "adxl202")["uncertainty"]
    assert {name: found[name] for name in CLOSED_FORMS[options]} == pytest.approx(CLOSED_FORMS[options], rel=1e-3)


TOLD = """\
predicted standard uncertainty, with 0.01 V of noise a sample and {jig}:
  offset.x                     0.0005 V
  sensitivity.x.x              0.0014 V/g
  sensitivity.x.y              0.0014 V/g
  offset.y                     0.0005 V
  sensitivity.y.x              0.0014 V/g
  sensitivity.y.y              0.0014 V/g
  tilt x within  ± 0.028° near level, 0.056° at -30°, 0.056° at 30°  (95 %)
  tilt y within  ± 0.028° near level, 0.056° at -30°, 0.056° at 30°  (95 %)
  degrees of freedom 2
  One more position, +x straight up, would cut the uncertainty of S_xx by 38 %
  One more position, +x straight down, would cut the uncertainty of S_xx by 38 %
  One more position, +y straight up, would cut the uncertainty of S_xy by 38 %
{unsaid}  readings are held still and sampled for 1 min; setting and changing temperatures on top
  If the table is not level, its tilt is in the offsets: turn the fixture by 180° and repeat one position, or state \
--table-lean.
"""
UNSAID = "  This is if every angle is set exactly: no --jig is stated, and what the positions show will be larger\n"


def test_a_plan_in_words_is_its_closed_form() -> None:
    """Four means at ±30°, each good to s = 1 mV, 2 V/g: u(offset) = s/2, u(S) = √2 s; a fifth along x makes 2 s² of
    its variance 10/13 s². Tilts: near level degrees(1.96 s/2 / 2 V), at the ends with √2 s sin 30°, over cos 30°."""
    words = ("plan", "plane", "--sensor", "serial-columns", "--noise", "0.01", "--samples", "100")
    words = (*words, "--address", "sim:columns=x,y&unit=V&sensitivity=2&offset=2.5")
    assert tiltcal(*words, code=0).stdout == TOLD.format(jig="a perfect jig (none is stated)", unsaid=UNSAID)
    level = tiltcal(*words, "--jig", "0", "--table-lean", "0", code=0).stdout
    assert level == TOLD.partition("  If the table")[0].format(jig="a jig of 0°", unsaid="")
    found, s = json.loads(tiltcal(*words, "--json", code=0).stdout), 1e-3
    u = {"offset": s / 2.0, "sensitivity": sqrt(2.0) * s}
    assert found["uncertainty"] == pytest.approx({name: u[name.split(".")[0]] for name in found["uncertainty"]})
    half = [1.96 * degrees(one) for one in (hypot(s / 2, s / sqrt(2)) / 2 / cos(radians(30.0)), s / 4)]
    (ends, level), tilts = half, [found["tilt"][axis] for axis in "xy"]
    assert tilts == [[pytest.approx(one, rel=1e-3) for one in ([-30, ends], [0, level], [30, ends])]] * 2
    assert found["worth_adding"][0] == ["+x straight up", "sensitivity.x.x", pytest.approx(sqrt(10 / 13 / 2), abs=1e-3)]
    assert (found["noise"], found["jig"], found["seconds"]) == (0.01, None, 8.0)


def test_the_time_that_is_spent_in_positions() -> None:
    """Nine new temperatures with the six minutes of a late thermometer, and 100 samples, 10 ms apart, in each."""
    closed = plan("temperature-sweep", "--samples", "100", "--closing")  # it ends where it began without that
    assert closed["seconds"] == pytest.approx(9 * (360 + 100 * 0.01))


def test_a_ramp_is_planned_as_the_polynomial_through_eight_places_of_each_leg() -> None:
    """From 24 °C down to 5, up to 40, down to 5 and up to 24, at half a degree a minute; each mean good to 1 mV."""
    address = "sim:columns=x,y,temperature&unit=V&sensitivity=2&offset=2.5"
    stated = ("ramp", "--address", address, "--noise", "0.01", "--samples", "100", "--thermometer", "0")
    found = plan(*stated, sensor="serial-columns")
    ways = [np.linspace(start, end, 8, endpoint=False) for start, end in pairwise((24.0, 5.0, 40.0, 5.0, 24.0))]
    powers = np.vander(np.concatenate(ways) - 24.0, 4, increasing=True)
    u = 1e-3 * np.sqrt(np.diag(np.linalg.inv(powers.T @ powers)))
    names = ("offset.x", *(f"temperature.offset.x.{power}" for power in (1, 2, 3)))
    assert [found["uncertainty"][name] for name in names] == pytest.approx(u, rel=1e-3)
    assert (found["degrees_of_freedom"], found["seconds"]) == (2 * 32 - 8, (19 + 35 + 35 + 19) / 0.5 * 60)


def test_the_column_of_z_and_the_non_linearity_count_by_the_data_sheet() -> None:
    """SCA100T: 4 % of cross-axis sensitivity at most, so 4 %/√3 for each column; D02 typically bends by 0.57°.

    At level S_z is in the reading, so that the offset is as uncertain; six faces determine it.
    """
    level = plan("zero-45", "--jig", "0.01")["uncertainty"]
    column = 819.0 * 0.04 / sqrt(3.0)
    assert level["sensitivity.x.z"] == pytest.approx(column, rel=1e-3)
    assert level["offset.x"] == pytest.approx(column, rel=1e-2)
    assert [level["nonlinearity.x.2"], level["nonlinearity.x.3"]] == pytest.approx([sin(radians(0.57))] * 2, rel=1e-3)
    assert plan("six-face", "--jig", "0.01")["uncertainty"]["sensitivity.x.z"] < 0.02 * column


def test_a_thermometer_adds_what_the_drift_makes_of_it() -> None:
    """Two temperatures 18.5 °C apart, each good to 1 °C: √2 · hypot(s, k · 1 °C) / 18.5 °C, with the drift k that is
    stated. It is about 2 mg/°C, as in the data sheet of the ADXL202, of 0.125/g.
    """
    options = ("two-temperature", "--sensor", "adxl202", "--noise", "0.0002", "--samples", "100", "--thermometer", "1")
    said = tiltcal("plan", *options).stdout.splitlines()[1]
    before, _, drift = said.removesuffix(" duty/°C").rpartition(" ")
    assert before == "  and temperatures that are known to 1 °C, for a part that drifts by"
    assert 1e-4 < float(drift) < 5e-4
    found = plan(*options[:1], *options[3:], sensor="adxl202")["uncertainty"]["temperature.offset.x.1"]
    assert found == pytest.approx(sqrt(2) * hypot(0.0002 / sqrt(100), float(drift)) / 18.5, rel=0.03)


@pytest.mark.parametrize("lean", [(), ("--table-lean", "1")])
def test_a_level_is_proposed_no_other_direction(lean: tuple[str, ...]) -> None:
    """`fit level` refuses a position that is not level, so plan must not propose one."""
    found = tiltcal("plan", "level", "--base", str(FIXTURES / "complete.yaml"), "--jig", "0.1", *lean, code=0)
    proposed = [line for line in found.stdout.splitlines() if "One more" in line]
    assert len(proposed) == len(lean) // 2
    assert all("One more position, level with the fixture turned by 180°" in line for line in proposed)


PROCEDURE = """\
tiltcal: 1
kind: procedure
name: short
title: Too short
determines: {determines}
reference: 24
positions:
{positions}
"""


def test_what_cannot_be_determined_is_refused_with_what_to_add(tmp_path: Path) -> None:
    level, warm, cold = "tilt: {x: 0}", "tilt: {x: 0}, temperature: 24", "tilt: {x: 0}, temperature: 5"
    faces = ["gravity: [1, 0, 0]", "gravity: [0, 1, 0]", "gravity: [0, 0, 1]"]
    for determines, positions, advice in (
        ("{axes: [x]}", [level], "add the position x at +45°"),
        ("{axes: [x, y, z]}", faces, "add the position upside down (+z down)"),
        ("{axes: [], drift: 1}", [warm], "add the position level (+z up) at another, higher temperature"),
        ("{axes: [], drift: 2}", [warm, cold], "add the position level (+z up) at another, higher temperature"),
    ):
        rows = "\n".join(f"  - {{name: p{n}, {where}, prompt: P}}" for n, where in enumerate(positions))
        (tmp_path / "short.yaml").write_text(PROCEDURE.format(determines=determines, positions=rows))
        assert advice in tiltcal("plan", "short.yaml", "--sensor", "sca100t-d02", cwd=tmp_path, code=2).stderr
        measured = measure(procedure="short.yaml", cwd=tmp_path)
        assert (measured.returncode, "1/" in measured.stderr) == (2, False), "refused before the first position"
        assert [path.name for path in tmp_path.iterdir()] == ["short.yaml"]


def test_an_angle_beyond_the_range_is_refused_as_measure_refuses_it(tmp_path: Path) -> None:
    """The SCA100T-D01 reads ±30°: at 60° x would read 1024 + 1638 sin 60° = 2442 counts, and its largest is 2047."""
    planned = tiltcal("plan", "plane", "--sensor", "sca100t-d01", "--tilt", "60", code=2)
    assert planned.stderr == (
        "tiltcal: position x-tilt1 is outside the range of sca100t-d01: x would read about 2442.5 count, and reads "
        "from 101 to 2047: a smaller --tilt brings it in range\n"
    )
    measured = measure("--tilt", "60", "--sensor", "sca100t-d01", cwd=tmp_path)
    assert planned.stderr in measured.stderr
