"""How does a call reach a server, and come to an answer? With the token, and once more where that can do no harm.

A call that never arrived, or that the server refused for now (429, 503), has changed nothing: any call is made again.
Where the connection broke before the answer came, the call may have been done: then only those are made again that do
no more the second time, which are reads, deletions, and what carries an Idempotency-Key.
"""

from __future__ import annotations

import json
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from itertools import count
from typing import Any, TypeVar
from urllib.parse import parse_qs, quote, urlsplit

import httpx
import numpy as np

from pmpnbp.errors import ServerError

Used = TypeVar("Used")

PROBLEM = "application/problem+json"
# Seconds before a call is made again where the server names none; doubled each time, up to the longest.
FIRST_WAIT, LONGEST_WAIT = 0.5, 8.0
# Of the seconds that a server names, so many at most.
LONGEST_RETRY_AFTER = 60.0
# Seconds until an address that says nothing is taken for nobody's.
CONNECT_SECONDS = 10.0
# Seconds that a server may compute before it answers, where a call makes it compute.
COMPUTING_SECONDS = 600.0
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
# Nothing of the call was sent where one of these was raised.
_NEVER_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout, httpx.ProxyError)


@dataclass(frozen=True, kw_only=True)
class Call:
    """What is asked of a server.

    path : below /api/v1/, as `path_of` makes it
    files, data : of a form; json : of a body
    repeatable : whether a second time does no more than the first
    read_seconds : without a byte from the server, until it is taken for gone; None: without end; default: the client's
    """

    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    files: Mapping[str, tuple[str, bytes]] | None = None
    data: Mapping[str, str] | None = None
    repeatable: bool = False
    read_seconds: float | None = 0.0

    def keyed(self) -> Call:
        """The same, safe to be made again: the server knows it by its key."""
        return replace(self, headers={**self.headers, "Idempotency-Key": str(uuid.uuid4())}, repeatable=True)

    @property
    def has_key(self) -> bool:
        """Whether the server knows it by its key."""
        return "Idempotency-Key" in self.headers


class Failure(Exception):
    """An attempt that came to nothing.

    error : what to raise where no further one is made
    broke : whether the call was sent, and nobody knows what became of it
    refused_for_now : whether the server did nothing, and may do it later; wait : after so many seconds, where it says
    """

    def __init__(
        self, error: ServerError, *, broke: bool = False, refused_for_now: bool = False, wait: float | None = None
    ) -> None:
        super().__init__(str(error))
        self.error = error
        self.broke = broke
        self.refused_for_now = refused_for_now
        self.wait = wait


class Calls:
    """Calls to one server. Thread-safe. address : without the token, as errors name it"""

    def __init__(self, url: str, token: str | None, timeout: float, retries: int) -> None:
        self.address, in_link = _address(url)
        self._token = in_link if token is None else token
        self._timeout = timeout
        self.retries = retries
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

    def get(self, *path: str, read_seconds: float | None = 0.0, **params: Any) -> httpx.Response:
        """The answer to a GET. params : of the query, those that are not None. Raises ServerError."""
        given = {name: value for name, value in params.items() if value is not None}
        return self.answer(
            Call(method="GET", path=path_of(*path), params=given, repeatable=True, read_seconds=read_seconds)
        )

    def answer(self, call: Call) -> httpx.Response:
        """The server's answer, all of it. Raises ServerError."""
        return self.used(call, _read)

    def used(self, call: Call, use: Callable[[httpx.Response], Used]) -> Used:
        """What `use` makes of the answer, which is still to be read; called anew where the connection breaks meanwhile.
        Raises ServerError."""
        broke = False
        for attempt in count():
            try:
                with self.once(call) as response:
                    return use(response)
            except Failure as failure:
                if broke and call.method == "DELETE" and failure.error.status == 404:
                    return use(httpx.Response(204))  # the attempt whose answer was lost has deleted it
                # 409: the attempt whose answer was lost is still at work
                at_work = broke and call.has_key and failure.error.status == 409
                again = failure.refused_for_now or at_work or (failure.broke and call.repeatable)
                if attempt >= self.retries or not again:
                    raise failure.error from None
                broke = broke or failure.broke
                wait(attempt, failure)
        raise AssertionError("count() does not end")

    @contextmanager
    def once(self, call: Call) -> Iterator[httpx.Response]:
        """The answer to one attempt, still to be read. Raises Failure, also where the connection breaks meanwhile."""
        headers, content = dict(call.headers), None
        if call.json is not None:
            headers["Content-Type"], content = "application/json", json_text(call.json).encode()
        read = None if call.read_seconds is None else max(call.read_seconds, self._timeout)
        try:
            with self._client.stream(
                call.method,
                f"{self.address}/api/v1/{call.path}",
                params=call.params or None,
                headers=headers,
                content=content,
                files=call.files,
                data=call.data,
                timeout=httpx.Timeout(self._timeout, connect=min(self._timeout, CONNECT_SECONDS), read=read),
            ) as response:
                if not response.is_success:
                    response.read()
                    raise self._refusal(response, call)
                yield response
        except httpx.RequestError as error:
            raise self._silence(error, call) from None

    def _refusal(self, response: httpx.Response, call: Call) -> Failure:
        status, seconds, detail = response.status_code, _retry_after(response), _detail(response)
        # A 503 without a time is for good where the server itself says it: there is nothing to draw with. Where another
        # on the way says it, nobody knows what became of the call.
        later = status == 429 or (status == 503 and (seconds is not None if detail else call.repeatable))
        if detail is None:
            points = f", pointing to {response.headers['location']}" if "location" in response.headers else ""
            detail = f"{self.address} answers {status} {response.reason_phrase}{points}, as no pmpnbp server does"
        return Failure(ServerError(detail, status), refused_for_now=later, wait=seconds)

    def _silence(self, error: httpx.RequestError, call: Call) -> Failure:
        why = str(error) or type(error).__name__
        if isinstance(error, _NEVER_SENT):
            return Failure(ServerError(f"no server answers at {self.address} ({why})"), refused_for_now=True)
        unknown = "" if call.repeatable else "; whether it was done is not known"
        return Failure(ServerError(f"the server at {self.address} broke off a call ({why}){unknown}"), broke=True)


def path_of(*steps: str) -> str:
    """The steps as a path, each with its slashes encoded."""
    return "/".join(quote(step, safe="") for step in steps)


def json_text(value: Any) -> str:
    """`value` as JSON; arrays and numbers of NumPy's may be in it."""
    return json.dumps(value, default=_plain)


def wait(attempt: int, failure: Failure) -> None:
    """Let so much time go by as is due before the next attempt. attempt : how many failed before this one"""
    if failure.wait is not None:
        time.sleep(min(failure.wait, LONGEST_RETRY_AFTER))
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
