"""A reference instrument on the plate: nobody states an angle, and what it cannot say is refused."""

import json
import re
from math import radians, sin
from pathlib import Path

import pytest
import yaml
from support import FIXTURES
from support.command import Completed, measure, tiltcal

FACTS = "zero: 0.0025, scale: 0.0002, repeatability: 0.002, alignment: 0.3"


def bench(folder: Path, columns: str = "x,y", facts: str = FACTS, twin: str = "") -> None:
    """A virtual SCA100T-D02 that is set to within 3°, beside an inclinometer."""
    sensor = (FIXTURES / "twins" / "sca100t-d02.yaml").read_text()
    (folder / "sensor.yaml").write_text(re.sub(r"jig: [0-9.]+", "jig: 3.0", sensor))
    (folder / "reference.yaml").write_text((FIXTURES / "twins" / "reference.yaml").read_text() + twin)
    (folder / "bench.yaml").write_text(
        "tiltcal: 1\nkind: bench\nsensors: [{serial: S-1, model: sca100t-d02, address: 'sim:twin=sensor.yaml'}]\n"
        f"reference: {{model: serial-columns, address: 'sim:columns={columns}&unit=g&twin=reference.yaml', {facts}}}\n"
    )


def compare(folder: Path, *options: str, procedure: str = "comparison", code: int | None = None) -> Completed:
    command = ("measure", procedure, "--bench", "bench.yaml", "--samples", "20", "--settle", "0.1", "-o", ".")
    return tiltcal(*command, "--operator", "sim", *options, cwd=folder, code=code)


def test_no_angle_is_stated_and_the_reference_says_which(tmp_path: Path) -> None:
    """Set to within 3°, fitted to thousandths: zero and scale of the reference are errors of all positions alike."""
    bench(tmp_path)
    done = compare(tmp_path)
    assert done.returncode == 0, done.stderr
    assert "a reference whose zero is known to 0.0025°" in done.stderr
    file, truth = (yaml.safe_load((tmp_path / name).read_text()) for name in ("S-1.yaml", "sensor.yaml"))
    found, u = file["calibration"], file["uncertainty"]
    for channel in "xy":
        zero = 819 * 0.0025 * 3.1416 / 180
        assert zero < u["offset"][channel] < 60 * zero
        assert found["offset"][channel] == pytest.approx(
            truth["truth"]["offset"][channel], abs=4 * u["offset"][channel]
        )
        own = truth["truth"]["sensitivity"][channel][channel]
        assert found["sensitivity"][channel][channel] == pytest.approx(own, abs=4 * u["sensitivity"][channel][channel])
    set_angles = file["procedure"]["set"]
    assert any(abs(abs(set_angles["x-up"]["tilt"]["x"]) - 20.0) > 0.05 for _ in "1")
    assert "one error each for the whole session" in done.stderr
    tiltcal("replay", "bench.journal.jsonl", "--golden", ".", cwd=tmp_path, code=0)
    options = ("--samples", "20", "--settle", "0.1", "--limit", "0.3", "--json")
    judged = tiltcal("verify", "S-1.yaml", "--bench", "bench.yaml", "--operator", "sim", *options, cwd=tmp_path, code=0)
    for one in json.loads(judged.stdout)["positions"]:
        tilts = {axis: abs(angle) for axis, angle in one["expected"].items()}
        assert all(angle % 10.0 for angle in tilts.values())  # as the reference read it, not as it was asked for
        assert one["error"] < 0.02
        # Its alignment of 0.3° moves the tilt of an axis by 0.3° times the sine of the other's, and is most of it.
        assert one["expanded"] == pytest.approx(1.96 * 0.3 * sin(radians(max(tilts.values()))), rel=0.2, abs=0.03)
    header = json.loads((tmp_path / "bench.journal.jsonl").read_text().splitlines()[0])
    assert header["reference"]["zero"] == 0.0025
    planned = tiltcal("plan", "comparison", "--bench", "bench.yaml", "--sensor", "sca100t-d02", cwd=tmp_path)
    assert "a reference whose zero is known to 0.0025°" in planned.stdout, planned.stderr
    # The data sheet of a D02 states a nonlinearity, which inclinations of one size do not tell from its sensitivity.
    counts = re.search(r"1[26] inclinations suffice: .* ± (0\.\d+)° with 8, ± (0\.\d+)° with 12", planned.stdout)
    assert counts is not None, planned.stdout
    assert 1.5 * float(counts[2]) < float(counts[1])


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("stuck, start: 0.1", "the reference reads to the last digit what it read in level: is it still read?"),
        ("unplugged, start: 1.0", "reference: the virtual sensor is unplugged"),
    ],
)
def test_a_stale_or_missing_reference_is_refused(tmp_path: Path, fault: str, why: str) -> None:
    bench(tmp_path, twin=f"  faults: [{{kind: {fault}, end: 1e6}}]\n")
    refused = compare(tmp_path)
    assert refused.returncode != 0
    assert why in refused.stdout + refused.stderr


def test_what_a_reference_cannot_say_has_to_be_stated(tmp_path: Path) -> None:
    bench(tmp_path, columns="x")
    assert "state --jig for it" in compare(tmp_path).stderr
    compare(tmp_path, "--jig", "3", procedure="plane", code=0)
    u = yaml.safe_load((tmp_path / "S-1.yaml").read_text())["uncertainty"]
    assert 20 * u["sensitivity"]["x"]["x"] < u["sensitivity"]["y"]["y"]
    bench(tmp_path, facts="repeatability: 0.002, uncertainty: 0.005")
    refused = compare(tmp_path, code=2)
    assert "bench.yaml:4: reference: an uncertainty needs the key 'range'" in refused.stderr
    bench(tmp_path, facts="repeatability: 0.002, uncertainty: 0.005, range: 45")
    assert "zero is known to 0.0025°" in compare(tmp_path).stderr
    alone = measure("-o", "A.yaml", cwd=tmp_path, procedure="comparison")
    assert "states no angles: the bench file needs a reference" in alone.stderr
    assert "sets no angles that a reference could read" in compare(tmp_path, procedure="free").stderr
