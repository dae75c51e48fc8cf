"""HTTP as a socket sends it, for clients that do not keep to it."""

from __future__ import annotations

import json
import socket
from typing import Any


def connect(served: Any) -> socket.socket:
    """A connection to a server that has said nothing yet; whoever waits for its answer gives up after a minute."""
    return socket.create_connection(("127.0.0.1", served.config.port), timeout=60)


def head(method: str, path: str, *lines: str) -> bytes:
    """A request's header."""
    return "\r\n".join([f"{method} {path} HTTP/1.1", "Host: 127.0.0.1", *lines, "", ""]).encode("latin-1")


def everything(connection: socket.socket) -> bytes:
    """What comes until the server closes; what a reset connection leaves unread is lost."""
    parts = []
    try:
        while part := connection.recv(1 << 16):
            parts.append(part)
    except ConnectionResetError:
        pass
    return b"".join(parts)


def answer(connection: socket.socket) -> tuple[int, bytes]:
    """Status and body of the next answer, which has to say its length."""
    with connection.makefile("rb") as file:
        status = int(file.readline().split()[1])
        length = 0
        while (line := file.readline().strip()) and b":" in line:
            name, value = line.split(b":", 1)
            if name.lower() == b"content-length":
                length = int(value)
        return status, file.read(length)


def problem(connection: socket.socket) -> tuple[int, str]:
    """Status and sentence of the next answer, which is a problem."""
    status, body = answer(connection)
    return status, str(json.loads(body)["detail"])
