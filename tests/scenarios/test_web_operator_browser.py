"""The operator's page in Chromium: led by keys, by touch and with free hands, reloaded, killed, on a phone."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from support.browser import CHROMIUM, Tab, browser
from support.web_client import session

from tiltcal.files.bench import BenchFile, BenchSensor

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: apt install chromium"),
    pytest.mark.skipif(sys.platform == "win32", reason="Chromium is led over inherited pipes"),
]


def bench(folder: Path, **options: Any) -> dict[str, Any]:
    """Return the options of six sensors."""
    sensors = tuple(BenchSensor(f"A-{seed}", "sca3000-d01", f"sim:?seed={seed}") for seed in range(6))
    return {"bench": BenchFile(sensors), "output": folder, "samples": 10, **options}


def ready(tab: Tab, position: str) -> None:
    """Wait until a position is asked for, and a reading is drawn within 0.3 s; some come later on a busy machine."""
    drawn = "document.querySelector('#level .bubble') && document.documentElement.dataset.lag"
    asked = f"document.querySelector('#step').textContent.endsWith('{position}') && {button('ready')}"
    tab.until(f"{asked} && {drawn} && Number(document.documentElement.dataset.lag) < 300")


def button(word: str) -> str:
    """Return the expression that a button is there and takes a key: it does not at once when a question is new."""
    return f"(document.querySelector('[data-answer={word}]') && performance.now() - since > UNTOUCHED)"


def test_keys_touch_a_reload_and_a_killed_browser(tmp_path: Path) -> None:
    with session("cross-axis", **bench(tmp_path)) as (page, _):
        with browser() as first:
            tab, other = (first.open(page.url) for _ in range(2))
            ready(tab, "x-tilt1")
            tab("Emulation.setDeviceMetricsOverride", width=1280, height=800, deviceScaleFactor=1, mobile=False)
            seen = (
                "[...document.querySelectorAll('#each span')].filter((one) => one.getBoundingClientRect().bottom < 800)"
            )
            assert tab.value(f"{seen}.length") == 6
            tab.key("x")  # no key of the page
            tab.key("Enter")
            tab.until(button("accept"))
            other.until(button("accept"))  # both show the same
            assert tab.value("document.documentElement.dataset.sound") == "sampled"
            tab("Page.reload")
            tab.until(button("accept"))
            tab.key("Enter")
            ready(tab, "x-tilt2")
            tab.be_a_phone(400, 800)
            tab.tap("[data-answer=ready]")
            tab.until(button("accept"))
            assert tab.value("document.documentElement.scrollWidth") == 400
            beside = "document.querySelector('#readings td:first-child b').getBoundingClientRect().right < 400"
            assert tab.value(beside)  # ok, at its name
            tab.tap("[data-answer=accept]")
            ready(tab, "y-tilt1")
            tab.tap("[data-answer=typed]")
            typed = "document.querySelector('#fields [name=y]')"
            tab.value(f"{typed}.value = '30,5 rad'")
            tab.tap("#type .main")
            tab.until("document.querySelector('#unread').textContent.includes(\"'rad' behind the number\")")
            assert tab.value(f"{typed}.ariaInvalid") == "true"
            tab.tap("#type button:not(.main)")
            other.until(button("ready"))
            other.key("q")  # once is not enough
            assert "again" in other.value("document.querySelector('#said').textContent")
            assert first.complaints == []
            assert page.answer(page.asked("position", "y-tilt1"), "ready") == 204
        with browser() as second:
            tab = second.open(page.url)
            tab.until(button("accept"))  # of the position that the first one did not see measured
            tab.key("b")
            ready(tab, "x-tilt2")
            for _ in range(2):  # a click on a position that is done, repeated, withdraws it
                tab.tap("#positions li:nth-child(1)")
            ready(tab, "x-tilt1")
    assert [one.get("position") for one in accepted(tmp_path)] == ["x-tilt1", "x-tilt2"]


def test_free_hands_take_what_follows_and_a_person_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.bench.web.STILL_FOR", 0.3)
    monkeypatch.setattr("tiltcal.bench.web.LIVE_PAUSE", 0.05)
    with session("cross-axis", **bench(tmp_path, hands_free=True)) as (page, _), browser() as chromium:
        tab = chromium.open(page.url)
        ready(tab, "x-tilt1")
        tab.key("Enter")
        tab.until(button("accept"))
        tab.key("Enter")
        tab.until(button("yes"))
        assert not list(tmp_path.glob("A-*.yaml"))
        assert [one["position"] for one in accepted(tmp_path)][1:] == [
            "x-tilt2",
            "y-tilt1",
            "y-tilt2",
            "z-tilt1",
            "z-tilt2",
        ]
        tab.key("Enter")
        tab.until("document.querySelectorAll('.tilt b').length >= 6")
        assert len(list(tmp_path.glob("A-*.yaml"))) == 6
        tab.until(button("finish"))
        tab.key("f")
        tab.until("document.querySelector('#link').textContent === 'the session has ended'")
        assert tab.value("document.querySelector('#prompt').textContent") == "Finished. You may close this page."
        assert tab.value("document.querySelectorAll('main a, main button').length") == 0
        assert chromium.complaints == []


def accepted(folder: Path) -> list[dict[str, Any]]:
    """Return the positions that the journal has."""
    lines = next(folder.glob("*.journal.jsonl")).read_text(encoding="utf-8").splitlines()
    events = [json.loads(line) for line in lines[1:]]
    return [event[2] for event in events if event[1] == "p"]
