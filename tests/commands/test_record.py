"""``tiltcal record``: every row that was written is kept."""

import csv
import json
import re
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pytest
from support.adxl202_part import Adxl202Part, on_a_pty
from support.command import tiltcal
from support.warm_start import WarmStart, wait_until_grown

ONE = ("--sensor", "sca100t-d02", "--address", "sim:?seed=3")


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


def test_one_sensor_at_a_rate(tmp_path: Path) -> None:
    tiltcal("record", *ONE, "--rate", "5", "--for", "4", "-o", "log.csv", cwd=tmp_path, code=0)
    rows = rows_of(tmp_path / "log.csv")
    assert list(rows[0]) == ["time", "x", "y", "temperature"]
    assert len(rows) == 20
    seconds = [float(row["time"][17:-1]) for row in rows]
    assert seconds[-1] - seconds[0] == pytest.approx(19 / 5, abs=0.002)


def test_a_bench_to_parquet(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(
        "tiltcal: 1\nkind: bench\nthermometer: {model: thermistor, address: 'sim:'}\nsensors:\n"
        "  - {serial: A, model: adxl202, address: 'sim:'}\n  - {serial: B, model: sca3000-d01, address: 'sim:'}\n"
    )
    tiltcal(
        "record",
        "--bench",
        "bench.yaml",
        "--rows",
        "12",
        "--rate",
        "10",
        "-o",
        "log.parquet",
        cwd=tmp_path,
        code=0,
    )
    log = pl.read_parquet(tmp_path / "log.parquet")
    numbers = dict.fromkeys(["A_x", "A_y", "B_x", "B_y", "B_z", "temperature"], pl.Float64())
    assert log.schema == {"time": pl.Datetime("us", "UTC"), **numbers}
    assert len(log) == 12
    assert log["time"].diff().drop_nulls().dt.total_milliseconds().unique().to_list() == [100]
    assert not (tmp_path / "log.parquet.csv").exists()


def test_a_reading_that_fails_leaves_its_cells_empty(tmp_path: Path) -> None:
    (tmp_path / "twin.yaml").write_text(
        "tiltcal: 1\nkind: twin\nseed: 1\ntruth:\n  offset: {x: 1024, y: 1024}\n"
        "  sensitivity: {x: {x: 819, y: 0}, y: {x: 0, y: 819}}\n  faults: [{kind: unplugged, start: 1.0, end: 2.0}]\n"
    )
    result = tiltcal(
        *("record", "--sensor", "sca100t-d02", "--address", "sim:?twin=twin.yaml"),
        *("--rate", "10", "--for", "3", "-o", "log.csv"),
        cwd=tmp_path,
        code=0,
    )
    rows = rows_of(tmp_path / "log.csv")
    empty = [row for row in rows if row["x"] == ""]
    assert len(rows) == 30
    assert 9 <= len(empty) <= 11
    assert "readings missing" in result.stderr


@dataclass
class LossyPart(Adxl202Part):
    """A part of whose sentences each tenth is never sent."""

    def sentence(self) -> bytes:
        if self.sent % 10 == 9:
            self.sent += 1
        return super().sentence()


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_it_says_what_was_damaged_and_lost_on_the_line(name: str, tmp_path: Path) -> None:
    """Of ten sentences each tenth is missing, and of the others each third is damaged."""
    pytest.importorskip("serial", reason="the pyserial package is not installed")
    with on_a_pty(LossyPart(damage_one_in=3)) as path:
        given = ("--sensor", "adxl202", "--address", f"serial://{path}?baudrate=115200")
        done = tiltcal("record", *given, "--rows", "150", "-o", name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = re.search(r"150 rows in .*\nadxl202: 150 sentences, (\d+) damaged, (\d+) lost, 0 restarts", done.stderr)
    assert found, done.stderr
    damaged, lost = map(int, found.groups())
    assert damaged == pytest.approx(150 / 2, abs=15)
    assert lost == pytest.approx(150 / 6, abs=8)
    if name.endswith("parquet"):
        counts = json.loads(pl.read_parquet_metadata(tmp_path / name)["link_statistics"])
        assert counts == {"adxl202": {"sentences": 150, "damaged": damaged, "lost": lost, "restarts": 0}}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_stopped_in_the_middle_it_keeps_its_rows(number: int, warm: WarmStart, tmp_path: Path) -> None:
    """A virtual sensor without end: stopped by Ctrl-C, or killed, when the log has grown."""
    log = tmp_path / "log.csv"
    process = subprocess.Popen(
        [*warm.program, "record", *ONE, "--rows", "100000000", "-o", str(log)], stderr=subprocess.PIPE, text=True
    )
    wait_until_grown(process, log, 20_000)
    process.send_signal(number)
    said = process.communicate()[1]
    rows = rows_of(log)
    assert len(rows) > 300
    assert all(len([cell for cell in row.values() if cell]) == 4 for row in rows[:-1])
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert f"{len(rows)} rows in" in said
