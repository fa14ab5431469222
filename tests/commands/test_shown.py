"""What commands print that only show something, whole: procedures, devices, coefficients, help."""

import json
import re
from math import asin, degrees, hypot
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from support import FIXTURES, ROOT
from support.applied import PLAIN
from support.command import tiltcal
from support.golden_file import as_data, coefficients

from tiltcal import __version__, open_calibrations, read
from tiltcal.calibration.wording import label
from tiltcal.core.rounding import plus_minus
from tiltcal.drivers.model import SelfTest
from tiltcal.drivers.sca100t import Sca100t
from tiltcal.library.measure import changes_in_words

PROCEDURES = {path.stem: yaml.safe_load(path.read_text()) for path in sorted((ROOT / "procedures").glob("*.yaml"))}
STILL = "  samples     100 per position, still for 2 s"
SHOWN = {
    "rotation": [
        "  determines  p and q of a1 and a2, orthogonal a4",
        "  determines  p and q of a3 and a4, orthogonal a1",
        "  turns       100 by the stage angle theta, fewer where p and q are known to 1e-05",
        "  prompt      Incline the axis of the stage, and let it turn steadily in the direction in which its angle "
        "counts up.",
    ],
    "ramp": [
        "  determines  offset, no sensitivity, offset of order 3 over temperature",
        "  samples     one every 5 s, while the temperature changes by 0.5 °C/min",
    ],
    "mounting": ["  determines  the mounting of a sensor that is calibrated", STILL],
    "level": [
        "  determines  the offset of a sensor that is calibrated; all else stays",
        STILL,
        "   1. level        Lay the application level.",
    ],
    "free": ["  determines  offset, sensitivity to x, y, z; not the mounting", STILL],
    "mavs": ["  determines  offset, sensitivity to x, y, offset of order 1 over temperature", STILL],
    "multi-angle": ["  determines  offset, sensitivity to x, y, z, nonlinearity", STILL],
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_procedure_is_shown_with_what_it_determines(name: str) -> None:
    lines, known = tiltcal("procedures", name, code=0).stdout.splitlines(), PROCEDURES[name]
    source = [f"  source      {known['source']}"] if "source" in known else []
    assert lines[: 1 + len(source)] == [f"{name}: {known['title']}", *source]
    shown = lines[1 + len(source) :]
    assert shown[: len(SHOWN[name])] == SHOWN[name]
    numbered = [line for line in shown if re.match(r" *\d+\. ", line)]
    assert len(numbered) == len(known.get("positions", known.get("legs", [])))


def test_procedures_are_listed_and_printed() -> None:
    listed = tiltcal("procedures", code=0).stdout.splitlines()
    assert [line[:17].rstrip() for line in listed] == [*PROCEDURES]
    assert listed[0] == f"comparison-16     {PROCEDURES['comparison-16']['title']} (16 positions)"
    assert [line.rpartition(" (")[2] for line in listed if line[:2] in ("le", "ra", "ro")] == [
        *("1 position)", "4 legs)", "up to 100 turns)")
    ]
    assert listed == tiltcal("procedures", "--source", code=0).stdout.splitlines()
    source = tiltcal("procedures", "plane", "--source", code=0).stdout
    assert source == (ROOT / "procedures" / "plane.yaml").read_text()
    for names, known in (((), PROCEDURES), (("ramp",), ["ramp"])):
        told = json.loads(tiltcal("procedures", *names, "--json", code=0).stdout)
        assert [one["title"] for one in told] == [PROCEDURES[name]["title"] for name in known]
    assert tiltcal("procedures", ROOT / "procedures" / "plane.yaml", "--source").stdout == source


ADXL202 = """\
adxl202  Analog Devices ADXL202 accelerometer, ±2 g, duty cycle
  reads      x, y in duty, and its temperature
  nominal    0.5 duty at 0 g, 0.125 duty/g
  address    serial:///dev/ttyUSB0?baudrate=115200
             gpio:///dev/gpiochip0?x=17&y=27
             vcd:capture.vcd?x=D0&y=D1
             ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2
             sim: for the virtual twin (sim:?twin=FILE&seed=N)
  options    wiring
  the twin does not model
    - response time and bandwidth: """


def test_devices_are_shown_and_listed() -> None:
    assert tiltcal("devices", "adxl202", code=0).stdout.startswith(ADXL202)
    assert tiltcal("devices", "thermistor", code=0).stdout.splitlines()[1:3] == [
        "  reads      the temperature in °C",
        "  address    ads1115+i2c:///dev/i2c-1?address=0x48&channel=3&supply=2&beta=3950&r0=10000&t0=25&fixed=10000",
    ]
    stage = tiltcal("devices", "gradiometer", code=0).stdout.splitlines()
    assert stage[1:3] == [
        "  reads      theta, a1, a2, a3, a4 in mA",
        "  address    serial:///dev/ttyUSB0?columns=time,theta,a1,a2,a3,a4",
    ]
    assert not any(line.startswith("  options") for line in tiltcal("devices", "sca100t-d02").stdout.splitlines())
    listed = tiltcal("devices", code=0)
    every = json.loads(tiltcal("devices", "--json", code=0).stdout)
    names, width = [one["name"] for one in every], max(len(one["name"]) for one in every)
    assert listed.stdout.splitlines() == [f"{one['name']:<{width}}  {one['title']}" for one in every]
    assert listed.stderr.startswith("`tiltcal devices MODEL` shows the addresses of one")
    assert {"sca100t-d02", "gradiometer", "bei-rs232"} < {*names}
    for name, scale in (("sca100t-d02", (1024.0, 819.0)), ("gradiometer", (None, None))):
        (one,) = json.loads(tiltcal("devices", name, "--json", code=0).stdout)
        assert one == every[names.index(name)]
        assert list(one) == [
            *("name", "title", "channels", "unit", "offset", "sensitivity", "thermometer"),
            *("addresses", "twin_does_not_model"),
        ]
        assert (one["offset"], one["sensitivity"]) == scale
        assert one["addresses"][-1] == "sim:"


def test_a_probe_shows_answers_and_self_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passed at 95 % of 2047 count and more, with a return to within 5 %; exit code 1 where one is not."""
    monkeypatch.setattr(Sca100t, "probe", lambda self: {"x": "1014 count", "temperature": "23.1 °C"})
    words = ("probe", "sca100t-d02", "--address", "sim:", "--self-test")
    for deflected, code, verdict in ((2000, 0, "passed"), (1900, 1, "FAILED")):
        made = {"x": SelfTest(1014, deflected, 1013, 2047), "y": SelfTest(1002, 2047, 1003, 2047)}
        monkeypatch.setattr(Sca100t, "self_test", lambda self, channel, made=made: made[channel])
        assert tiltcal(*words, code=code).stdout.splitlines() == [
            "sca100t-d02 answers at sim:",
            "  x            1014 count",
            "  temperature  23.1 °C",
            f"  self-test x  {verdict}: 1014 count at rest, {deflected} while pushed, 1013 after the recovery",
            "  self-test y  passed: 1002 count at rest, 2047 while pushed, 1003 after the recovery",
        ]
        told = json.loads(tiltcal(*words, "--json", code=code).stdout)
        assert told["self_test"].pop("x") == {"passed": code == 0, "said": str(made["x"])}
        answers = {"x": "1014 count", "temperature": "23.1 °C"}
        self_test = {"y": {"passed": True, "said": str(made["y"])}}
        assert told == {"model": "sca100t-d02", "address": "sim:", "answers": answers, "self_test": self_test}
    assert "self-test" not in tiltcal("probe", "--sensor", "sca100t-d02", "--address", "sim:", code=0).stdout


BY_LENGTH = " (at rest they are as long as gravity)"
UNKNOWN = ", and unit= is not known: add it and what 1 g is, such as &unit=count&sensitivity=16384"
WHICH = "which of them are the accelerations does not show (- skips one): name them, such as"
RIGHT, COUNT = "If that is right:", "&unit=count&sensitivity=16384"


@pytest.mark.parametrize(
    ("line", "columns", "unit", "what", "more"),
    [
        ("0.1,0.2,9.8", "x,y,z", "m/s2", f"as columns=x,y,z, unit=m/s2{BY_LENGTH}. {RIGHT}", "&unit=m/s2"),
        ("X: 1 Y: 0 Z: 9 m/s^2", "x,y,z", "m/s2", f"as columns=x,y,z, unit=m/s2. {RIGHT}", "&unit=m/s2"),
        ("1 7 16384", "x,y,z", "count", f"as columns=x,y,z, unit=count{BY_LENGTH}. {RIGHT}", COUNT),
        ("ax=12", "x", "", f"as columns=x{UNKNOWN}. {RIGHT}", ""),
        ("1.5 2 3 4 5", "-,-,-,-,-", "", WHICH, "&unit=m/s2"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "/dev/ttyUSB0?timeout=3"])
def test_a_port_is_described_by_what_it_prints(
    port: str, line: str, columns: str, unit: str, what: str, more: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiltcal.cli.probe.open_link", lambda *_: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr("tiltcal.cli.probe.listened", lambda *_: ([line.encode()] * 3, 49.96))
    procedure, count = "six-face" if columns == "x,y,z" else "PROCEDURE", columns.count(",") + 1
    address = f"{port}{'&' if '?' in port else '?'}columns={columns.replace('-,-,-', 'x,y,z', 1)}{more}"
    assert tiltcal("probe", "--address", port, code=0).stdout == (
        f"/dev/ttyUSB0 prints {count} number{'s' * (count > 1)} a line, 50 lines a second:\n  {line}\n{what}\n"
        f'  tiltcal measure {procedure} --sensor serial-columns --address "{address}" --serial IMU1 -o IMU1.yaml\n'
    )
    told = {"numbers": count, "columns": columns, "unit": unit, "example": line, "lines_per_second": 50.0}
    told["address"] = port if what is WHICH else address
    assert json.loads(tiltcal("probe", "--address", port, "--json", code=0).stdout) == told


def test_a_port_without_numbers_is_told_by_its_last_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.cli.probe.open_link", lambda *_: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr("tiltcal.cli.probe.listened", lambda *_: ([b"boot", b"ready", b"hello"], 5.0))
    assert tiltcal("probe", "--address", "/dev/ttyUSB0", code=3).stderr == (
        "tiltcal: /dev/ttyUSB0 sends text without numbers, such as 'hello': is the baud rate right (baudrate=), and "
        "does the sketch print its readings?\n"
    )


def test_a_stage_is_planned_by_its_channels() -> None:
    told = json.loads(tiltcal("plan", "rotation", "--sensor", "gradiometer", "--json", code=0).stdout)
    pairs = [{"pair": ["a1", "a2"], "orthogonal": "a4"}, {"pair": ["a3", "a4"], "orthogonal": "a1"}]
    assert (told["pairs"], told["turns"], told["left_out"]) == (pairs, 100, [])
    lines = tiltcal("plan", "rotation", "--sensor", "gradiometer", code=0).stdout.splitlines()
    assert lines == ["a1 and a2, orthogonal a4", "a3 and a4, orthogonal a1", told["why"]]


def test_show_prints_coefficients_tilts_and_the_map(tmp_path: Path) -> None:
    """A and b turn readings of the model back into gravity; of two channels that read g_z too b is that at level."""
    record = read(FIXTURES / "free.yaml").record
    lines = tiltcal("show", FIXTURES / "free.yaml", "--matrix", code=0).stdout.splitlines()[-5:]
    assert lines[0] == "  g = A (u - b), A in g per count, columns x, y, z; b in count"
    assert [line[:6].rstrip() for line in lines[1:]] == ["  A x", "  A y", "  A z", "  b"]
    rows = np.array([line[5:].split() for line in lines[1:]], dtype=float)
    up = np.vstack([np.eye(3), -np.eye(3)])
    assert (record.coefficients.predict(up) - rows[3]) @ rows[:3].T == pytest.approx(up, abs=1e-6)
    for text, matrix, offset in (
        (PLAIN.replace("y: 0.0}, y", "y: 0.0, z: 0.05}, y").replace("y: 2.0}", "y: 2.0, z: -0.03}"), 2, "2.55 2.47"),
        (
            PLAIN.replace("[x, y]", "[y]")
            .replace("x: 2.5, ", "")
            .replace("x: {x: 2.0, y: 0.0}, ", "")
            .replace("x: 0.0, ", ""),
            1,
            "2.5",
        ),
    ):
        (tmp_path / "cal.yaml").write_text(text)
        shown = tiltcal("show", "cal.yaml", "--matrix", cwd=tmp_path, code=0).stdout.splitlines()
        assert [line[4] for line in shown if line.startswith("  A ")] == ["x", "y"][-matrix:]
        assert " ".join(shown[-1].split()[1:]) == offset
    assert "A" not in tiltcal("show", "cal.yaml", cwd=tmp_path, code=0).stdout
    pairs = tiltcal("show", FIXTURES / "rotation.yaml", code=0).stdout
    assert pairs == f"{read(FIXTURES / 'rotation.yaml')}\n"
    assert (pairs.count("p = "), pairs.count("\n\na3 and a4, ")) == (2, 1)
    refused = tiltcal("show", FIXTURES / "rotation.yaml", "--matrix", code=2)
    assert refused.stderr.endswith("rotation.yaml is of pairs, which have no matrix: leave --matrix out\n")


@pytest.mark.parametrize("name", ["mounting", "ramp", "free", "level", "comparison", "sensitivity-drift"])
def test_show_prints_what_a_file_holds(name: str) -> None:
    """Line by line, but the tilts, which a plan foresees in the same words."""
    data = as_data(name)
    unit, fit, u = data["sensor"]["unit"], data["fit"], data["uncertainty"]
    lines = ["{model} {serial}  (± standard uncertainty, k = 1)".format(**data["sensor"])]
    for one, value, doubt in coefficients(data):
        number, _, rest = plus_minus(value, doubt).partition(" ")
        _, short, _, of = label(one, unit)
        lines.append(f"  {short:<17} {number:>12} {rest} {of}".rstrip())
    if lag := data["calibration"].get("temperature", {}).get("lag"):
        lines.append(f"  thermal lag       {plus_minus(lag, u['temperature']['lag']):>19} s")
    largest = max(abs(one) for row in data["calibration"]["sensitivity"].values() for one in row.values())
    (position, channel, residual), angle = fit["worst"].values(), degrees(asin(abs(fit["worst"]["residual"]) / largest))
    lines.append(f"  worst residual  {position}, channel {channel}: {residual:g} {unit} ({angle:.3f}° near level)")
    judged = ", chi-square {chi_square:g}" if "chi_square" in fit else ""
    lines.append(
        f"  degrees of freedom {{degrees_of_freedom}}, uncertainty from {{uncertainty_from}}{judged}".format(**fit)
    )
    if (agree := fit.get("jig_estimated_degrees")) is not None:
        lines.append(f"  the positions agree {f'to {agree:.2g}°' if agree else 'within their noise'}")
    for angle, value in data["calibration"].get("mounting", {}).items():
        number, _, rest = plus_minus(value, u["mounting"][angle]).partition(" ")
        lines.append(f"  {angle:<6}{number:>12} {rest}°")
    lines += [f"  mounting {data['derived']['mounting']}"] if "mounting" in data["derived"] else []
    lines += [f"  {note}" for note in fit.get("notes", [])]
    shown = tiltcal("show", FIXTURES / f"{name}.yaml", code=0).stdout.splitlines()
    assert [line for line in shown if not line.startswith("  tilt ")] == lines


def test_a_program_is_shown_what_it_holds() -> None:
    pairs, plane = (read(FIXTURES / f"{name}.yaml") for name in ("rotation", "plane"))
    assert repr(pairs) == "<PairCalibration of a1 and a2, a3 and a4>"
    assert repr(plane) == "<Calibration of sca100t-d02 SIM-42: x, y in count>"
    assert repr(open_calibrations(FIXTURES)) == f"<CalibrationLibrary of {FIXTURES}>"
    for shown, name in ((plane, "plane"), (read(FIXTURES / "mavs.yaml"), "mavs")):
        limits = yaml.safe_load((FIXTURES / f"{name}.yaml").read_text())["limits"]
        lines = [f"  tilt {axis}  {low:g}°  to  {high:g}°" for axis, (low, high) in limits["tilt"].items()]
        if "temperature" in limits:
            lines.append("  temperature  {:g} °C  to  {:g} °C".format(*limits["temperature"]))
        assert str(shown.limits).splitlines()[: len(lines)] == lines
        assert str(shown.limits).splitlines()[len(lines) :] == [f"  reading {axis}  101  to  2047" for axis in "xy"]
    assert pairs.compensation().channels == ("a1", "a2", "a4", "a3", "theta")
    assert pairs != plane
    assert plane == read(FIXTURES / "plane.yaml")
    assert plane != plane.with_mounting("roll=1")
    assert plane != str(plane)
    closed = read(FIXTURES / "temperature-sweep.yaml").record
    first, last = (yaml.safe_load((FIXTURES / "temperature-sweep.yaml").read_text())["positions"][k] for k in (0, -1))
    told = [
        f"{axis} {(change := last['mean'][axis] - first['mean'][axis]):.2f} ± "
        f"{2 * hypot(last['u'][axis], first['u'][axis]):.2f} count ({1000 * change / 819:+.2g} mg)"
        for axis in "xy"
    ]
    assert changes_in_words(closed) == f"SIM-42: back in down-24 the readings have changed by {', '.join(told)}"


HEADINGS = {
    "noise": {
        "Sensor": "--sensor --address --calibration --unit", "Data": "--columns --skip-bad-rows",
        "Result": "-o --figure", "Recording": "--samples --rate --for", "Averages": "--target",
        "Other": "--topic --json --help",
    },
    "match": {
        "Data": "--pair --orthogonal --phase --skip-bad-rows", "Result": "-o --figure", "Method": "--online --loops",
        "Other": "--json --help",
    },
    "export": {"Options": "--to -o --name --fixed --allow --help"},
    "apply": {
        "Options": "-o --topic --columns --uncertainty --skip-bad-rows --json --help",
        "Calibrations over time": "--calibrations --serial --start --stability", "Means": "--average --every",
        "Heading and velocity": "--magnetometer --velocity --declination --magnetometer-noise",
        "Further options": "--mounting --reading-noise --first-order --scheduler",
    },
}  # fmt: skip


@pytest.mark.parametrize("command", HEADINGS)
def test_a_long_help_has_headings(command: str) -> None:
    found: dict[str, list[str]] = {}
    for line in tiltcal(command, "--help", code=0).stdout.splitlines():
        if heading := re.match(r"([A-Z][\w ]*):$", line):
            found[heading[1]] = []
        elif option := re.match(r"  (?:-h, )?(-[\w-]+)", line):  # without -h where a test called the command alone
            found[[*found][-1]].append(option[1])
    assert {name: " ".join(options) for name, options in found.items() if options} == HEADINGS[command]


def test_without_a_command_it_says_how_to_begin() -> None:
    bare = tiltcal(code=2).stdout
    assert bare.startswith("Begin with\n  a sensor on a port   tiltcal probe --address serial:///dev/ttyUSB0\n")
    assert bare.endswith(tiltcal("--help", code=0).stdout)
    assert re.findall(r"^(\S[^:]*):$", bare, re.MULTILINE) == [
        *("Options", "Commands of the bench", "Commands for logs", "Commands for files")
    ]
    assert tiltcal("--version", code=0).stdout == f"tiltcal, version {__version__}\n"
    assert "Error: --verbose goes with --version" in tiltcal("--verbose", code=2).stderr
    assert "Error: no such command 'mesure'; did you mean 'measure'?\n" in tiltcal("mesure", code=2).stderr
    assert tiltcal("zzz", code=2).stderr.endswith("Error: no such command 'zzz'\n")
    assert "No such option" in tiltcal("--zzz", code=2).stderr
