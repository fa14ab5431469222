"""Whatever wrote the log: every kind is calibrated within 1 mg, and ``apply`` writes a row for each reading."""

import json
import re
from itertools import islice
from pathlib import Path
from time import process_time

import numpy as np
import polars as pl
import pytest
import yaml
from support import ROOT
from support.command import tiltcal
from support.kinds_of_logs import ENCODINGS, KINDS, OFFSET, READINGS, UNNAMED, rows, write_kind

import tiltcal as library
from tiltcal.errors import InputError
from tiltcal.log_head import dialect_of
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogClock

WRITTEN = yaml.safe_load((ROOT / "tests" / "support" / "kinds_of_logs.yaml").read_text(encoding="utf-8"))
TWO_DIGITS = "Arduino monitor", "labels, three kinds of line", "line of units"
PER_G = {"g": 1.0, "mg": 1e3, "m/s2": 9.80665, "mm/s2": 9806.65}


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_is_probed_fitted_and_applied(kind: str, tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    write_kind(kind, log)
    probed = tiltcal("probe", log, "--json", cwd=tmp_path, code=0)
    said = json.loads(probed.stdout)
    assert (said["rows"], said["attitudes"], said["different"]) == (len(READINGS), 16, 16)
    columns = ("--columns", UNNAMED[kind]) if kind in UNNAMED else ()
    axes = {column["role"]: column for column in said["columns"] if column["role"] in ("x", "y", "z")}
    places = ",".join(f"{axis}={axes[axis]['number']}" for axis in "xyz")
    stated = f" --columns {places} --unit {axes['x']['unit']}" if axes["x"]["name"].isdigit() else ""
    assert said["next"] == f"tiltcal fit free {log}{stated} --serial NAME -o NAME.yaml"
    tiltcal("fit", "free", log, *columns, "--serial", "A", "-o", "a.yaml", cwd=tmp_path, code=0)
    found = library.read(tmp_path / "a.yaml")
    offsets = [found.offset[axis] / PER_G[found.sensor.unit] for axis in "xyz"]
    assert np.abs(np.array(offsets) - OFFSET).max() < 1e-3
    summary = tiltcal("apply", "a.yaml", log, "-o", "out.parquet", "--json", cwd=tmp_path)
    assert json.loads(summary.stdout)["rows"] == len(READINGS), summary.stderr
    above = KINDS[kind][0].splitlines()[: WRITTEN[kind]["head"][0]]
    above = [line for place, line in enumerate(above) if place != WRITTEN[kind]["head"][1]]
    noted = pl.read_parquet_metadata(tmp_path / "out.parquet").get("header")
    assert noted == ("\n".join(line for line in above if line.strip()) or None)
    roles = {column["role"]: column["number"] - 1 for column in said["columns"] if column["role"]}
    roles |= {one[0]: int(one[2:]) - 1 for one in UNNAMED.get(kind, "").split(",") if one}
    where, time, per_g = [roles[axis] for axis in "xyz"], roles.get("time"), PER_G[found.sensor.unit]
    with open_log(log) as opened:
        blocks = list(opened.rows([*roles.values()], time))
    read = np.concatenate([block.readings(where) for block in blocks])
    np.testing.assert_allclose(read, per_g * READINGS, atol=0.00051 if kind not in TWO_DIGITS else 0.0051)
    times = [] if time is None else np.concatenate([block.values[time] for block in blocks])
    assert np.diff(times) == pytest.approx(0.01, abs=1e-6)
    assert (said["rate"], said["bad_rows"], said["missing"]) == (None if time is None else 100.0, 0, {})
    assert said["length"] == pytest.approx(1.0115 * per_g, rel=1e-3)
    layout = said["layout"]["rows from line"], said["layout"]["encoding"], said["layout"]["clock in front"]
    encoding = {"utf-16": "UTF-16", "cp1252": "Windows-1252"}.get(ENCODINGS.get(kind, ""), "UTF-8")
    assert layout == (KINDS[kind][0].count("\n") + 1, encoding, "yes" if kind == "Arduino monitor" else None)


@pytest.mark.parametrize("kind", KINDS)
def test_how_a_kind_is_written(kind: str) -> None:
    """The whole dialect, by the first 300 rows."""
    head, row = KINDS[kind]
    found = dialect_of((head + "".join(row(one) + "\n" for one in islice(rows(), 300))).splitlines())
    marks = {"header": found.has_header, "blanks": found.has_blanks, "clock": found.has_clock, "sum": found.has_sum}
    letters = {"number": "n", "time": "t", "missing": "m", "text": "x"}
    patterns = [] if found.pattern is None else [found.pattern, *found.others]
    assert {
        "names": [*found.names],
        "kinds": "".join(letters[one] for one in found.kinds),
        "units": dict(found.units),
        "fields": [found.separator, found.decimal],
        "head": [found.first, found.named],
        "marks": [mark for mark, there in marks.items() if there],
        "dates": found.dates,
        "comments": [*found.comments],
        "patterns": [[*(one.keys or one.texts)] for one in patterns],
    } == {
        "units": {},
        "fields": [",", "."],
        "marks": ["header"],
        "dates": "",
        "comments": ["#", "//", "%"],
        "patterns": [],
    } | WRITTEN[kind]


def test_an_array_of_json_is_refused_with_what_makes_a_log_of_it(tmp_path: Path) -> None:
    (tmp_path / "log.json").write_text('[\n {"ax": 0.1, "ay": 0.2},\n {"ax": 0.1, "ay": 0.3}\n]\n')
    assert "jq -c '.[]'" in tiltcal("probe", "log.json", cwd=tmp_path, code=2).stderr


def test_the_page_on_logs_names_every_kind() -> None:
    page = (ROOT / "docs" / "how-to" / "my-log.md").read_text(encoding="utf-8")
    assert [kind for kind in KINDS if kind not in page] == []


@pytest.mark.parametrize(
    ("begin", "what"),
    [
        (b"PK\x03\x04" + bytes(80), "ZIP archive.*save the sheet as CSV"),
        (b"MD\xfc\x03" + bytes(600), "Axivity.*cwa-convert"),
        (b"\x1f\x8b\x08\x00", "gzip.*zcat"),
        (b"PAR1\x15\x04", "name it .parquet"),
        (b"\x01\x02\x00\x03" * 64, "no text"),
    ],
)
def test_a_file_that_is_no_text_is_refused_by_what_it_is(begin: bytes, what: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(begin)
    with pytest.raises(InputError, match=what), open_log(tmp_path / "log.csv"):
        pass


def test_other_names_inside_the_table_are_named_with_both(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("x,y\n1,2\n1,2\ny,x\n1,2\n")
    why = r"log\.csv:4: the columns change here: 'y,x' behind 'x,y'; cut the log in two at this line"
    with open_log(tmp_path / "log.csv", skip_bad_rows=True) as log, pytest.raises(InputError, match=why):
        list(log.rows([1]))


def test_a_byte_that_is_no_utf_8_is_replaced_alone_and_said(tmp_path: Path) -> None:
    rows = ["1.5,20 °C".encode()] * 6000
    rows[5000] = b"1.5,20 \xb0C"
    (tmp_path / "log.csv").write_bytes(b"x,note \xc2\xb0\n" + b"\n".join(rows) + b"\n")
    with open_log(tmp_path / "log.csv") as log:
        notes = [line for block in log.rows([0]) for line in block.lines.to_list()]
        assert log.remarks == ["1 byte outside UTF-8: replaced by \ufffd"]
    assert (notes[0], notes[5000], notes[5999]) == ("1.5,20 °C", "1.5,20 \ufffdC", "1.5,20 °C")


def test_a_row_that_stands_before_the_table_too_is_a_row(tmp_path: Path) -> None:
    """Also beside a damaged row, where the block is read line by line."""
    rows = [f"{time}.0\t9.78\t0.21\t0.18\t" for time in range(0, 200, 10)]
    head = [rows[4], '"sep=\t"', "A1_Unix\tA1_Accel_X\tA1_Accel_Y\tA1_Accel_Z", "ms\tm/(s^2)\tm/(s^2)\tm/(s^2)"]
    rows[12] = rows[12].replace("9.78", "9.x78")
    (tmp_path / "log.txt").write_text("\n".join([*head, *rows, ""]))
    with open_log(tmp_path / "log.txt", skip_bad_rows=True) as log:
        times = [time for block in log.rows(range(4)) for time in block.values[0].tolist()]
    assert (times[:12], len(times)) == ([10.0 * number for number in range(12)], 20)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["date,u,v", "2026-03-01,1,2", "2026-03-02,2,3"], "1  date +-\n +2  u +-"),
        (["name,incl_a", "foo,1", "bar,2"], "2 rows\nnext: tiltcal apply"),
        ([f"0.05|{k}|-0.1|3{k % 3}.5|20.5" for k in range(60)], "60 rows"),
    ],
)
def test_a_log_without_known_readings_is_described_from_a_pipe_too(lines: list[str], said: str, tmp_path: Path) -> None:
    text = "\n".join([*lines, ""])
    (tmp_path / "log.csv").write_text(text)
    pl.read_csv(tmp_path / "log.csv", has_header=not lines[0][0].isdigit()).write_parquet(tmp_path / "log.parquet")
    for log in ("log.csv", "-", "log.parquet"):
        assert re.search(said, tiltcal("probe", log, cwd=tmp_path, said=text if log == "-" else "", code=0).stdout)
    tiltcal("probe", "log.csv", "--self-test", cwd=tmp_path, code=2)


NOISE = np.random.default_rng(0).normal(0.0, 0.01, (3000, 3))
TURNED = np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [0.8, 0.0, 0.6], [-0.6, 0.8, 0.0]]])
PROBED = {
    "rest.csv": (
        "time (ms),x (V),y (V),note\n"
        + "".join(f"{10 * k},{x:.4f},{y:.4f},a\n" for k, (x, y, _) in enumerate(NOISE))
        + "9,?,2,a\n",
        "rows from line 2, names in line 1, fields by commas, encoding UTF-8\n"
        "    1  time (ms)                    time         [ms] by its header\n"
        "    2  x (V)                        x            [V] by its header\n"
        "    3  y (V)                        y            [V] by its header\n"
        "    4  note                         -\n"
        "3001 rows, 100 Hz, 1 row that cannot be parsed\n"
        "  column 'time (ms)' is in ms, by its name: seconds are used inside\n"
        "1 still attitude, 1 of them different\n"
        "next: tiltcal apply CAL.yaml rest.csv -o TILT.csv\n",
    ),
    "means.csv": (
        "position;x;y;z\n" + "".join(f"p{k};{x:.4f};{y:.4f};{z:.4f}\n" for k, (x, y, z) in enumerate(9.81 * TURNED)),
        "rows from line 2, names in line 1, fields by semicolons, encoding UTF-8\n"
        "    1  position                     -\n    2  x                            x\n"
        "    3  y                            y\n    4  z                            z\n10 rows\n"
        "at rest the readings are 9.81 long\n"
        "next: tiltcal fit free means.csv --table --unit UNIT --serial NAME -o NAME.yaml, if each row is a mean\n",
    ),
    "held.txt": (
        "".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in 9.81 * (np.repeat(np.eye(3), 1000, axis=0) + NOISE)),
        "rows from line 1, fields by blanks, encoding UTF-8\n"
        "    1  1                            x            [m/s2] by the length of gravity at rest\n"
        "    2  2                            y            [m/s2] by the length of gravity at rest\n"
        "    3  3                            z            [m/s2] by the length of gravity at rest\n"
        "3000 rows\nat rest the readings are 9.81 long\n"
        "3 still attitudes, 3 of them different; none with ±x and ±y and ±z up\n"
        "next: tiltcal fit six-face held.txt --columns x=1,y=2,z=3 --unit m/s2 --serial NAME -o NAME.yaml\n",
    ),
    "gaps.csv": (
        "ax,ay,az\n" + "".join(f"{x:.4f},{'' if y > 0.02 else f'{y:.4f}'},{1 + z:.4f}\n" for x, y, z in NOISE),
        "rows from line 2, names in line 1, fields by commas, encoding UTF-8\n"
        "    1  ax                           x            [g] by the length of gravity at rest\n"
        "    2  ay                           y            [g] by the length of gravity at rest\n"
        "    3  az                           z            [g] by the length of gravity at rest\n"
        f"3000 rows\n  ay: missing in {int((NOISE[:, 1] > 0.02).sum())} rows\n"
        "at rest the readings are 1.00 long\n1 still attitude, 1 of them different\n"
        "next: tiltcal noise gaps.csv --unit g\n",
    ),
}


@pytest.mark.parametrize("name", PROBED)
def test_what_is_in_a_log_is_told_in_whole_words(name: str, tmp_path: Path) -> None:
    content, said = PROBED[name]
    (tmp_path / name).write_text(content)
    text = tiltcal("probe", name, cwd=tmp_path, code=0).stdout
    text = re.sub(r"(?<=readings are )[\d.]+", lambda length: f"{float(length[0]):.2f}", text)
    assert re.sub("[+-](?=[xyz] )", "±", text) == f"{name}: {said}"


def test_a_log_without_a_sound_row_is_refused_by_its_first_and_a_pipe_is_described(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text := "x,y,z\n1,2,?\n3,4,?\n")
    refused = tiltcal("probe", "log.csv", cwd=tmp_path, code=2)
    assert refused.stderr == "tiltcal: log.csv:2: column 'z': '?' is no number\n"
    assert "2 rows, 2 rows that cannot be parsed" in tiltcal("probe", "-", cwd=tmp_path, said=text, code=0).stdout


def test_the_first_times_of_a_log_decide_their_unit() -> None:
    """Elapsed nanoseconds reach 1e12 after 1000 s, as milliseconds since 1970 begin in 2001."""
    times, clock = np.arange(0.0, 1.1e12, 1e11), LogClock()
    parts = [clock.seconds(part, None, None, "log.csv")[0] for part in (times[:10], times[10:])]
    assert np.concatenate(parts).tolist() == times.tolist()
    assert clock.remarks == []
    for part in ([10.0, 11, 11, 12, 0, 1, 2, 3, 4, 5], [np.nan], [5.0, 7, 6, 8, 9, 10, 11, 12, 3]):
        clock = LogClock() if part[0] == 10.0 else clock
        clock.seconds(np.array(part), None, "s", "log.csv")
    assert clock.remarks == [
        "the time starts again 1 time, first at row 4", "the time goes back 2 times, first at row 13",
        "the time stands still 2 times",
    ]  # fmt: skip


def test_dates_that_leave_their_order_open_are_named(tmp_path: Path) -> None:
    rows = [f"01/03/2026 09:00:{k:02},0,0,{1 + k % 2}" for k in range(30)]
    (tmp_path / "log.csv").write_text("\n".join(["time,x,y,z", *rows, ""]))
    assert "whose order of day and month nothing shows" in tiltcal("probe", "log.csv", cwd=tmp_path).stdout
    refused = tiltcal("noise", "log.csv", "--unit", "g", cwd=tmp_path, code=2)
    assert "log.csv:2: column 'time' holds '01/03/2026 09:00:00', and nothing shows whether the day" in refused.stderr


@pytest.mark.parametrize("lines", [[",".join(["1.5"] * 4000)] * 4, [" ".join(["ab"] * 650 + ["1"])] * 20])
def test_the_time_of_a_head_is_in_proportion_to_its_length(lines: list[str]) -> None:
    """Each took 2 s and more where it grew with the square."""
    began = process_time()
    assert len(dialect_of(lines).names) in (4000, 651)
    assert process_time() - began < 1.5
