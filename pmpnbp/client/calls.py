"""How does a call reach a server, and come to an answer? With the token, and once more where none came.

A call that never arrived, or that the server refused for now (429, 503), has changed nothing. Where the connection
broke before the answer came, the call may have been done. It is made again all the same: no call does more the second
time, as reads and deletions do not, and all others carry an Idempotency-Key.
"""

from __future__ import annotations

import json
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import IO, Any, TypeVar
from urllib.parse import parse_qs, quote, urlsplit

import httpx
import numpy as np

from pmpnbp.errors import ServerError

Used = TypeVar("Used")

PROBLEM = "application/problem+json"
# Seconds before a call is made again where the server names none; doubled each time, up to the longest.
FIRST_WAIT, LONGEST_WAIT = 0.5, 8.0
# Who is told to wait for longer is rather told why: somebody has to do something first, as delete a session.
LONGEST_RETRY_AFTER = 30.0
# Seconds until an address that says nothing is taken for nobody's.
CONNECT_SECONDS = 10.0
# Seconds that a server may compute before it answers, where a call makes it compute.
COMPUTING_SECONDS = 600.0
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
# What a proxy answers while the server behind it is away, or computes for longer than the proxy waits.
_AWAY = (502, 503, 504)
# Nothing of the call was sent where one of these was raised.
_NEVER_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout, httpx.ProxyError)


@dataclass(frozen=True, kw_only=True)
class Call:
    """What is asked of a server.

    path : below /api/v1/, as `path_of` makes it
    files, data : of a form, files by name and content, or where that lies; json : of a body
    read_seconds : without a byte from the server, until it is taken for gone; at least the client's
    """

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    files: Mapping[str, tuple[str, bytes | Path]] | None = None
    data: Mapping[str, str] | None = None
    read_seconds: float = 0.0

    def keyed(self) -> Call:
        """The same, safe to be made again: the server knows it by its key."""
        return replace(self, headers={**self.headers, "Idempotency-Key": str(uuid.uuid4())})

    @property
    def has_key(self) -> bool:
        """Whether the server knows it by its key."""
        return "Idempotency-Key" in self.headers


class Failure(Exception):
    """An attempt that came to nothing.

    error : what to raise where no further one is made
    again : whether a further one may come to something; wait : after so many seconds, where the server says
    broke : whether the call was sent, and nobody knows what became of it
    at_work : whether an attempt before is still at work
    silent : whether it took all the time that the server has to say something
    """

    def __init__(
        self,
        error: ServerError,
        *,
        again: bool = False,
        wait: float | None = None,
        broke: bool = False,
        at_work: bool = False,
        silent: bool = False,
    ) -> None:
        super().__init__(str(error))
        self.error = error
        self.again = again
        self.wait = wait
        self.broke = broke
        self.at_work = at_work
        self.silent = silent


class Calls:
    """Calls to one server. Thread-safe. address : without the token, as errors name it"""

    def __init__(self, url: str, token: str | None, timeout: float, retries: int) -> None:
        self.address, in_link = _address(url)
        self._token = in_link if token is None else token
        self._timeout = timeout
        self.retries = retries
        self._answered = False
        host = urlsplit(self.address).hostname
        # a proxy that the environment names cannot reach this machine's own loopback
        direct = {f"all://[{host}]" if ":" in str(host) else f"all://{host}": None} if host in _LOOPBACK else None
        self._client = httpx.Client(headers=_authorization(self._token), mounts=direct)

    def __repr__(self) -> str:
        return f"<Calls to {self.address}>"

    def close(self) -> None:
        """Close all connections."""
        self._client.close()

    def link(self, path: str) -> str:
        """The link by which a browser opens a page, with the token where there is one: not to be shown."""
        return f"{self.address}{path}" + ("" if self._token is None else f"?token={quote(self._token, safe='')}")

    def get(self, *path: str, read_seconds: float = 0.0, **params: Any) -> httpx.Response:
        """The answer to a GET. params : of the query, those that are not None. Raises ServerError."""
        given = {name: value for name, value in params.items() if value is not None}
        return self.answer(Call(method="GET", path=path_of(*path), params=given, read_seconds=read_seconds))

    def answer(self, call: Call) -> httpx.Response:
        """The server's answer, all of it. Raises ServerError."""
        return self.used(call, _read)

    def used(self, call: Call, use: Callable[[httpx.Response], Used]) -> Used:
        """What `use` makes of the answer, which is still to be read; called anew where the connection breaks meanwhile.
        Raises ServerError."""
        broke, attempt = False, 0
        while True:
            try:
                with self.once(call) as response:
                    return use(response)
            except Failure as failure:
                if broke and call.method == "DELETE" and failure.error.status == 404:
                    return use(httpx.Response(204))  # the attempt whose answer was lost has deleted it
                # what is at work is waited for, however long it takes
                if not failure.again or (attempt >= self._patience(failure) and not failure.at_work):
                    raise failure.error from None
                broke = broke or failure.broke
                wait(attempt, failure)
                attempt += not failure.at_work

    @contextmanager
    def once(self, call: Call) -> Iterator[httpx.Response]:
        """The answer to one attempt, still to be read. Raises Failure, also where the connection breaks meanwhile."""
        headers, content = dict(call.headers), None
        if call.json is not None:
            headers["Content-Type"], content = "application/json", json_text(call.json).encode()
        read_seconds = max(call.read_seconds, self._timeout)
        seconds = httpx.Timeout(self._timeout, connect=min(self._timeout, CONNECT_SECONDS), read=read_seconds)
        try:
            with (
                _opened(call.files) as files,
                self._client.stream(
                    call.method,
                    f"{self.address}/api/v1/{call.path}",
                    params=call.params or None,
                    headers=headers,
                    content=content,
                    files=files,
                    data=call.data,
                    timeout=seconds,
                ) as response,
            ):
                self._answered = True
                if not response.is_success:
                    response.read()
                    raise self._refusal(response)
                yield response
        except httpx.RequestError as error:
            raise self._no_answer(error, call, read_seconds) from None

    def _patience(self, failure: Failure) -> int:
        """How often a call is made again that failed so. An address that nobody has answered at yet is rather a wrong
        one than that of a server which starts anew; a new connection may reach one that has become silent."""
        if failure.silent:
            return min(self.retries, 1)
        nobody = not self._answered and not failure.broke and failure.error.status is None
        return self.retries // 2 if nobody else self.retries

    def _refusal(self, response: httpx.Response) -> Failure:
        status, seconds, detail = response.status_code, _retry_after(response), _detail(response)
        if detail is None:
            points = f", pointing to {response.headers['location']}" if "location" in response.headers else ""
            detail = f"{self.address} answers {status} {response.reason_phrase}{points}, as no pmpnbp server does"
            again = status in (429, *_AWAY)
        else:
            # Without a time a 503 is for good, as there is nothing to draw with, and a 409 tells of a session's state;
            # with one it tells that the same call is still at work.
            again = status == 429 or (status in (409, 503) and seconds is not None)
        again = again and (seconds or 0.0) <= LONGEST_RETRY_AFTER
        return Failure(ServerError(detail, status), again=again, wait=seconds, at_work=again and status == 409)

    def _no_answer(self, error: httpx.RequestError, call: Call, read_seconds: float) -> Failure:
        why = str(error) or type(error).__name__
        if isinstance(error, _NEVER_SENT):
            return Failure(ServerError(f"no server answers at {self.address} ({why})"), again=True)
        silent = isinstance(error, httpx.TimeoutException)
        what = (
            f"says nothing for {read_seconds:g} s"
            if isinstance(error, httpx.ReadTimeout)
            else f"broke off the call ({why})"
        )
        unknown = "; whether it was done is not known" if call.has_key else ""
        told = ServerError(f"the server at {self.address} {what}{unknown}")
        return Failure(told, again=True, broke=True, silent=silent)


def path_of(*steps: str) -> str:
    """The steps as a path, each with its slashes encoded."""
    return "/".join(quote(step, safe="") for step in steps)


def json_text(value: Any) -> str:
    """`value` as JSON; arrays and numbers of NumPy's may be in it."""
    return json.dumps(value, default=_plain)


def wait(attempt: int, failure: Failure) -> None:
    """Let so much time go by as is due before the next attempt. attempt : how many failed before this one"""
    if failure.wait is not None:
        time.sleep(failure.wait)
    else:
        time.sleep(min(FIRST_WAIT * 2.0**attempt, LONGEST_WAIT))


@contextmanager
def understood(what: str) -> Iterator[None]:
    """Around what reads an answer: raises ServerError where it does not tell `what` it should."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, OSError, EOFError, zipfile.BadZipFile) as error:
        came = f"{type(error).__name__}: {error}"
        raise ServerError(
            f"the server's answer is not {what} as this version of pmpnbp knows it ({came:.200})"
        ) from None


@contextmanager
def _opened(
    files: Mapping[str, tuple[str, bytes | Path]] | None,
) -> Iterator[dict[str, tuple[str, bytes | IO[bytes]]] | None]:
    """The same, with what lies on the disk open, to be sent as it is read. Raises OSError."""
    if files is None:
        yield None
        return
    with ExitStack() as stack:
        yield {
            part: (name, content if isinstance(content, bytes) else stack.enter_context(content.open("rb")))
            for part, (name, content) in files.items()
        }


def _read(response: httpx.Response) -> httpx.Response:
    response.read()
    return response


def _address(url: str) -> tuple[str, str | None]:
    """The address that a link to a server names, without the end, and the token that the link carries, or None."""
    expected = "expected one such as http://127.0.0.1:8080"
    try:
        parts = urlsplit(url)
        known = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port or 1) > 0
        httpx.URL(f"{parts.scheme}://{parts.netloc}")
    except (ValueError, httpx.InvalidURL):
        known = False
    if "@" in url:
        raise ServerError(f"the address of the server names a user, which no call tells; {expected}")
    if not known:
        raise ServerError(f"'{url.split('?')[0]:.200}' is not the address of a server; {expected}")
    token = parse_qs(parts.query).get("token", [None])[0]
    return f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}", token


def _authorization(token: str | None) -> dict[str, str]:
    if token is None:
        return {}
    # said here, as the libraries below quote a header that they refuse
    if not token or not all("!" <= letter <= "~" for letter in token):
        raise ServerError("the token is not one word of printable ASCII characters, as a header carries it")
    return {"Authorization": f"Bearer {token}"}


def _detail(response: httpx.Response) -> str | None:
    """The sentence by which a server of ours refuses; None where another answers."""
    if not response.headers.get("content-type", "").startswith(PROBLEM):
        return None
    try:
        detail = response.json()["detail"]
    except (ValueError, KeyError, TypeError):
        return None
    return detail if isinstance(detail, str) else None


def _retry_after(response: httpx.Response) -> float | None:
    """Seconds until the server wants to be asked again; None where it does not say."""
    said = response.headers.get("retry-after", "").strip()
    if said.isdecimal():
        return float(said)
    try:
        at = parsedate_to_datetime(said)
    except ValueError:
        return None
    return max(0.0, (at.replace(tzinfo=at.tzinfo or UTC) - datetime.now(UTC)).total_seconds())


def _plain(value: Any) -> Any:
    """NumPy's arrays and numbers as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is nothing that JSON has")
