"""Under which name is an answer kept as a file?"""

from __future__ import annotations

import re
from urllib.parse import quote

from app.store.store import safe_name

# What no system's file names take.
_NO_NAME = re.compile(r'[\x00-\x1f\x7f/\\:*?"<>|]')


def attachment(name: str) -> dict[str, str]:
    """The header of an answer that is a file called `name`: letters of any script stay where the client reads RFC 6266,
    and are `_` where it does not."""
    safe, whole = safe_name(name), _NO_NAME.sub("_", name)
    also = "" if safe == whole else f"; filename*=UTF-8''{quote(whole, safe='', errors='replace')}"
    return {"Content-Disposition": f'attachment; filename="{safe}"{also}'}
