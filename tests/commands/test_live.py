"""``tiltcal live``: the calibrated tilt of a sensor as it is now."""

import json
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import measure, tiltcal


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibrated")
    measure(cwd=folder, code=0)
    return folder / "S-1.yaml"


def test_a_level_sensor_lies_level_within_its_uncertainty(calibrated: Path) -> None:
    printed = tiltcal("live", calibrated, "--address", "sim:?seed=1", "--rate", "50", "--for", "0.1", "--json", code=0)
    for line in printed.stdout.splitlines():
        tilt = json.loads(line)
        assert tilt["time"].startswith("20")
        assert (tilt["flag"], tilt["reason"]) == (1, 0)
        for axis in "xy":
            assert abs(tilt[f"tilt_{axis}"]) < 2 * tilt[f"U95_tilt_{axis}"] < 2.0
    assert 2 <= len(printed.stdout.splitlines()) <= 6
    plain = tiltcal("live", calibrated, "--address", "sim:?seed=1", "--for", "0.01").stdout
    assert plain.startswith("S-1   tilt x ")
    assert "° ± 0." in plain


def test_the_sensor_has_to_be_as_it_was_calibrated(calibrated: Path) -> None:
    tiltcal("live", FIXTURES / "complete.yaml", "--address", "spi:///dev/none", "--for", "0.1", code=3)
    tiltcal("live", FIXTURES / "rotation.yaml", "--address", "sim:", code=2)


def test_address_and_range_are_those_of_the_file_and_another_range_is_refused(tmp_path: Path) -> None:
    options = ("--sensor", "mpu6050", "--address", "sim:range=4g", "--serial", "I-2", "-o", "I-2.yaml")
    tiltcal("measure", "six-face", *options, "--samples", "10", "--operator", "sim", cwd=tmp_path, code=0)
    for address in ((), ("--address", "sim:")):
        shown = tiltcal("live", "I-2.yaml", *address, "--for", "0.01", "--json", cwd=tmp_path)
        assert abs(json.loads(shown.stdout.splitlines()[0])["pitch"]) < 1.0
    for command in (("live",), ("verify", "--operator", "sim")):
        refused = tiltcal(command[0], "I-2.yaml", "--address", "sim:range=2g", *command[1:], cwd=tmp_path, code=2)
        assert "is of another range or scale" in refused.stderr
        assert "nominally 16384 count/g" in refused.stderr
    recorded = (tmp_path / "I-2.yaml").read_text(encoding="utf-8").replace('  bench: {address: "sim:range=4g"}\n', "")
    (tmp_path / "fitted.yaml").write_text(recorded, encoding="utf-8")
    assert "state --address" in tiltcal("live", "fitted.yaml", cwd=tmp_path, code=2).stderr
