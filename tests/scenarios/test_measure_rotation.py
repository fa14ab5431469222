"""`tiltcal measure rotation` as a laboratory runs it: a real serial line, a program that leads, and what goes wrong."""

from itertools import chain, repeat
from pathlib import Path

import pytest
from support import accelerometer_disk as disk
from support.command import tiltcal
from support.json_program import lead
from support.pty_device import printing

from tiltcal.library.calibration import read

# 50 lines a turn, 1500 lines a second, the last one again and again: 60 turns and more.
RECORD = disk.record(seconds=125.0, rate=25.0, spin=0.5, noise=3e-4, wander=0.01)
PAIRS = {"a1_a2": (0, 1, 3), "a3_a4": (2, 3, 0)}
JOURNAL = "pair.journal.jsonl"

OWN = """\
tiltcal: 1
kind: procedure
name: my-stage
title: Two pairs, quickly
rotation:
  phase: theta
  pairs:
    - {pair: [a1, a2], orthogonal: a4}
    - {pair: [a3, a4], orthogonal: a1}
  turns: 12
  patience: 0.5
"""


def test_a_real_line_led_by_a_program(tmp_path: Path) -> None:
    following = chain(lines := RECORD.lines(time=True), repeat(lines[-1]))
    (tmp_path / "own.yaml").write_text(OWN)
    with printing(lambda: next(following), 1500, waits=True) as path:
        address = f"serial://{path}?columns=time,theta,a1,a2,a3,a4&timeout=1"
        program = lead(
            *("measure", "./own.yaml", "--sensor", "serial-columns", "--address", address, "--serial", "G-1"),
            *("-o", "pair.yaml"),
            cwd=tmp_path,
        )
    assert program.exit_code == 0, program.errors
    assert program.told[0] == {
        "ask": "rotation",
        "pairs": [{"pair": ["a1", "a2"], "orthogonal": "a4"}, {"pair": ["a3", "a4"], "orthogonal": "a1"}],
        "turns": 12,
        "prompt": "Let the stage turn steadily, with its axis inclined.",
    }
    turns = program.events("turn")
    assert [turn["turn"] for turn in turns] == sorted({turn["turn"] for turn in turns})
    assert turns[-1]["turn"] == turns[-1]["of"] == 12
    assert set(turns[-1]["p"]) == set(turns[-1]["u_q"]) == {"a1_a2", "a3_a4"}
    (accepted,) = program.events("accepted")
    assert accepted["q"]["a1_a2"] == pytest.approx(disk.truth()[1], abs=1e-4)
    assert program.told[-1] == {"event": "done", "calibrations": ["pair.yaml"], "journal": JOURNAL}
    tiltcal("replay", JOURNAL, "--golden", "pair.yaml", cwd=tmp_path, code=0)
    written = read(tmp_path / "pair.yaml").record
    for matching in written.matchings:
        p, q = disk.truth(pair=PAIRS[matching.pair.name])
        assert (matching.p, matching.q) == (
            pytest.approx(p, abs=4.0 * matching.u_p), pytest.approx(q, abs=4.0 * matching.u_q)
        )  # fmt: skip
        # 3e-4 of noise on 3.4 at the turning, some hundred lines
        assert 0.0 < matching.u_p < 3e-5
    assert written.spin.phase == "theta"
    assert written.provenance.made_by == "measurement"
    assert written.provenance.bench.sensors[0].serial == "G-1"
    assert written.provenance.journal.name == JOURNAL
    checked = tiltcal("check", "pair.yaml", cwd=tmp_path)
    assert checked.stdout == "pair.yaml: pair calibration, good\n"


def test_several_devices_of_a_bench_are_named_as_record_names_them(tmp_path: Path) -> None:
    sensors = "".join(
        f'  - {{serial: {serial}, model: gradiometer, address: "sim:columns={channel}"}}\n'
        for serial, channel in (("table", "theta"), ("S1", "a1"), ("S2", "a2"), ("S4", "a4"))
    )
    (tmp_path / "bench.yaml").write_text(f"tiltcal: 1\nkind: bench\noperator: A. Person\nsensors:\n{sensors}")
    done = tiltcal(
        *("measure", "rotation", "--bench", "bench.yaml", "--operator", "sim", "--turns", "3", "-o", "pair.yaml"),
        cwd=tmp_path,
        code=0,
    )
    assert "a3 and a4 are not matched: there is no a3" in done.stderr
    written = read(tmp_path / "pair.yaml").record
    assert [matching.pair.channels for matching in written.matchings] == [("S1_a1", "S2_a2", "S4_a4")]
    assert written.spin.phase == "table_theta"
    assert written.provenance.operator == "A. Person"
    tiltcal("record", "--bench", "bench.yaml", "--rows", "9", "-o", "log.csv", cwd=tmp_path, code=0)
    tiltcal("apply", "pair.yaml", "log.csv", "-o", "out.csv", cwd=tmp_path, code=0)
