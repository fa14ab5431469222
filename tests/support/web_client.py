"""A browser's side of the operator's page without a browser: the state that it gets, and the answers that it sends."""

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlsplit

import tiltcal

State = dict[str, Any]


class WebClient:
    """Talks to the page at an address; ``token`` is that of the address, ``cookie`` what it was given for it."""

    def __init__(self, url: str) -> None:
        self.url, self.host, self.token, self.cookie = url, urlsplit(url).netloc, urlsplit(url).fragment, ""
        self.host = self.host.replace("0.0.0.0", "127.0.0.1")
        self.cookie = self.request("POST", "/token", {"token": self.token})[1]["Set-Cookie"].partition(";")[0]

    def request(
        self, method: str, path: str, content: object = None, **headers: str
    ) -> tuple[int, Mapping[str, str], bytes]:
        """Return status, headers and body of a request; headers that are empty are left out."""
        usual = {"Host": self.host, "Origin": f"http://{self.host}", "Cookie": self.cookie, **headers}
        body = content if isinstance(content, str) else json.dumps(content)
        with closing(HTTPConnection(self.host, timeout=20)) as connection:
            sent = {name: value for name, value in usual.items() if value}
            connection.putrequest(method, path, skip_host=True)
            for name, value in {**sent, "Content-Length": str(len(body))}.items():
                connection.putheader(name, value)
            connection.endheaders(body.encode())
            answer = connection.getresponse()
            return answer.status, answer.headers, b"" if path == "/events" else answer.read()

    def states(self) -> Iterator[State]:
        """Yield the states of one stream; closing the generator ends the connection."""
        with closing(HTTPConnection(self.host, timeout=20)) as connection:
            connection.request("GET", "/events", headers={"Cookie": self.cookie} if self.cookie else {})
            answer = connection.getresponse()
            while line := answer.readline():
                if line.startswith(b"data: "):
                    yield json.loads(line[6:])

    def until(self, shows: Callable[[State], object]) -> State:
        """Wait for a state that shows something, and return it."""
        with closing(self.states()) as states:  # type: ignore[type-var]
            return next(state for state in states if shows(state))

    def asked(self, kind: str, position: str = "") -> State:
        """Wait for a question, and return it."""
        state = self.until(lambda one: one["question"] and one["question"]["ask"] == kind and position in one["step"])
        return dict(state["question"])

    def answer(self, question: State, word: str, **more: object) -> int:
        """Answer a question, and return the status."""
        return self.request("POST", "/answer", {"id": question["id"], "answer": word, **more})[0]


@contextmanager
def session(procedure: str, **options: Any) -> Iterator[tuple[WebClient, list[object]]]:
    """Yield a client of a session in a thread, and what it gives or raises; one that asks is stopped at the end."""
    outcome: list[object] = []
    urls: list[str] = []
    begun = threading.Event()

    def remark(text: str) -> None:
        if "page of this session" in text:
            urls.append(text.split()[-1])
            begun.set()

    def run() -> None:
        try:
            outcome.append(tiltcal.measure(procedure, operator="web", remark=remark, **options))
        except tiltcal.TiltcalError as error:
            outcome.append(error)
        begun.set()

    thread = threading.Thread(target=run)
    thread.start()
    begun.wait()
    client = WebClient(urls[0])
    try:
        yield client, outcome
    finally:
        with suppress(OSError):  # it has ended
            state = client.until(lambda one: one["question"] or one["ended"])
            if state["question"]:
                client.answer(state["question"], "finish" if state["question"]["ask"] == "afterwards" else "quit")
        thread.join(30)
