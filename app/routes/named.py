"""How does a name with a slash stand in an address? As `robot%2Fdrawer1`, or, where that can be told apart, as it is.

The server decodes `%2F` before it looks for a route. Here the slash of a name is kept apart from those between the
steps of a path: what was sent as `%2F` is matched as HIDDEN, which no address can hold, and decoded with the name.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Annotated
from urllib.parse import unquote

from fastapi import Path
from fastapi.routing import APIRoute
from pydantic import AfterValidator
from starlette.routing import Match
from starlette.types import Scope

# Half of a surrogate pair: decoding an address never makes one.
HIDDEN = "\udc2f"


class NamedRoute(APIRoute):
    """A route whose path holds names, each as `{name:path}`."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """As any route, by the path with the slashes of names hidden."""
        raw = scope.get("raw_path") or b""
        if scope["type"] != "http" or b"%2f" not in raw.lower():
            return super().matches(scope)
        hidden = HIDDEN.join(unquote(step) for step in re.split("%2[fF]", raw.decode("ascii", "replace")))
        return super().matches({**scope, "path": hidden})


def shown(text: str) -> str:
    """Part of a path as it was meant."""
    return text.replace(HIDDEN, "/")


Link = Annotated[str, Path(description="name of the link; a slash in it as %2F"), AfterValidator(shown)]


def two_names(text: str, known: Collection[str]) -> tuple[str, str]:
    """The two names that stand in a path as FIRST/SECOND, of those that are `known`; where slashes were not encoded
    and not just one place parts two known names, as the last one parts them."""
    steps = text.split("/")
    parted = [(shown("/".join(steps[:k])), shown("/".join(steps[k:]))) for k in range(1, len(steps))]
    found = [pair for pair in parted if set(pair) <= set(known)]
    return found[0] if len(found) == 1 else parted[-1]
