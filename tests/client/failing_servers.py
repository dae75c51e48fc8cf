"""Servers that fail as a test tells them to: one with a list of answers, and a relay that breaks off connections."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

from pmpnbp.client.calls import PROBLEM


@dataclass(frozen=True)
class Answer:
    """What a call is answered; status None: the connection is closed instead, after the request was read."""

    status: int | None
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)


LOST = Answer(None)


def told(value: Any, status: int = 200) -> Answer:
    """An answer in JSON."""
    return Answer(status, json.dumps(value).encode(), {"Content-Type": "application/json"})


def refused(status: int, detail: str = "not now", retry_after: str | None = None) -> Answer:
    """As a server of ours refuses."""
    more = {} if retry_after is None else {"Retry-After": retry_after}
    return Answer(status, json.dumps({"status": status, "detail": detail}).encode(), {"Content-Type": PROBLEM} | more)


@dataclass(frozen=True)
class Request:
    """What a server was asked."""

    method: str
    path: str
    headers: Mapping[str, str]
    body: bytes


class Scripted:
    """A server that gives the answers in order, and notes what it was asked."""

    def __init__(self, answers: Sequence[Answer]) -> None:
        self.requests: list[Request] = []
        left = list(answers)
        requests = self.requests

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def answer(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                requests.append(Request(self.command, self.path, dict(self.headers), body))
                given = left.pop(0)
                if given.status is None:
                    self.close_connection = True
                    return
                self.send_response(given.status)
                for name, value in given.headers.items():
                    self.send_header(name, value)
                self.send_header("Content-Length", str(len(given.body)))
                self.end_headers()
                self.wfile.write(given.body)

            do_GET = do_POST = do_PATCH = do_DELETE = answer

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> Scripted:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class Relay:
    """Passes connections on to a port, and of each of the first ones only so many bytes of answers before it breaks
    both off: 0 with the first byte of an answer, which nobody gets. connections : how many there were"""

    def __init__(self, port: int, limits: Sequence[int]) -> None:
        self.connections = 0
        self._port = port
        self._limits = list(limits)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._threads: list[threading.Thread] = []
        self._open: list[socket.socket] = []
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> Relay:
        self._start(self._accept)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        _break(self._listener)
        for one in list(self._open):
            _break(one)
        for thread in self._threads:
            thread.join()

    def _start(self, work: Any, *arguments: Any) -> None:
        thread = threading.Thread(target=work, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        with self._listener:
            while True:
                try:
                    near, _ = self._listener.accept()
                except OSError:
                    return
                limit = self._limits.pop(0) if self._limits else None
                self.connections += 1
                far = socket.create_connection(("127.0.0.1", self._port))
                self._open += [near, far]
                self._start(self._pass_on, near, far, None)
                self._start(self._pass_on, far, near, limit)

    def _pass_on(self, source: socket.socket, target: socket.socket, limit: int | None) -> None:
        with suppress(OSError), source:
            while data := source.recv(65536):
                target.sendall(data if limit is None else data[:limit])
                if limit is not None:
                    limit -= len(data)
                    if limit <= 0:
                        break
            _break(target)
            _break(source)


def _break(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
