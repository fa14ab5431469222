"""The server of the operator's page: it sends the state to every tab, and takes one answer to each question.

The state is here alone. A tab gets the whole of it as a server-sent event whenever it changes, so a reload, a second
tab or a connection that was lost shows what all others show. An answer names the number of its question; a number that
is not asked at the moment, as of an old tab or of an earlier session, changes nothing.

What a page of another site could send is refused: its name in ``Host`` (a name that an attacker lets lead to this
machine) and its ``Origin``. Everybody has to know a token, because every user of this machine reaches its ports: a
browser gets a cookie for it, a program sends ``Authorization: Bearer``.
"""

from __future__ import annotations

import json
import re
import secrets
import socket
from collections.abc import Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from ipaddress import ip_address
from socketserver import ThreadingTCPServer
from threading import Condition, Thread
from time import monotonic, sleep
from typing import Any
from urllib.parse import unquote, urlsplit

import msgspec

from tiltcal.bench.typed import with_numbers
from tiltcal.errors import Argument, InputError, UsageError

PORT = 8016  # the usual port, so that a page that is open goes on after ``--resume``; another one where it is taken

PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/attitude.js": ("attitude.js", "text/javascript; charset=utf-8"),
}

HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
}
REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"

STRANGE = "not from the page, or not to its address: open the page by IP address, or start with --listen NAME:PORT"
NO_TOKEN = "open the new address that the terminal shows"
LONGEST_ANSWER = 4096  # bytes of an answer
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::([0-9]{1,5}))?")  # a name or an address, and a port
SILENCE = 2.0  # seconds after which a stream shows that it lives, though nothing has changed
PACE = 0.04  # seconds between two states on one stream: a virtual session has a thousand readings in that time
LOST = 5.0  # seconds after which a connection is given up that takes nothing, or has not said all of its request
WRONG_TOKEN = 0.5  # seconds that the answer to a wrong token takes


class PageState:
    """What every tab shows, and the question that one of them may answer once."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._session = secrets.token_hex(4)
        self._fields: dict[str, Any] = {"session": self._session, "question": None}
        self._version = self._questions = 0
        self._answer: dict[str, object] | None = None
        self.closed = False

    def show(self, **fields: object) -> None:
        """Change some fields of the state."""
        with self._changed:
            self._fields.update(fields)
            self._note()

    def ask(self, question: Mapping[str, object]) -> None:
        """Show a question, with a number that no question has had."""
        self._questions += 1
        self._answer = None
        self.show(question={**question, "id": f"{self._session}-{self._questions}"})

    def withdraw(self) -> dict[str, object] | None:
        """Ask no more; return an answer that has come."""
        with self._changed:
            self._fields["question"] = None
            self._note()
            return self.wait(0.0)

    def wait(self, seconds: float) -> dict[str, object] | None:
        """Return the answer to the question, which is then asked no more; None where there is none in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._answer is not None, seconds)
            answer, self._answer = self._answer, None
            return answer

    def take(self, said: Mapping[str, object]) -> bool:
        """Take an answer from a tab; return whether its question is asked at the moment."""
        with self._changed:
            question = self._fields["question"]
            if question is None or said.get("id") != question["id"]:
                return False
            self._answer = {key: value for key, value in said.items() if key != "id"}
            self._fields["question"] = None
            self._note()
            return True

    def after(self, seen: int) -> tuple[int, bytes]:
        """Return the number of the state and the state as JSON, none where it is still that of ``seen`` after a while.

        The number is -1 after the end.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._version != seen or self.closed, SILENCE)
            if self._version != seen:
                return self._version, msgspec.json.encode(self._fields)  # a number that is none is null
            return (-1 if self.closed else seen), b""

    def close(self) -> None:
        """End all streams after the last state."""
        with self._changed:
            self._fields.update(question=None, ended=True)
            self.closed = True
            self._note()

    def _note(self) -> None:
        self._version += 1
        self._changed.notify_all()


class PageServer(ThreadingTCPServer):
    """Serves the page, the state and the reports until :meth:`close`; ``url`` is where.

    ``listen`` is HOST:PORT for other machines too; None is this machine alone. All have to know the ``token``.

    UsageError: it cannot listen there.
    """

    allow_reuse_address = True
    daemon_threads = False  # all end in close

    def __init__(self, state: PageState, token: str, listen: str | None = None) -> None:
        self.state, self.token = state, token
        self.reports: dict[str, bytes] = {}
        self._connections: set[socket.socket] = set()
        self.unheard: dict[socket.socket, float] = {}
        """Until when each connection has to have said its request, by the monotonic clock, s."""
        self.named, port = ("127.0.0.1", PORT) if listen is None else host_and_port(listen)
        self.address_family = socket.AF_INET6 if ":" in self.named else socket.AF_INET
        try:
            super().__init__((self.named, port), PageRequest)
        except OSError as error:
            if listen is not None:
                raise UsageError((Argument("listen", listen), f": {error.strerror or error}")) from None
            super().__init__((self.named, 0), PageRequest)
        self._thread = Thread(target=self.serve_forever, args=(0.1,), name="page")
        self._thread.start()

    @property
    def url(self) -> str:
        """Where the page is; with the token behind #, which a browser sends to nobody."""
        host = _outward_address(self.named) if self.named in ("0.0.0.0", "::") else self.named
        place = f"[{host}]" if ":" in host else host
        return f"http://{place}:{self.server_address[1]}/#{self.token}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection, which :meth:`close` can end."""
        self._connections.add(request)
        self.unheard[request] = monotonic() + LOST
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """End a connection."""
        self._connections.discard(request)
        self.unheard.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """End the connections whose request drips in."""
        for connection, until in list(self.unheard.items()):
            if monotonic() > until:
                self.unheard.pop(connection, None)
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that has gone."""

    def close(self) -> None:
        """End every connection and every thread; a stream sends the last state before."""
        self.state.close()
        self.shutdown()
        self._thread.join()
        for connection in list(self._connections):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RD)  # what waits for a request waits no more
        self.server_close()


class PageRequest(BaseHTTPRequestHandler):
    """One request of a browser."""

    server: PageServer
    timeout = LOST
    server_version, sys_version = "tiltcal", ""

    def do_GET(self) -> None:
        """Send the page, the stream of states, or a report."""
        self.server.unheard.pop(self.connection, None)
        path = unquote(urlsplit(self.path).path)
        if not self._trusted():
            self._send(403, STRANGE)
        elif path in PAGE:
            name, kind = PAGE[path]
            self._send(200, (files("tiltcal.bench") / "page" / name).read_bytes(), kind)
        elif not self._authorised():
            self._send(401, NO_TOKEN)
        elif path == "/events":
            self._stream()
        elif path in self.server.reports:
            self._send(200, self.server.reports[path], "text/html; charset=utf-8", policy=REPORT_POLICY)
        else:
            self._send(404, "there is no such page")

    def do_POST(self) -> None:
        """Take an answer, or the token."""
        path = urlsplit(self.path).path
        if not self._trusted() or (self.headers.get("Origin") is None and not self._has_bearer()):
            self._send(403, STRANGE)
            return
        try:
            length = int(self.headers["Content-Length"])
            said = json.loads(self.rfile.read(max(0, min(length, LONGEST_ANSWER))))
        except (ValueError, TypeError, RecursionError):
            said = None
        self.server.unheard.pop(self.connection, None)
        if not isinstance(said, dict):
            self._send(400, "an answer is a JSON object")
        elif path == "/token":
            self._let_in(said.get("token"))
        elif not self._authorised():
            self._send(401, NO_TOKEN)
        elif path != "/answer":
            self._send(404, "there is no such page")
        elif not isinstance(said.get("answer"), str):
            self._send(400, 'an answer has a word: {"id": ..., "answer": ...}')
        else:
            self._take(said)

    def _take(self, said: dict[str, object]) -> None:
        """Take an answer; what was typed in it and cannot be read is refused here, where it can be typed again."""
        try:
            taken = self.server.state.take(with_numbers(said))
        except InputError as error:
            self._send(422, str(error))
        else:
            self._send(204 if taken else 409, "" if taken else "this question is not asked any more")

    def log_message(self, *args: object) -> None:
        """Print nothing: the terminal shows the session."""

    def _trusted(self) -> bool:
        """Return whether the request is to this machine by address, and from our own page where it says so."""
        hosts, origin = self.headers.get_all("Host", []), self.headers.get("Origin")
        found = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        name = "" if found is None else found[1].strip("[]").lower()
        by_address = name in ("localhost", self.server.named.lower()) or _is_address(name)
        return by_address and origin in (None, f"http://{hosts[0]}")

    def _authorised(self) -> bool:
        """Return whether the browser or the program has shown the token."""
        shown = [pair.strip() for pair in self.headers.get("Cookie", "").split(";")]
        return self._has_bearer() or any(_same(pair, self._cookie) for pair in shown)

    def _has_bearer(self) -> bool:
        """Return whether a program has shown the token, which no page of another site can."""
        return _same(self.headers.get("Authorization", ""), f"Bearer {self.server.token}")

    @property
    def _cookie(self) -> str:
        port = self.server.server_address[1]  # all ports of a machine share its cookies
        return f"tiltcal-{port}={self.server.token}"

    def _let_in(self, token: object) -> None:
        """Give a browser that shows the token a cookie."""
        if _same(str(token), self.server.token):
            self._send(204, cookie=f"{self._cookie}; HttpOnly; SameSite=Strict; Path=/")
        else:
            sleep(WRONG_TOKEN)
            self._send(401, "this is not the token")

    def _stream(self) -> None:
        """Send each state until the end of the session or of the connection."""
        self._begin(200, "text/event-stream", HEADERS["Content-Security-Policy"])
        self.end_headers()
        seen = 0
        while seen >= 0:
            seen, state = self.server.state.after(seen)
            self.wfile.write(b"data: " + state + b"\n\n" if state else b"event: alive\ndata:\n\n")
            sleep(PACE)

    def _send(
        self, status: int, body: str | bytes = b"", kind: str = "text/plain; charset=utf-8", *,
        policy: str = HEADERS["Content-Security-Policy"], cookie: str = "",
    ) -> None:  # fmt: skip
        content = body.encode() if isinstance(body, str) else body
        self._begin(status, kind, policy)
        self.send_header("Content-Length", str(len(content)))
        if cookie:
            self.send_header("Set-Cookie", cookie)
        self.end_headers()
        self.wfile.write(content)

    def _begin(self, status: int, kind: str, policy: str) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Security-Policy": policy, "Content-Type": kind}.items():
            self.send_header(name, value)


def host_and_port(listen: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT, such as ``0.0.0.0:8016`` or ``[::]:8016``; a UsageError where it is not."""
    found = _HOST.fullmatch(listen)
    if found and found[2] and int(found[2]) < 1 << 16:
        return found[1].strip("[]").lower(), int(found[2])
    raise UsageError((Argument("listen", listen), f": it is HOST:PORT, such as 0.0.0.0:{PORT}"))


def _same(said: str, secret: str) -> bool:
    """Return whether two texts are one, in a time that tells nothing of them."""
    return secrets.compare_digest(said.encode(errors="replace"), secret.encode())


def _is_address(name: str) -> bool:
    """Return whether a host is named by its address, which no name server can turn to another machine."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _outward_address(everywhere: str) -> str:
    """Return the address by which other machines reach this one; its name where there is no network."""
    family, outside = (socket.AF_INET6, "2001:db8::1") if ":" in everywhere else (socket.AF_INET, "192.0.2.1")
    with socket.socket(family, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect((outside, 9))  # sends nothing
        return str(probe.getsockname()[0])
    return socket.gethostname()
