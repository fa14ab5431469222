"""A program leads the session over JSON Lines (the contract of SPEC section 11)."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command import TILTCAL, measure

from tiltcal.bench.operators.json_lines import understood
from tiltcal.errors import InputError
from tiltcal.files.calibration import read_calibration


class Table:
    """A tilt table's program: answers every ask by a function, and keeps what it was told."""

    def __init__(self, folder: Path, answer: Callable[[dict[str, Any], int], Any], *options: str) -> None:
        command = [
            *(*TILTCAL, "measure", *options, "--sensor", "sca100t-d02", "--address", "sim:?seed=1"),
            *("--serial", "S-1", "-o", "S-1.yaml", "--operator", "json", "--samples", "20"),
        ]
        self.told: list[dict[str, Any]] = []
        with subprocess.Popen(
            command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            if process.stdin is None or process.stdout is None or process.stderr is None:
                raise RuntimeError("no pipes")
            for line in process.stdout:
                message = json.loads(line)
                self.told.append(message)
                if "ask" in message:
                    said = answer(message, len(self.asks))
                    if said is None:
                        process.stdin.close()
                        break
                    process.stdin.write((said if isinstance(said, str) else json.dumps(said)) + "\n")
                    process.stdin.flush()
            self.errors = process.stderr.read()
        self.exit_code = process.returncode

    @property
    def asks(self) -> list[dict[str, Any]]:
        return [message for message in self.told if "ask" in message]

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.told if message.get("event") == kind]


def ready(ask: dict[str, Any], number: int) -> dict[str, Any]:
    return {"answer": "ready"}


def test_the_dialogue_is_the_contract(tmp_path: Path) -> None:
    table = Table(tmp_path, ready, "plane")
    assert table.exit_code == 0, table.errors
    ask = table.asks[2]
    assert ask["prompt"].count("30°") == 1
    assert ask == {
        "ask": "position",
        "position": "y-tilt1",
        "tilt": {"y": 30.0},
        "gravity": [0.0, 0.5, pytest.approx(0.866, abs=1e-3)],
        "heading": 0,
        "temperature": None,
        "prompt": ask["prompt"],
    }
    assert "30°" in ask["prompt"]
    accepted = table.events("accepted")
    assert [event["position"] for event in accepted] == ["x-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"]
    assert set(accepted[0]) >= {"event", "position", "mean", "std", "n"}
    assert set(accepted[0]["mean"]) == {"x", "y"}
    assert accepted[0]["n"] == 20
    assert table.told[-1] == {"event": "done", "calibrations": ["S-1.yaml"], "journal": "S-1.journal.jsonl"}


def test_the_angle_actually_set_counts(tmp_path: Path) -> None:
    def answer(ask: dict[str, Any], number: int) -> dict[str, Any]:
        axis, angle = next(iter(ask["tilt"].items()))
        return {"answer": "ready", "tilt": {axis: angle + 0.5}}

    table = Table(tmp_path, answer, "plane")
    assert table.exit_code == 0, table.errors
    written = read_calibration(tmp_path / "S-1.yaml")
    assert written.procedure["set"]["y-tilt1"] == {"tilt": {"y": 30.5}}


def test_a_typed_temperature_counts(tmp_path: Path) -> None:
    table = Table(
        tmp_path, lambda ask, n: {"answer": "ready", "temperature": (ask["temperature"] or 20) + 0.25}, "mavs"
    )
    assert table.exit_code == 0, table.errors
    thermal = read_calibration(tmp_path / "S-1.yaml").coefficients.thermal
    assert thermal is not None
    assert thermal.range == (5.75, 24.25)


def test_redo_asks_again_and_back_goes_back(tmp_path: Path) -> None:
    words = iter(["redo", "ready", "ready", "back", "ready", "ready", "ready", "ready"])
    table = Table(tmp_path, lambda ask, n: {"answer": next(words)}, "plane")
    assert table.exit_code == 0, table.errors
    assert [ask["position"] for ask in table.asks] == [
        *("x-tilt1", "x-tilt1", "x-tilt2", "y-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"),
    ]
    assert next(words) == "ready"


def test_quit_keeps_what_was_measured(tmp_path: Path) -> None:
    table = Table(tmp_path, lambda ask, n: {"answer": "ready" if n < 3 else "quit"}, "plane")
    assert table.exit_code == 130
    assert "--resume S-1.journal.jsonl" in table.errors
    assert not (tmp_path / "S-1.yaml").exists()
    resumed = measure("--resume", "S-1.journal.jsonl", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert (tmp_path / "S-1.yaml").exists()


def test_a_program_that_goes_away_is_a_quit(tmp_path: Path) -> None:
    table = Table(tmp_path, lambda ask, n: {"answer": "ready"} if n < 2 else None, "plane")
    assert table.exit_code == 130
    assert not (tmp_path / "S-1.yaml").exists()


@pytest.mark.parametrize(
    "rubbish",
    [
        "what?",
        "[]",
        '{"answer": "yes"}',
        '{"answer": "ready", "tilt": {"y": "30"}}',
        '{"answer": "ready", "tilt": {"y": NaN}}',
        '{"answer": "ready", "tilt": {"y": 95}}',
        '{"answer": "ready", "tilt": {"q": 3}}',
        '{"answer": "ready", "gravity": [0, 0, 0]}',
        '{"answer": "ready", "angle": 30}',
    ],
)
def test_an_answer_that_will_not_do_is_refused_with_the_reason(rubbish: str, tmp_path: Path) -> None:
    table = Table(tmp_path, lambda ask, n: rubbish if n == 1 else {"answer": "ready"}, "plane")
    assert table.exit_code == 0, table.errors
    refused = table.events("refused")
    assert [event["position"] for event in refused] == ["x-tilt1"]
    assert refused[0]["why"]
    assert [ask["position"] for ask in table.asks[:2]] == ["x-tilt1", "x-tilt1"]


@given(st.text() | st.binary().map(lambda data: data.decode(errors="replace")))
def test_any_line_is_an_answer_or_an_input_error(line: str) -> None:
    with suppress(InputError):
        understood(line)
