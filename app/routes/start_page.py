"""The pages and their files: plain HTML, CSS and scripts, as they lie in `static/`, and the letters they are set in."""

from __future__ import annotations

import hashlib
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from app.http.file_answers import FileAnswer
from app.problems import HttpProblem
from app.routes.entries import not_modified
from app.uploads.uploads import unchanged
from app.viewer.client_files import LASTING, client_places

router = APIRouter(include_in_schema=False)

# In a checkout a link to the folder `static` beside `app`; in a wheel its files.
STATIC = Path(__file__).resolve().parents[1] / "static"
# What may be asked for, and as what it is sent; nothing else in the folder, and nothing outside it, can be reached.
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".ttf": "font/ttf",
}
# Open Sans (Apache License 2.0) comes with a package that is needed anyway: the same letters on every system, of which
# none has to be kept here.
FONTS = Path(str(find_spec("pyrender").origin)).parent / "fonts"  # type: ignore[union-attr] # it is a dependency
FACES = ("OpenSans-Regular.ttf", "OpenSans-Semibold.ttf")
# How a version of them all looks, which the paths that a page tells begin with.
_IS_VERSION = re.compile("[0-9a-f]{12}")


@router.get("/")
def start(request: Request) -> Response:
    """The list of sessions."""
    return _page("index.html", "start", request)


@router.get("/compare")
def compare_page(request: Request) -> Response:
    """Several sessions side by side, those that `?sessions=ID,ID` names; the page asks for them itself."""
    return _page("compare.html", "compare", request)


@router.get("/sessions/{session_id}")
@router.get("/sessions/{session_id}/")
def session_page(request: Request) -> Response:
    """The page of one session or recording, which asks for it itself and says where there is none."""
    return _page("session.html", "session", request)


@router.get("/favicon.ico")
def icon(request: Request) -> Response:
    """What browsers ask for without being told to."""
    return _file("icon.svg", request)


@router.get("/static/{name:path}")
def static_file(name: str, request: Request) -> Response:
    """One of the page's files, by its path in the folder."""
    return _file(name, request)


def _page(name: str, scripts: str, request: Request) -> Response:
    """A page, and word of its scripts: each would else be asked for only once the one that imports it is there. Its
    files' addresses hold their version, so that a browser that has them does not ask for them again. What a session's
    page will need is fetched meanwhile, except for whoever saves data: it is a megabyte."""
    place = f"/static/{_VERSION.now()}/"
    needed = [f'<link rel="modulepreload" href="{place}{module}">' for module in _modules(scripts)]
    frugal = scripts == "session" or request.headers.get("save-data") == "on"
    soon = [] if frugal else [f"{place}{module}" for module in _modules("session")] + client_places()
    later = [f'<link rel="prefetch" href="{path}">' for path in soon]
    text = _found(name).read_text(encoding="utf-8").replace('"/static/', f'"{place}')
    text = text.replace("</head>", "\n".join([*needed, *later, "</head>"]))
    tag = f'"{hashlib.sha256(text.encode()).hexdigest()[:32]}"'
    if unchanged(request, tag):
        return not_modified(tag)
    return HTMLResponse(text, headers={"ETag": tag, "Vary": "Save-Data"})


def _file(name: str, request: Request) -> Response:
    """The file, or 304 where the browser has it as it is; under the version that a page has last told it never changes,
    as no page will ask for what has changed by that name."""
    version, _, rest = name.partition("/")
    named = version == _VERSION.told()
    path = _found(rest if _IS_VERSION.fullmatch(version) else name)
    answer = FileAnswer(path, media_type=MEDIA_TYPES[path.suffix], stat_result=path.stat())
    if named:
        answer.headers["Cache-Control"] = LASTING
    return not_modified(answer.headers["etag"]) if unchanged(request, answer.headers["etag"]) else answer


def _found(name: str) -> Path:
    path = _files().get(name)
    if path is None or not path.is_file():
        raise HttpProblem(404, f"page file '{name}' is not here; there are {', '.join(_files()) or 'none'}")
    return path


def _modules(folder: str) -> list[str]:
    return [path for path in _files() if path.startswith(f"{folder}/") and path.endswith(".js")]


class _Version:
    """Of all files together. A look at it asks the system for the state of each of them: a page does so once, so that a
    file that is edited while the server runs is seen at once, and none of its seventy files does again."""

    def __init__(self) -> None:
        self._told: str | None = None

    def now(self) -> str:
        states = [(name, path.stat()) for name, path in _files().items() if path.is_file()]
        told = repr([(name, state.st_mtime_ns, state.st_size) for name, state in states])
        self._told = hashlib.sha256(told.encode()).hexdigest()[:12]
        return self._told

    def told(self) -> str:
        """What `now` said last."""
        return self._told or self.now()


_VERSION = _Version()


@cache
def _files() -> dict[str, Path]:
    """What may be asked for, by its path in the folder. Looked up once: a page asks for fifty of them."""
    files = {path.relative_to(STATIC).as_posix(): path for path in STATIC.rglob("*") if path.suffix in MEDIA_TYPES}
    # where they were left out of an installation, the system's own letters stand in for them
    files |= {f"fonts/{face}": FONTS / face for face in FACES if (FONTS / face).is_file()}
    return dict(sorted(files.items()))
