"""Chromium without a window, led through its DevTools protocol over two pipes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
PATIENCE = 30.0
"""Seconds for which a state of the page is waited for."""


class Browser:
    """A running Chromium; ``complaints`` are what its pages wrote to their console, and errors.

    ``requests`` are the addresses that pages with ``Network.enable`` asked for.
    """

    def __init__(self, into: int, out_of: int) -> None:
        self._into, self._out_of, self._rest, self._last = into, out_of, b"", 0
        self.complaints: list[str] = []
        self.requests: list[str] = []

    def call(self, method: str, session: str | None = None, /, **params: Any) -> Any:
        """Carry out one command, and return its result."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params, **({"sessionId": session} if session else {})}
        os.write(self._into, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._rest:
                arrived = os.read(self._out_of, 1 << 16)
                assert arrived, "the browser has ended"
                self._rest += arrived
            line, _, self._rest = self._rest.partition(b"\0")
            said = json.loads(line)
            if said.get("id") == self._last:
                assert "error" not in said, said
                return said["result"]
            if said.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown"):
                self.complaints.append(json.dumps(said["params"])[:500])
            if said.get("method") == "Network.requestWillBeSent":
                self.requests.append(said["params"]["request"]["url"])

    def open(self, url: str) -> Tab:
        """Open a page in a window of its own."""
        target = self.call("Target.createTarget", url=url, newWindow=True)["targetId"]
        return Tab(self, self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"])


class Tab:
    """One tab: what it shows, and what a person does to it."""

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self("Runtime.enable")

    def __call__(self, method: str, **params: Any) -> Any:
        return self._browser.call(method, self._session, **params)

    def value(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript."""
        done = self("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true; an error, as on a page that is not there yet, is not."""
        until = time.monotonic() + PATIENCE
        while not self.value(f"(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()"):
            assert time.monotonic() < until, f"{expression}: {self.value('document.body.innerText')}"

    def key(self, key: str) -> None:
        """Press a key."""
        named = {"key": key, "windowsVirtualKeyCode": 13 if key == "Enter" else ord(key.upper())}
        self("Input.dispatchKeyEvent", type="keyDown", text="\r" if key == "Enter" else key, **named)
        self("Input.dispatchKeyEvent", type="keyUp", **named)

    def tap(self, selector: str) -> None:
        """Touch the middle of an element, scrolled into view."""
        found = f"const one = document.querySelector({json.dumps(selector)}); one.scrollIntoView({{block: 'center'}})"
        middle = "const at = one.getBoundingClientRect(); return [at.x + at.width / 2, at.y + at.height / 2]"
        x, y = self.value(f"(() => {{ {found}; {middle} }})()")
        self("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        self("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def be_a_phone(self, width: int, height: int) -> None:
        """Give the tab the size of a phone, which has two pixels a point and is touched."""
        self("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=2, mobile=True)
        self("Emulation.setTouchEmulationEnabled", enabled=True)


@contextmanager
def browser() -> Iterator[Browser]:
    """Yield a Chromium with an empty profile, killed at the end with all its processes."""
    to_child, into = os.pipe()
    out_of, from_child = os.pipe()

    def three_and_four() -> None:
        first, second = os.dup(to_child), os.dup(from_child)
        os.dup2(first, 3)
        os.dup2(second, 4)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [str(CHROMIUM), *QUIET, f"--user-data-dir={profile}", "--remote-debugging-pipe", "about:blank"]
        process = subprocess.Popen(
            command, preexec_fn=three_and_four, close_fds=False, start_new_session=True, stderr=subprocess.DEVNULL
        )
        os.close(to_child)
        os.close(from_child)
        try:
            yield Browser(into, out_of)
        finally:
            os.killpg(process.pid, 9)
            process.wait()
            os.close(into)
            os.close(out_of)
