"""The pages and their files: plain HTML, CSS and scripts, as they lie in `static/`, and the letters they are set in."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from fastapi import APIRouter, Request, Response

from app.http.file_answers import FileAnswer
from app.problems import HttpProblem
from app.routes.entries import not_modified
from app.uploads.uploads import unchanged

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


@router.get("/")
def start(request: Request) -> Response:
    """The list of sessions."""
    return _file("index.html", request)


@router.get("/sessions/{session_id}")
@router.get("/sessions/{session_id}/")
def session_page(request: Request) -> Response:
    """The page of one session or recording, which asks for it itself and says where there is none."""
    return _file("session.html", request)


@router.get("/compare")
def compare_page(request: Request) -> Response:
    """Several sessions side by side, those that `?sessions=ID,ID` names; the page asks for them itself."""
    return _file("compare.html", request)


@router.get("/favicon.ico")
def icon(request: Request) -> Response:
    """What browsers ask for without being told to."""
    return _file("icon.svg", request)


@router.get("/static/{name:path}")
def static_file(name: str, request: Request) -> Response:
    """One of the page's files, by its path in the folder."""
    return _file(name, request)


def _file(name: str, request: Request) -> Response:
    """The file, or 304 where the browser has it as it is."""
    files = {path.relative_to(STATIC).as_posix(): path for path in STATIC.rglob("*") if path.suffix in MEDIA_TYPES}
    # where they were left out of an installation, the system's own letters stand in for them
    files |= {f"fonts/{face}": FONTS / face for face in FACES if (FONTS / face).is_file()}
    if name not in files:
        raise HttpProblem(404, f"page file '{name}' is not here; there are {', '.join(sorted(files)) or 'none'}")
    path = files[name]
    answer = FileAnswer(path, media_type=MEDIA_TYPES[path.suffix], stat_result=path.stat())
    return not_modified(answer.headers["etag"]) if unchanged(request, answer.headers["etag"]) else answer
