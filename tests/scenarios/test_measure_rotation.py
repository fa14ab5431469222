"""`tiltcal measure rotation` as a laboratory runs it: a real serial line, a program that leads, and what goes wrong."""

import random
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from itertools import chain, repeat
from pathlib import Path

import pexpect
import pytest
from support import accelerometer_disk as disk
from support.command import tiltcal
from support.json_program import Event, ProgramSession, lead
from support.pty_device import printing
from support.warm_start import WarmStart, wait_until_grown

from tiltcal.library.calibration import read

# 50 lines a turn: 60 turns and more.
RECORD = disk.record(seconds=125.0, rate=25.0, spin=0.5, noise=3e-4, wander=0.01)
LINES = RECORD.lines(time=True)
PAIRS = {"a1_a2": (0, 1, 3), "a3_a4": (2, 3, 0)}
JOURNAL = "pair.journal.jsonl"


def on_a_pty(lines: Sequence[bytes]) -> AbstractContextManager[str]:
    """Print 1500 lines a second on a pseudo-terminal, the last one again and again; they wait for whoever reads."""
    following = chain(lines, repeat(lines[-1]))
    return printing(lambda: next(following), 1500, waits=True)


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


def options(address: str) -> list[str]:
    return [
        *("measure", "./own.yaml", "--sensor", "serial-columns", "--address", address, "--serial", "G-1"),
        *("-o", "pair.yaml"),
    ]


def serial(path: str) -> str:
    return f"serial://{path}?columns=time,theta,a1,a2,a3,a4&timeout=1"


def led(folder: Path, address: str, hear: Callable[[Event], str | None] = lambda said: None) -> ProgramSession:
    """Lead a session: take what is asked for, hear every event, and say what ``hear`` returns."""

    def answer(message: Event) -> object:
        word = hear(message) or ("ready" if "ask" in message else None)
        return {"answer": word} if word else None

    (folder / "own.yaml").write_text(OWN)
    return lead(*options(address), cwd=folder, answer=answer)


def require_truth(path: Path, sigmas: float = 4.0) -> None:
    for matching in read(path).record.matchings:
        p, q = disk.truth(pair=PAIRS[matching.pair.name])
        assert matching.p == pytest.approx(p, abs=sigmas * matching.u_p)
        assert matching.q == pytest.approx(q, abs=sigmas * matching.u_q)
        # 3e-4 of noise on 3.4 at the turning, some hundred lines
        assert 0.0 < matching.u_p < 3e-5


def require_replay(folder: Path) -> None:
    again = tiltcal("replay", JOURNAL, "-o", "again.yaml", cwd=folder)
    assert again.returncode == 0, again.stderr
    assert (folder / "again.yaml").read_bytes() == (folder / "pair.yaml").read_bytes()


def test_a_real_line_led_by_a_program(tmp_path: Path) -> None:
    with on_a_pty(LINES) as path:
        program = led(tmp_path, serial(path))
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
    require_truth(tmp_path / "pair.yaml")
    require_replay(tmp_path)
    written = read(tmp_path / "pair.yaml").record
    assert written.spin.phase == "theta"
    assert written.provenance.made_by == "measurement"
    assert written.provenance.bench.sensors[0].serial == "G-1"
    assert written.provenance.journal.name == JOURNAL
    checked = tiltcal("check", "pair.yaml", cwd=tmp_path)
    assert checked.stdout == "pair.yaml: pair calibration, good\n"


def test_killed_at_a_random_moment_on_a_real_line(warm: WarmStart, tmp_path: Path) -> None:
    size = random.Random(1).randrange(1500, 90_000)
    (tmp_path / "own.yaml").write_text(OWN)
    with on_a_pty(LINES) as path:
        with subprocess.Popen(
            [*warm.program, *options(serial(path)), "--operator", "json"],
            cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        ) as process:  # fmt: skip
            if process.stdin is None:
                raise RuntimeError("no pipe")
            process.stdin.write(b'{"answer": "ready"}\n')
            process.stdin.flush()
            wait_until_grown(process, tmp_path / JOURNAL, size)
            process.send_signal(signal.SIGKILL)
            process.communicate()  # all that had its streams have ended
        resumed = tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path, said='{"answer": "ready"}\n')
    assert resumed.returncode == 0, resumed.stderr
    require_truth(tmp_path / "pair.yaml")
    require_replay(tmp_path)


def test_several_devices_of_a_bench_are_named_as_record_names_them(tmp_path: Path) -> None:
    sensors = "".join(
        f'  - {{serial: {serial}, model: gradiometer, address: "sim:columns={channel}"}}\n'
        for serial, channel in (("table", "theta"), ("S1", "a1"), ("S2", "a2"), ("S4", "a4"))
    )
    (tmp_path / "bench.yaml").write_text(f"tiltcal: 1\nkind: bench\noperator: A. Person\nsensors:\n{sensors}")
    done = tiltcal(
        *("measure", "rotation", "--bench", "bench.yaml", "--operator", "sim", "--turns", "3", "-o", "pair.yaml"),
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert "a3 and a4 are not matched: there is no a3" in done.stderr
    written = read(tmp_path / "pair.yaml").record
    assert [matching.pair.channels for matching in written.matchings] == [("S1_a1", "S2_a2", "S4_a4")]
    assert written.spin.phase == "table_theta"
    assert written.provenance.operator == "A. Person"
    recorded = tiltcal("record", "--bench", "bench.yaml", "--rows", "9", "-o", "log.csv", cwd=tmp_path)
    assert recorded.returncode == 0, recorded.stderr
    assert tiltcal("apply", "pair.yaml", "log.csv", "-o", "out.csv", cwd=tmp_path).returncode == 0


def test_a_person_stops_it_with_a_key(warm: WarmStart, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(OWN.replace("turns: 12", "turns: 100000"))
    with on_a_pty(disk.record(seconds=800.0, rate=25.0, spin=0.5).lines(time=True)) as path:
        command, *arguments = [*warm.program, *options(serial(path))]
        person = pexpect.spawn(
            command, arguments, cwd=str(tmp_path), encoding="utf-8", timeout=60, dimensions=(24, 200)
        )
        for expected, key in (("Let the stage turn", "\r"), ("turn 3 of 100000", "s"), ("Write pair.yaml", "\r")):
            person.expect(expected)
            person.send(key)
        person.expect("wrote")
        person.expect(pexpect.EOF)
        person.close()
    assert person.exitstatus == 0
    require_truth(tmp_path / "pair.yaml")
    require_replay(tmp_path)
