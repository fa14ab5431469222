"""Bad input: a clear error with file, line and key, exit code 2, and nothing written."""

import io
import subprocess
from pathlib import Path

import pytest
from support import FIXTURES
from support.applied import PLAIN
from support.command import TILTCAL, called, measure, tiltcal

MEASURE = ("measure", "plane", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S-1", "-o", "S-1.yaml")
FIT = ("log.csv", "--segments", "seg.csv", "--unit", "count", "--serial", "S-1", "-o", "new.yaml")
ROWS = "1,2,3\n1.5,2,3\n" * 20
TWO = "9.8,0.1,0.2\n9.9,0.2,0.1\n" * 10 + "0.1,9.8,0.3\n0.2,9.7,0.2\n" * 10


def test_wrong_segments(tmp_path: Path) -> None:
    for segments, rows, says in (
        ("x-upp,0,9\n", ROWS, "seg.csv:2: six-face has no position 'x-upp' (did you mean 'x-up'?)"),
        ("x-up,0,99\n", ROWS, "seg.csv:2: segment x-up: ends at row 99; log.csv has 40 rows"),
        ("x-up,0,20\ny-up,20,40\n", TWO, "add the positions level (+z up) and upside down (+z down)"),
    ):
        (tmp_path / "seg.csv").write_text("position,start,end\n" + segments)
        (tmp_path / "log.csv").write_text("x,y,z\n" + rows)
        assert says in tiltcal("fit", "six-face", *FIT, cwd=tmp_path, code=2).stderr
        assert not (tmp_path / "new.yaml").exists()
    assert "'six-face'" in tiltcal("fit", "six-faces", *FIT, cwd=tmp_path).stderr


SIM = "--sensor sca100t-d02 --address sim:"
TO = "--serial S-1 -o new.yaml"
PAIR = "--pair a1,a2 --orthogonal a4 --phase theta"
EARTH = "apply cal.yaml log.csv --columns heading=h"
REFUSED = [
    ("apply cal.yaml", "no LOG is given behind cal.yaml; see `tiltcal apply --help`"),
    ("apply --calibrations . CAL.YAML log.csv", "CAL.YAML is a calibration, and --calibrations names a folder of them"),
    ("apply cal.yaml log.csv log2.csv", "several logs need a folder for their results: name one with -o, not -"),
    ("apply cal.yaml log.csv log2.csv -o segs.csv", "several logs need a folder for their results: name one with -o"),
    (
        "apply cal.yaml log.csv to/log.csv -o to",
        "log.csv and to/log.csv would both be to/log.csv: apply to them one by",
    ),
    ("apply cal.yaml log.csv log.csv -o to", "log.csv and log.csv would both be to/log.csv"),
    ("apply cal.yaml log.csv log2.csv -o .", "it would replace log.csv, which is read"),
    ("apply cal.yaml - log2.csv -o to", "standard input is one log: leave the others out"),
    ("apply cal.yaml log.csv log2.csv -o log.csv/to", "the folder log.csv/to cannot be made: Not a directory"),
    ("apply wrong.yaml log.csv", "wrong.yaml:5: calibration.ofset: unknown key 'ofset' (did you mean 'offset'?)"),
    ("apply gone.yaml log.csv", "gone.yaml"),
    *(
        (f"apply cal.yaml log.csv -o out{end}", f"out{end}: a log is written as .csv or .parquet, or stays .nc: name")
        for end in (".csv.gz", ".xlsx", ".JSON")
    ),
    ("apply cal.yaml log.csv --columns x", "takes pairs, not 'x'"),
    ("apply cal.yaml log.csv --columns x=", "takes pairs, not 'x='"),
    ("apply cal.yaml log.csv --columns temprature=T", "did you mean 'temperature'?"),
    ("apply cal.yaml log.csv --columns x=a,x=b", "names x twice"),
    ("apply cal.yaml log.csv --uncertainty", "under `uncertainty`"),
    (EARTH, "no role 'heading'"),
    (f"{EARTH} --velocity u,v", "three columns"),
    ("apply cal.yaml log.csv --velocity u,v,w", "--columns heading=NAME"),
    ("apply cal.yaml log.csv --declination 4", "--declination needs"),
    ("apply cal.yaml log.csv --magnetometer mx,my,mz --declination 361", "between -180 and 180"),
    ("apply cal.yaml log.csv --magnetometer mx,my,m", "there is no column 'm'"),
    ("apply cal.yaml log.csv --magnetometer mx,my,mz --magnetometer-noise 1", "needs --magnetometer and --uncertainty"),
    ("check", "check needs a FILE, or --schema KIND; see tiltcal check --help"),
    ("check none.yaml", "none.yaml:1: the key 'kind' is missing: this is not a tiltcal file"),
    ("check --schema bench cal.yaml --json", "--schema prints the JSON Schema of a kind and checks no file"),
    ("noise", "noise needs either a LOG, or --sensor MODEL and --address ADDRESS to record one now"),
    ("noise log.csv --samples 100", "--samples is for recording a sensor with --address, not for a LOG"),
    ("noise log.csv --for 9", "--for is for recording"),
    ("noise log.csv -o other.csv", "--output is for recording"),
    (f"noise log.csv {SIM}", "either the log log.csv or the sensor at sim:, not both"),
    ("noise --address sim: --samples 10", "--address needs the --sensor model that is connected there"),
    (f"noise {SIM} --samples 10 --columns x=a", "--columns and --skip-bad-rows are for a LOG"),
    (f"noise {SIM} --samples 10 --skip-bad-rows", "--columns and --skip-bad-rows are for a LOG"),
    (f"noise {SIM}", "a recording on the virtual bench needs --samples or --for"),
    (f"noise {SIM} --samples 300 -o log.NC4", "a recording is CSV or Parquet"),
    ("noise log.csv --unit count --target 0.01", "--target is in degrees"),
    ("noise log.csv --sensor sca100t-d02 --unit V", "one unit"),
    ("noise log.csv --sensor sca100t-d03", "did you mean"),
    ("noise nowhere.parquet", "cannot read"),
    (f"match log.csv {PAIR} --pair a3,a4", "2 --pair and 1 --orthogonal: each pair needs one orthogonal"),
    ("match log.csv --pair a1 --orthogonal a4", "--pair 'a1' is not a pair; write two columns, such as a1,a2"),
    ("match log.csv --pair a1, --orthogonal a4", "--pair 'a1,' is not a pair"),
    ("match log.csv --pair a1,a2,a3 --orthogonal a4", "--pair 'a1,a2,a3' is not a pair"),
    (f"match log.csv {PAIR} --pair a1,a2 --orthogonal a4", "two different pairs"),
    (f"match log.csv {PAIR} --loops", "--loops needs --online"),
    (f"record {SIM} --rows 3 -o log.nc", "log.nc: a recording is CSV or Parquet: name a .csv or .parquet"),
    (f"record {SIM} --rows 3 -o log.mcap", "a recording is CSV or Parquet"),
    (f"record {SIM} --rows 3 -o log.csv", "log.csv exists; a recording never replaces one: name another file"),
    (f"record {SIM} -o new.csv", "--rows"),
    ("record --rows 3 -o new.csv", "record needs either --bench FILE, or --sensor MODEL and --address ADDRESS"),
    ("record --sensor sca100t-d02 --rows 3 -o new.csv", "record needs either --bench FILE, or --sensor MODEL and"),
    (f"record {SIM} --bench bench.yaml --rows 3 -o new.csv", "record needs either --bench FILE, or --sensor MODEL and"),
    ("probe", "give a LOG alone, or the --address of a sensor"),
    ("probe log.csv --sensor sca100t-d02", "give a LOG alone, or the --address of a sensor"),
    ("probe log.csv --self-test", "give a LOG alone, or the --address of a sensor"),
    (f"probe log.csv {SIM}", "log.csv and --sensor sca100t-d02: --address takes one of them"),
    ("probe --address sim:", "--sensor is missing: the model that is connected there"),
    ("replay to", "there is no journal (*.journal.jsonl) in to"),
    (
        "replay to --samples new.csv",
        "several journals are compared with a folder, --golden DIR: leave -o and --samples out",
    ),
    ("replay j.jsonl j.jsonl -o new.yaml", "several journals are compared with a folder"),
    ("replay to --golden cal.yaml", "several journals are compared with a folder"),
    ("verify cal.yaml", "verify needs --address or --bench, where the sensor is connected (or --resume JOURNAL)"),
    ("verify cal.yaml --bench bench.yaml", "bench.yaml has no sensor S-1, which the calibration is of"),
    ("live cal.yaml", "cal.yaml names no address of its sensor: state --address"),
    ("live pairs.yaml --address sim:", "pairs.yaml"),
    ("report log.csv -o new.html", "no calibration file is given: name a CAL.yaml"),
    ("report nothing.yaml -o new.html", "nothing.yaml"),
    ("report cal.yaml other.yaml -o new.html", "not two calibrations of one sensor"),
    ("report other.yaml other.yaml cal.yaml -o new.html", "not two calibrations of one sensor"),
    ("report bench.yaml -o new.html", "kind"),
    ("report cal.yaml night.parquet -o new.html", "cannot read"),
    ("report cal.yaml segs.csv -o new.html", "no column 'x'"),
    ("report pairs.yaml pairs.yaml -o new.html", "a report of pairs is about one file"),
    (
        "report pairs.yaml log.csv --columns a1=x -o new.html",
        "--columns is for tilt calibrations; the columns of pairs are",
    ),
    ("history to", "to has no calibration files"),
    ("history . --interval year", "--interval: 'year' is no number of days; write it as 365d"),
    *(
        (f"history . --interval {days}", f"--interval: {days} is not between 0d and 36525d")
        for days in ("nan", "36526d", "-1d")
    ),
    ("plan plane", "name the --sensor model, or its calibration with --base"),
    ("measure plane", "measure needs --sensor, --address, --serial and -o (or --resume JOURNAL)"),
    (f"measure plane {SIM} {TO} --dry-run", "--dry-run moves the machines of a bench file: state --bench"),
    ("measure plane --bench bench.yaml --serial S-1", "the --bench file names the sensors: leave --sensor, --address"),
    (
        "measure plane --bench bench.yaml -o log.csv/to",
        "log.csv/to, the folder for the calibration files, cannot be made",
    ),
    (
        "measure rotation --sensor gradiometer --address sim: --serial G -o to",
        "the pairs of a stage have one file together",
    ),
    (f"fit six-face log.csv --unit g {TO}", "--segments"),
    (f"fit free log.csv --unit g {TO} --jig 0.1", "no jig"),
    (f"fit free log.csv --unit g {TO} --tilt 30", "no angle"),
    (f"fit free log.csv --unit g {TO} --table --segments segs.csv", "leave --segments out"),
    (f"fit free log.csv --unit g {TO} --table --columns x=a", "there is no column 'a'"),
    (f"fit free log.csv --unit g {TO} --sensor sca100t-d02", "three channels"),
    (f"fit free log.csv --unit g {TO}", "no threshold finds enough attitudes"),
    (f"fit free log.csv --unit g {TO} --gravity 1.0", "--gravity"),
    (f"fit free log.csv --unit g {TO} --gravity 9.95", "--gravity"),
    (f"fit free log.csv --unit g\x07 {TO}", "the unit"),
    (f"fit free log.csv --unit g {TO} --segments segs.csv", "3 free positions"),
]


@pytest.mark.parametrize(("command", "said"), REFUSED)
def test_what_does_not_go_together_is_refused_and_writes_nothing(command: str, said: str, tmp_path: Path) -> None:
    for name, text in (
        ("cal.yaml", PLAIN),
        ("CAL.YAML", PLAIN),
        ("wrong.yaml", PLAIN.replace("offset", "ofset")),
        ("none.yaml", PLAIN.replace("kind: tilt\n", "")),
        ("other.yaml", PLAIN.replace("S-1", "S-2")),
        ("pairs.yaml", (FIXTURES / "rotation.yaml").read_text()),
        ("bench.yaml", "tiltcal: 1\nkind: bench\nsensors: [{serial: B, model: sca100t-d02, address: 'sim:'}]\n"),
        ("log.csv", "time,x,y,z,mx,my,mz,u,v,w,h\n" + "0,1,2,3,1,1,1,1,1,1,5\n1,1.5,2,3,1,1,1,1,1,1,5\n" * 60),
        ("segs.csv", "position,start,end\na,0,9\nb,10,19\nc,20,29\n"),
    ):
        (tmp_path / name).write_text(text)
    (tmp_path / "to").mkdir()
    before = {path.name: path.is_dir() or path.read_text() for path in tmp_path.iterdir()}
    refused = tiltcal(*command.split(" "), cwd=tmp_path, code=2)
    assert (refused.stdout, said in refused.stderr) == ("", True), refused.stderr
    assert {path.name: path.is_dir() or path.read_text() for path in tmp_path.iterdir()} == before
    assert not list((tmp_path / "to").iterdir())


def test_a_serial_number_with_a_control_character(tmp_path: Path) -> None:
    """The file would be refused when it is read back, and the terminal obeys the character."""
    serial = ("--serial", "S\x1b[2J1", "-o", "new.yaml")
    (tmp_path / "log.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "seg.csv").write_text("position,start,end\nx-up,0,1\n")
    for result in (
        measure(*serial, cwd=tmp_path),
        tiltcal("fit", "six-face", "log.csv", "--segments", "seg.csv", "--unit", "V", *serial, cwd=tmp_path),
    ):
        assert result.returncode == 2
        assert "the serial number: the control character '\\x1b' is not allowed" in result.stderr
        assert not (tmp_path / "new.yaml").exists()


@pytest.mark.parametrize(
    ("closed", "arguments"),
    [
        ("stdin", (*MEASURE, "--operator", "terminal")),
        ("stdin", (*MEASURE, "--operator", "json")),
        ("stdout", (*MEASURE, "--operator", "json")),
        ("stdin", ("apply", FIXTURES / "plane.yaml", "-")),
    ],
)
def test_a_closed_standard_stream(closed: str, arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    """Python has None in its place."""
    streams = {"stdin": io.StringIO(), "stdout": io.StringIO(), "stderr": io.StringIO()} | {closed: None}
    assert called(arguments, tmp_path, **streams) == 2
    assert f"standard {closed.removeprefix('std')}put is closed" in streams["stderr"].getvalue()
    assert "continue with" not in streams["stderr"].getvalue(), "nothing was captured"
    assert not list(tmp_path.iterdir())


def test_a_session_without_standard_error(tmp_path: Path) -> None:
    arguments = [*TILTCAL, *MEASURE, "--operator", "sim", "--samples", "3"]
    done = subprocess.run(["sh", "-c", 'exec "$@" 2>&-', "sh", *arguments], cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert (tmp_path / "S-1.yaml").exists()
