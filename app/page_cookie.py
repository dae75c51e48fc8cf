"""Which cookie lets a page in? One of this server alone.

Browsers send a cookie to every port of a host. Its name and its key therefore belong to the data directory: servers
beside each other neither overwrite nor accept each other's, and people stay logged in over a restart.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path

FILE = "page_cookie.json"
_ID, _KEY = re.compile(r"[0-9a-f]{8}"), re.compile(r"[0-9a-f]{64}")

_log = logging.getLogger("pmpnbp.server")


@dataclass(frozen=True)
class PageCookie:
    """name : of the cookie; value : a keyed hash of the token, which it does not give away"""

    name: str
    value: str


def page_cookie(data_dir: Path, token: str) -> PageCookie:
    """That of the server whose data are in `data_dir`, for `token`. One server at a time may ask."""
    id, key = _read(data_dir / FILE) or _make(data_dir / FILE)
    return PageCookie(f"pmpnbp-{id}", hmac.new(bytes.fromhex(key), token.encode(), hashlib.sha256).hexdigest())


def _read(path: Path) -> tuple[str, str] | None:
    """Id and key, hexadecimal; None where there is no whole file."""
    try:
        document = json.loads(path.read_bytes())
        id, key = str(document["id"]), str(document["key"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None
    return (id, key) if _ID.fullmatch(id) and _KEY.fullmatch(key) else None


def _make(path: Path) -> tuple[str, str]:
    id, key = secrets.token_hex(4), secrets.token_hex(32)
    partial = path.with_name(f".{path.name}")
    try:
        partial.unlink(missing_ok=True)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            json.dump({"id": id, "key": key}, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        _log.warning("'%s' cannot be written (%s): pages must be opened by the link again after a restart", path, error)
    return id, key
