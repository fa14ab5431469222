"""A person at a page in a browser: what the page gets and sends, and what nobody else can send."""

from __future__ import annotations

import json
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from math import asin, degrees
from pathlib import Path
from typing import Any

import pytest
from support import FIXTURES
from support.command import tiltcal
from support.warm_start import WarmStart
from support.web_client import WebClient, session

from tiltcal import measure
from tiltcal.bench.guidance import CALIBRATED, OWN_FRAME
from tiltcal.errors import Stopped, UsageError
from tiltcal.files.calibration import read_calibration


def sensor(folder: Path, **options: Any) -> dict[str, Any]:
    one = {"sensor": "sca100t-d02", "address": "sim:?seed=1", "serial": "S-1", "output": folder / "S-1.yaml"}
    return {**one, "samples": 20, **options}


def accept(page: WebClient, *positions: str) -> None:
    for position in positions:
        assert page.answer(page.asked("position", position), "ready") == 204
        assert page.answer(page.asked("review", position), "accept") == 204


def guide_at(page: WebClient, position: str) -> dict[str, Any]:
    """Return what the page draws while a position is asked for."""
    page.asked("position", position)
    guide: dict[str, Any] = page.until(lambda one: one["guide"])["guide"]
    return guide


@pytest.mark.parametrize("procedure", ["level", "mounting"])
def test_what_completes_a_calibration_shows_calibrated_angles(procedure: str, tmp_path: Path) -> None:
    """A sensor that sits askew by roll 1.5° and pitch -1.0°, on a table that is level."""
    twin = (FIXTURES / "twins" / "sca100t-d02.yaml").read_text(encoding="utf-8")
    (tmp_path / "askew.yaml").write_text(twin + "  mounting: {roll: 1.5, pitch: -1.0}\n", encoding="utf-8")
    options = {"base": FIXTURES / "complete.yaml", "serial": "SIM-42", "address": f"sim:twin={tmp_path / 'askew.yaml'}"}
    with session(procedure, **sensor(tmp_path, **options)) as (page, _):
        seen = guide_at(page, "level")
        x, y, _ = (degrees(asin(one)) for one in seen["sensors"][0]["present"])
        assert (abs(x), abs(y)) == pytest.approx((1.0, 1.5), abs=0.25)
        assert seen["ok"] is None
        if procedure == "mounting":
            assert (seen["target"], seen["note"]) == (None, OWN_FRAME)
        else:
            assert (seen["fits"], seen["note"]) == (True, CALIBRATED)
            assert seen["sides"] == ["+X", "+Y"]


def journal(folder: Path) -> str:
    return (folder / "S-1.journal.jsonl").read_text(encoding="utf-8").replace(": ", ":")


def test_the_whole_way_with_results_report_and_verification(tmp_path: Path) -> None:
    with session("zero-45", **sensor(tmp_path)) as (page, outcome):
        accept(page, "level", "x-45", "y-45")
        assert not (tmp_path / "S-1.yaml").exists()
        assert page.answer(page.asked("write"), "yes") == 204
        live = page.until(lambda one: one["live"])["live"]["S-1"]
        assert [name for name, _, _ in live][:2] == ["tilt x", "tilt y"]
        assert page.answer(page.asked("afterwards"), "report") == 204
        page.until(lambda one: one["results"] and one["results"][0].get("report"))
        assert page.request("GET", "/report/S-1")[2] == (tmp_path / "S-1.html").read_bytes()
        assert page.answer(page.asked("afterwards"), "verify") == 204
        seen = guide_at(page, "level")
        assert abs(seen["worst"]["angle"]) < 0.3
        assert (seen["ok"], seen["fits"], seen["note"]) == (None, True, CALIBRATED)
        accept(page, "level", "x-up", "x-down", "y-up", "y-down", "both-up")
        assert "limit 0.5°" in page.until(lambda one: one["results"][0].get("verdict"))["results"][0]["verdict"]
        assert page.answer(page.asked("afterwards"), "finish") == 204
    assert [type(one).__name__ for one in outcome] == ["Calibration"]
    replayed = tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr


def test_what_is_typed_reaches_the_file_and_what_is_no_angle_is_refused(tmp_path: Path) -> None:
    with session("zero-45", **sensor(tmp_path)) as (page, _):
        accept(page, "level")
        question = page.asked("position", "x-45")
        for unread in ({"tilt": {"x": "1.000,5"}}, {"tilt": {"x": None}}, {"temperature": "70 °F"}):
            assert page.answer(question, "ready", **unread) == 422
        for wrong in ({"tilt": {"x": 100}}, {"tilt": [1]}, {"more": 1}):
            assert page.answer(page.asked("position", "x-45"), "ready", **wrong) == 204
            page.until(lambda one: one["refused"])
        page.answer(page.asked("position", "x-45"), "ready", tilt={"x": "44,9°"}, temperature="21.5 °C")
        assert page.answer(page.asked("review", "x-45"), "accept") == 204
        accept(page, "y-45")
        page.answer(page.asked("write"), "yes")
        page.asked("afterwards")
    answers = [json.loads(line)[2] for line in journal(tmp_path).splitlines() if '"to":"position"' in line]
    assert answers[-2] == {"to": "position", "answer": "ready", "tilt": {"x": 44.9}, "temperature": 21.5}
    assert read_calibration(tmp_path / "S-1.yaml").positions[1].temperature == 21.5


def test_nothing_is_pressed_from_elsewhere(tmp_path: Path) -> None:
    with session("zero-45", **sensor(tmp_path)) as (page, outcome):
        question = page.asked("position", "level")
        answer = {"id": question["id"], "answer": "ready"}
        evil = "http://evil.example"
        cases: list[tuple[str, str, object, dict[str, str], int]] = [
            ("POST", "/answer", answer, {"Origin": evil}, 403),
            ("POST", "/answer", answer, {"Origin": ""}, 403),
            ("POST", "/answer", answer, {"Origin": "null"}, 403),
            ("POST", "/answer", answer, {"Origin": "http://127.0.0.1:1"}, 403),  # another program of this machine
            ("POST", "/answer", answer, {"Host": "evil.example", "Origin": evil}, 403),  # a name that leads here
            ("POST", "/answer", {**answer, "id": "0badcafe-1"}, {}, 409),  # of an earlier session
            ("POST", "/answer", {**answer, "id": question["id"] + "0"}, {}, 409),
            ("POST", "/answer", {"answer": "ready"}, {}, 409),
            ("POST", "/answer", "ready", {}, 400),
            ("POST", "/answer", "[" * 4000, {}, 400),
            ("POST", "/token", answer, {}, 404),
            ("GET", "/events", None, {"Origin": evil}, 403),
            ("GET", "/events", None, {"Host": "evil.example", "Origin": ""}, 403),
            ("GET", "/../web.py", None, {}, 404),
            ("PUT", "/answer", answer, {}, 501),
        ]
        for method, path, content, headers, status in cases:
            assert page.request(method, path, content, **headers)[0] == status, (method, path, content, headers)
        assert page.asked("position")["id"] == question["id"]
        with ThreadPoolExecutor(8) as tabs:
            statuses = list(tabs.map(lambda _: page.answer(question, "ready"), range(8)))
        assert sorted(statuses) == [204, *[409] * 7]
        page.answer(page.asked("review"), "quit")
    assert isinstance(outcome[0], Stopped)
    assert journal(tmp_path).count('"answer":"') == 1


def test_other_machines_need_the_token(tmp_path: Path) -> None:
    with session("zero-45", **sensor(tmp_path, listen="0.0.0.0:0")) as (page, _):
        host, token = page.host, page.token
        page.host = f"127.0.0.1:{host.rpartition(':')[2]}"
        assert [page.request("GET", path)[0] for path in ("/", "/page.js", "/events", "/report/S-1")] == [
            200,
            200,
            401,
            401,
        ]
        assert page.request("POST", "/answer", {"id": "1"})[0] == 401
        assert page.request("POST", "/token", {"token": "guess"})[0] == 401
        status, headers, _ = page.request("POST", "/token", {"token": token})
        assert status == 204
        assert "HttpOnly; SameSite=Strict" in headers["Set-Cookie"]
        page.cookie = headers["Set-Cookie"].partition(";")[0]
        accept(page, "level")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"listen": "8016"}, "HOST:PORT"),
        ({"listen": "127.0.0.1:99999"}, "HOST:PORT"),
        ({"operator": "sim", "hands_free": True}, "is for the page"),
    ],
)
def test_what_cannot_be_asked_for(options: dict[str, Any], why: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=why):
        measure("zero-45", **sensor(tmp_path, **{"operator": "web", **options}))


def test_ctrl_c_says_how_to_go_on_and_the_next_session_goes_on(warm: WarmStart, tmp_path: Path) -> None:
    begin = ["zero-45", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S-1", "-o", "S-1.yaml"]
    steps = [([*begin, "--operator", "web"], "level", "x-45"), (["--resume", "S-1.journal.jsonl"], "x-45", "y-45")]
    for arguments, position, following in steps:
        command = [*warm.program, "measure", *arguments]
        with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            page = WebClient(next(line.split()[-1] for line in process.stderr if "page of this session" in line))
            states = page.states()
            next(states)
            accept(page, position)
            page.asked("position", following)
            process.send_signal(signal.SIGINT)
            assert [state["ended"] for state in states][-1]
            assert "--resume S-1.journal.jsonl" in process.stderr.read()
            assert process.wait() == 130
