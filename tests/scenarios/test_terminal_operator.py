"""A person at a real terminal (a pty): prompts, live reading, keys."""

from pathlib import Path

import pexpect
import pytest
from support.command import TILTCAL, measure, tiltcal
from support.warm_start import WarmStart

from tiltcal.bench.messages import PositionQuestion, Progress, Question, SessionEvent
from tiltcal.bench.operators import VirtualJig
from tiltcal.drivers.bus.clock import VirtualClock


def start(program: list[str], folder: Path, *options: str, procedure: str = "zero-45") -> pexpect.spawn:
    command, *arguments = [
        *(*program, "measure", procedure, "--sensor", "sca100t-d02", "--address", "sim:?seed=1"),
        *("--serial", "S-1", "-o", "S-1.yaml", "--samples", "20", *options),
    ]
    return pexpect.spawn(command, arguments, cwd=str(folder), encoding="utf-8", timeout=20, dimensions=(40, 120))


def accept(terminal: pexpect.spawn, position: str) -> None:
    terminal.expect(position)
    terminal.expect("live")
    terminal.send("\r")
    terminal.expect("Enter.* accept")
    terminal.send("\r")
    terminal.expect("accepted")


def test_the_whole_way_with_an_angle_a_temperature_and_a_redo(tmp_path: Path) -> None:
    terminal = start(TILTCAL, tmp_path)
    accept(terminal, "1/3  level")
    terminal.expect("2/3  x-45")
    for key, prompt, lines in (("a", "tilt of x actually set", ["lots", "44,9°"]), ("t", "temperature", ["21.5"])):
        terminal.expect("live")
        terminal.send(key)
        for line in lines:
            terminal.expect(prompt)
            terminal.sendline(line)
    terminal.expect("live")
    terminal.send("\r")
    terminal.expect("21.50 °C")
    terminal.expect("Enter.* accept")
    terminal.send("r")
    accept(terminal, "2/3  x-45")
    accept(terminal, "3/3  y-45")
    terminal.expect(r"Write S-1\.yaml\?")
    assert not (tmp_path / "S-1.yaml").exists()
    terminal.send("\r")
    terminal.expect(r"wrote.* S-1\.yaml")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 0
    # Live readings that were shown while it waited are in the journal, and replay.
    tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", cwd=tmp_path, code=0)


def test_ctrl_c_stops_and_keeps(warm: WarmStart, tmp_path: Path) -> None:
    terminal = start(warm.program, tmp_path)
    accept(terminal, "level")
    terminal.expect("x-45")
    terminal.expect("live")
    terminal.sendintr()
    terminal.expect(r"\x1b\[2Ktiltcal: interrupted")  # not behind the live reading
    terminal.expect(r"--resume S-1\.journal\.jsonl")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert (terminal.exitstatus, (tmp_path / "S-1.yaml").exists()) == (130, False)
    resumed = tiltcal("measure", "--resume", "S-1.journal.jsonl", "--plain", cwd=tmp_path, said="\n\n\n\nn\n", code=130)
    asked = [line.split()[1] for line in resumed.stderr.splitlines() if line[1:4] == "/3 "]
    assert ("kept from before: level" in resumed.stderr, asked) == (True, ["x-45", "y-45"])
    assert resumed.stderr.splitlines()[-1].startswith(
        "tiltcal: not written: the operator declined; everything measured is"
    )


def test_the_time_that_remains_is_learnt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each position holds for 300.2 s; its person takes 100 s, 300 s and 400 s, and 100 s: the median counts."""
    clock, moves, left = VirtualClock(), iter([100.0, 300.0, 400.0, 100.0, 100.0]), list[str]()

    class Slow(VirtualJig):
        def ask(self, question: Question) -> object:
            clock.sleep(move := next(moves) if isinstance(question, PositionQuestion) else 0.0)
            return {"answer": "redo"} if move == 300.0 else super().ask(question)

        def tell(self, event: SessionEvent) -> None:
            left.extend([event.left] if isinstance(event, Progress) else [])

    monkeypatch.setattr("tiltcal.bench.measure.VirtualJig", Slow)
    monkeypatch.setattr("tiltcal.bench.session.session_clock", lambda *_, **__: clock)
    measure("--samples", "20", "--settle", "300", cwd=tmp_path, code=0)
    assert left == ["at least 21 min left", *(f"about {minutes} min left" for minutes in (21, 21, 24, 7))]
    # Two temperatures at a thermometer that may be 360 s late, and twice 100 samples at 100 a second: 722 s.
    result = measure("--operator", "terminal", "--plain", cwd=tmp_path, procedure="two-temperature", said="q\n")
    assert "1/2  level-warm   at least 13 min left" in result.stderr
