"""Who may come in? Middleware in front of every route, the 3D view's websocket included.

With a token, a call carries it as `Authorization: Bearer …`; a page is opened once with `?token=…` in its link, which
is answered with a cookie (`page_cookie`) and the link without it.
Without a token the server is open to this machine alone, and still refuses a request that names another host (a
page elsewhere whose name was made to resolve to this machine) and one that another origin's page makes.
"""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers as HeaderView
from starlette.datastructures import MutableHeaders
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.page_cookie import PageCookie
from app.problems import HttpProblem, problem_response
from app.server_config import LOOPBACK, ServerConfig

# Probes come without a token, and tell nothing but that the server lives.
OPEN_PATHS = ("/healthz", "/readyz")
SAFE_METHODS = ("GET", "HEAD", "OPTIONS")

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
    "connect-src 'self' data: blob:; frame-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'self'"
)
# viser's client has inline script that unpacks WebAssembly, starts workers from data: and evaluates the script of its
# plots. `connect-src 'self'` is what keeps `?websocket=` in a link from talking to another server.
VIEW_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; connect-src 'self' data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
_ALWAYS = {
    "Content-Security-Policy": PAGE_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


class Headers:
    """Adds the headers that keep a browser from being used against us, where a route has not set its own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, with headers added to the response."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _ALWAYS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, with_headers)


class Access:
    """Lets in who has the token, or, without one, who is on this machine; never another origin's page."""

    def __init__(self, app: ASGIApp, config: ServerConfig) -> None:
        self._app = app
        self._config = config

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, or answer with a redirect that sets the cookie, 401 or 403."""
        if scope["type"] not in ("http", "websocket") or scope["path"] in OPEN_PATHS:
            await self._app(scope, receive, send)
            return
        answer = self._answer(scope)
        if answer is None:
            await self._app(scope, receive, send)
        else:
            await answer(scope, receive, send)

    def _answer(self, scope: Scope) -> Response | None:
        """What to answer instead of passing on; None: pass on."""
        headers = HeaderView(scope=scope)
        if self._config.token is None:
            problem = _wrong_host(headers, self._config) or self._wrong_origin(scope, headers, trusted=False)
            return None if problem is None else problem_response(problem)
        given = _bearer(headers)
        if given is not None:
            return None if self._right(given) else problem_response(_unauthorized("the token is wrong"))
        in_link = _token_in_link(scope)
        if in_link is not None:
            return self._welcome(scope, in_link)
        if not _has_cookie(headers, _cookie(scope)):
            return problem_response(_unauthorized("a token is needed"))
        problem = self._wrong_origin(scope, headers, trusted=True)
        return None if problem is None else problem_response(problem)

    def _right(self, token: str) -> bool:
        assert self._config.token is not None
        return hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self._config.token.encode())

    def _welcome(self, scope: Scope, token: str) -> Response:
        """The page's link, opened: the cookie, and the same address without the token."""
        if not self._right(token):
            return problem_response(_unauthorized("the token in the link is wrong"))
        rest = [pair for pair in _query(scope) if pair[0] != "token"]
        # From `//host` a browser would make another server's address
        path = "/" + scope["path"].lstrip("/\\")
        response = RedirectResponse(path + ("?" + urlencode(rest) if rest else ""), 303)
        response.headers["Cache-Control"] = "no-store"
        response.set_cookie(
            _cookie(scope).name,
            _cookie(scope).value,
            path="/",
            httponly=True,
            samesite="lax",
            secure=scope.get("scheme") == "https",
        )
        return response

    def _wrong_origin(self, scope: Scope, headers: HeaderView, trusted: bool) -> HttpProblem | None:
        """Whether a page of another origin makes a call that it must not make. `trusted`: the call has our cookie."""
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE_METHODS
        origin = headers.get("origin")
        if origin is None:
            # Browsers name the origin of what changes something: what has a cookie but no origin is no page of ours
            foreign = headers.get("sec-fetch-site", "none") not in ("same-origin", "none")
            if changes and (trusted or foreign):
                return HttpProblem(403, "the call carries a cookie or comes from a page, but does not name its origin")
            return None
        if changes and not _same_origin(origin, headers.get("host", ""), scope):
            return HttpProblem(403, f"the call comes from a page of {origin!r}, which is not this server's")
        return None


def _cookie(scope: Scope) -> PageCookie:
    """That of the server, which has it since its data directory is open."""
    cookie: PageCookie = scope["app"].state.page_cookie
    return cookie


def _has_cookie(headers: HeaderView, ours: PageCookie) -> bool:
    cookies: SimpleCookie = SimpleCookie()
    try:
        for line in headers.getlist("cookie"):
            cookies.load(line)
    except CookieError:
        return False
    return ours.name in cookies and hmac.compare_digest(cookies[ours.name].value.encode(), ours.value.encode())


def _unauthorized(what: str) -> HttpProblem:
    detail = f"{what}: send it as 'Authorization: Bearer TOKEN', or open the link that the server printed at its start"
    return HttpProblem(401, detail, headers={"WWW-Authenticate": 'Bearer realm="pmpnbp"'})


def _bearer(headers: HeaderView) -> str | None:
    kind, _, value = headers.get("authorization", "").partition(" ")
    return value.strip() if kind.lower() == "bearer" else None


def _query(scope: Scope) -> list[tuple[str, str]]:
    return parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)


def _token_in_link(scope: Scope) -> str | None:
    """The token in a page's link. Calls of programs do not take it there: addresses end up in logs."""
    if scope["type"] != "http" or scope["method"] not in ("GET", "HEAD") or scope["path"].startswith("/api/"):
        return None
    return next((value for name, value in _query(scope) if name == "token"), None)


def _wrong_host(headers: HeaderView, config: ServerConfig) -> HttpProblem | None:
    """Whether the request names a host that is not this machine."""
    name = _host_name(headers.get("host", ""))
    if name in LOOPBACK or name == config.host.lower():
        return None
    return HttpProblem(403, f"the request is for host {name!r}; without a token this server is only for localhost")


def _host_name(host: str) -> str:
    """`[::1]:8080` as ::1."""
    try:
        return urlsplit("//" + host).hostname or ""
    except ValueError:
        return ""


def _same_origin(origin: str, host: str, scope: Scope) -> bool:
    """Whether `origin` is where this request went to. A proxy that ends TLS leaves the scheme unknown: not compared."""
    try:
        theirs, ours = urlsplit(origin), urlsplit("//" + host)
        if theirs.scheme not in ("http", "https") or not theirs.hostname:
            return False
        standard = 443 if theirs.scheme == "https" else 80
        return (theirs.hostname, theirs.port or standard) == (ours.hostname, ours.port or standard)
    except ValueError:
        return False
