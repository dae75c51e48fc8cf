"""How is a file sent, or the ranges of it that are asked for?"""

from __future__ import annotations

from fastapi.responses import FileResponse
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from app.problems import HttpProblem, problem_response

_NO_RANGE = "the range {range!r} cannot be had of this file; expected bytes=FIRST-LAST, counted from 0, within the file"
# Of a range that is quoted.
_MOST = 80


class FileAnswer(FileResponse):
    """A file. A range that is none, or beyond the file's end, is answered as every failure is: with a problem."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        refused = False

        async def told(message: Message) -> None:
            nonlocal refused
            if message["type"] == "http.response.start" and message["status"] >= 400:
                refused = True
                size = Headers(raw=message["headers"]).get("content-range")
                asked = Headers(scope=scope).get("range", "")[:_MOST]
                headers = {} if size is None else {"Content-Range": size}
                problem = HttpProblem(message["status"], _NO_RANGE.format(range=asked), headers=headers)
                await problem_response(problem)(scope, receive, send)
            elif not refused:
                await send(message)

        await super().__call__(scope, receive, told)
