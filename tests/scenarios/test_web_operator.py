"""A person at a page in a browser: what the page gets and sends, and what nobody else can send."""

import json
import os
import select
import signal
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from support.command import tiltcal
from support.warm_start import WarmStart
from support.web_client import WebClient, session

from tiltcal import measure
from tiltcal.bench.guidance import CALIBRATED
from tiltcal.bench.page_server import NO_TOKEN, STRANGE, PageServer, PageState, host_and_port
from tiltcal.bench.page_token import PageToken
from tiltcal.errors import Stopped, UsageError
from tiltcal.files.calibration import read_calibration


def sensor(folder: Path, **options: Any) -> dict[str, Any]:
    one = {"sensor": "sca100t-d02", "address": "sim:?seed=1", "serial": "S-1", "output": folder / "S-1.yaml"}
    return {**one, "samples": 20, **options}


def accept(page: WebClient, *positions: str) -> None:
    for position in positions:
        assert page.answer(page.asked("position", position), "ready") == 204
        assert page.answer(page.asked("review", position), "accept") == 204


def journal(folder: Path) -> str:
    return (folder / "S-1.journal.jsonl").read_text(encoding="utf-8").replace(": ", ":")


def test_the_whole_way_with_results_report_and_verification(tmp_path: Path) -> None:
    with session("zero-45", **sensor(tmp_path)) as (page, outcome):
        accept(page, "level", "x-45", "y-45")
        assert not (tmp_path / "S-1.yaml").exists()
        assert page.answer(page.asked("write"), "yes") == 204
        live = page.until(lambda one: one["live"])["live"]["S-1"]
        assert [name for name, _, _ in live][:2] == ["tilt x", "tilt y"]
        (tmp_path / "S-1.html").mkdir()  # a report that cannot be written is told, and asked for again
        assert page.answer(page.asked("afterwards"), "report") == 204
        assert "not finished: " in page.until(lambda one: one["refused"])["refused"]
        (tmp_path / "S-1.html").rmdir()
        assert page.answer(page.asked("afterwards"), "report") == 204
        page.until(lambda one: one["results"] and one["results"][0].get("report"))
        assert page.request("GET", "/report/S-1")[2] == (tmp_path / "S-1.html").read_bytes()
        assert page.answer(page.asked("afterwards"), "verify") == 204
        page.asked("position", "level")
        seen = page.until(lambda one: one["guide"])["guide"]
        assert abs(seen["worst"]["angle"]) < 0.3
        assert (seen["ok"], seen["fits"], seen["note"]) == (None, True, CALIBRATED)
        accept(page, "level", "x-up", "x-down", "y-up", "y-down", "both-up")
        assert "limit 0.5°" in page.until(lambda one: one["results"][0].get("verdict"))["results"][0]["verdict"]
        assert page.answer(page.asked("afterwards"), "finish") == 204
    assert [type(one).__name__ for one in outcome] == ["Calibration"]
    tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", cwd=tmp_path, code=0)


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
    with session("zero-45", **sensor(tmp_path, listen="0.0.0.0:0")) as (page, outcome):
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
            ("POST", "/answer", answer, {"Cookie": "", "Origin": "", "Authorization": f"Bearer {page.token}0"}, 403),
            ("POST", "/answer", "ready", {}, 400),
            ("POST", "/answer", "[" * 4000, {}, 400),
            ("POST", "/answer", {"id": question["id"]}, {}, 400),
            ("POST", "/token", answer, {}, 401),
            ("POST", "/answer", answer, {"Cookie": ""}, 401),
            ("POST", "/answer", answer, {"Cookie": "", "Authorization": "Bearer guess"}, 401),
            ("GET", "/events", None, {"Cookie": ""}, 401),
            *(("GET", "/events", None, {"Host": host.format(page.host), "Origin": ""}, 403) for host in ODD_HOSTS),
            ("GET", "/events", None, {"Origin": evil}, 403),
            ("GET", "/events", None, {"Host": "evil.example", "Origin": ""}, 403),
            ("GET", "/../web.py", None, {}, 404),
            ("PUT", "/answer", answer, {}, 501),
            ("POST", "/answer", {"id": question["id"]}, BEARER, 400),
            ("POST", "/elsewhere", answer, {}, 404),
        ]
        for method, path, content, headers, status in cases:
            headers = {name: value.format(page.token) for name, value in headers.items()}
            said = page.request(method, path, content, **headers)
            assert said[0] == status, (method, path, content, headers)
            assert path == "/events" or said[2].decode() in TEXTS.get(status, said[2].decode()), said[2]
        assert page.asked("position")["id"] == question["id"]
        with ThreadPoolExecutor(8) as tabs:
            statuses = list(tabs.map(lambda _: page.answer(question, "ready"), range(8)))
        assert sorted(statuses) == [204, *[409] * 7]
        last = {"id": page.asked("review")["id"], "answer": "quit"}
        with pytest.raises(UsageError, match="Address already in use"):
            PageServer(PageState(), "", f"0.0.0.0:{page.host.partition(':')[2]}")
        given = page.request("POST", "/token", {"token": page.token})[1]["Set-Cookie"]
        assert "HttpOnly; SameSite=Strict" in given
        assert page.request("POST", "/answer", last, **{**BEARER, "Authorization": f"Bearer {page.token}"})[0] == 204
    assert isinstance(outcome[0], Stopped)
    assert journal(tmp_path).count('"answer":"') == 1


TEXTS = {401: NO_TOKEN + "this is not the token", 403: STRANGE, 409: "this question is not asked any more"}
BEARER = {"Cookie": "", "Origin": "", "Authorization": "Bearer {}"}
ODD_HOSTS = ("user@{}", "{}/", "{}?", "{}#", "[{}]", "127.0.0.1:", "127.0.0.1:80:80", " ", "127.0.0.1,evil.example")


def test_a_connection_that_drips_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.bench.page_server.LOST", 0.3)
    with session("zero-45", **sensor(tmp_path)) as (page, _):
        host, _, port = page.host.partition(":")
        with socket.create_connection((host, int(port)), timeout=10) as connection, suppress(OSError):
            while True:  # a header without an end, each piece well before the time-out of one
                connection.sendall(b"X")
                if select.select([connection], [], [], 0.05)[0]:
                    assert connection.recv(100) == b""
                    break
        assert page.asked("position", "level")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"listen": "8016"}, "HOST:PORT"),
        ({"listen": "127.0.0.1:65536"}, "HOST:PORT"),
        ({"listen": "user@127.0.0.1:8016"}, "HOST:PORT"),
        ({"listen": "127.0.0.1:8016/"}, "HOST:PORT"),
        ({"operator": "sim", "hands_free": True}, "is for the page"),
    ],
)
def test_what_cannot_be_asked_for(options: dict[str, Any], why: str, tmp_path: Path) -> None:
    assert host_and_port("[::1]:65535") == ("::1", 65535)
    with pytest.raises(UsageError, match=why):
        measure("zero-45", **sensor(tmp_path, **{"operator": "web", **options}))


def test_ctrl_c_says_how_to_go_on_and_the_next_session_goes_on(warm: WarmStart, tmp_path: Path) -> None:
    """The page of the next session takes the token of the tab that is open."""
    state = tmp_path / "state"
    state.mkdir()
    begin = ["zero-45", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S-1", "-o", "S-1.yaml"]
    steps = [([*begin, "--operator", "web"], "level", "x-45"), (["--resume", "S-1.journal.jsonl"], "x-45", "y-45")]
    tokens = set()
    for arguments, position, following in steps:
        command = [*warm.program, "measure", *arguments]
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(state)}
        with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=environment) as process:
            assert process.stderr is not None
            page = WebClient(next(line.split()[-1] for line in process.stderr if "page of this session" in line))
            tokens.add(page.token)
            states = page.states()
            next(states)
            accept(page, position)
            page.asked("position", following)
            process.send_signal(signal.SIGINT)
            assert [state["ended"] for state in states][-1]
            assert "--resume S-1.journal.jsonl" in process.stderr.read()
            assert process.wait() == 130
    (kept,) = (state / "tiltcal").iterdir()
    assert tokens == {kept.read_text()}
    assert kept.stat().st_mode & 0o777 == 0o600
    assert kept.read_text() not in journal(tmp_path)


def test_the_token_is_forgotten_at_the_end_and_that_of_another_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    token = PageToken(tmp_path / "a.journal.jsonl")
    (kept,) = (tmp_path / "tiltcal").iterdir()
    assert PageToken(tmp_path / "a.journal.jsonl").value == token.value
    assert PageToken(tmp_path / "b.journal.jsonl").value != token.value
    kept.chmod(0o644)
    assert PageToken(tmp_path / "a.journal.jsonl").value != token.value
    token.forget()
    assert not kept.exists()
