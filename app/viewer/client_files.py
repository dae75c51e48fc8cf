"""How does a browser get viser's program? As files that it keeps, and compiles beside what else it does.

viser's page holds its program packed, in base 88 and zstd, so that a scene can be sent as one file. A browser that has
to unpack it does nothing else for a quarter of a second, each time a view is opened. The server unpacks it once. A page
that is packed in another way is sent as it is.
"""

from __future__ import annotations

import gzip
import hashlib
import logging
import re
from dataclasses import dataclass
from functools import cache

import numpy as np
import zstandard

from app.viewer.client_page import CLIENT_PAGE

PLACE = "/viewer/"
# How long a browser may keep a file whose name says what is in it.
LASTING = "private, max-age=31536000, immutable"

_PACKED = re.compile(
    r'<script data-p="(?P<packed>[^"]*)" data-ss="(?P<styles>\d+)" data-cs="(?P<program>\d+)">(?P<unpack>.*?)</script>',
    re.DOTALL,
)
_DIGITS = b"!#$%()*+,-./0123456789:;=?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\]^_abcdefghijklmnopqrstuvwxyz{|}~"
# What of viser's own script has to be done before its program runs: the program takes its unpacker of messages from it.
_BEFORE = "await init();"

_log = logging.getLogger("pmpnbp.server")


@dataclass(frozen=True)
class ClientFile:
    """A file of viser's program. zipped : its content, as gzip; media_type : what it is"""

    zipped: bytes
    media_type: str


@cache
def client() -> tuple[str, dict[str, ClientFile]]:
    """viser's page, HTML, and the files that it asks for at PLACE, by name. A name says what is in the file, so that
    one that a browser has needs no asking whether it is still the same."""
    page = CLIENT_PAGE.read_text(encoding="utf-8")
    try:
        return _unpacked(page)
    except (ValueError, zstandard.ZstdError) as error:
        _log.warning("viser's page is sent as it is, which opens more slowly: %s", error)
        return page, {}


def client_places() -> list[str]:
    """The paths of those files."""
    return [PLACE + name for name in client()[1]]


def _unpacked(page: str) -> tuple[str, dict[str, ClientFile]]:
    found = _PACKED.search(page)
    if found is None or _BEFORE not in found["unpack"]:
        raise ValueError("its program is not packed as is known")
    sizes = int(found["styles"]), int(found["program"])
    text = zstandard.ZstdDecompressor().decompress(_bytes(found["packed"]), max_output_size=sum(sizes))
    if len(text) != sum(sizes):
        raise ValueError(f"its program has {len(text)} bytes; expected {sum(sizes)}")
    styles, program = _file(text[: sizes[0]], "css"), _file(text[sizes[0] :], "js")
    before = found["unpack"][: found["unpack"].index(_BEFORE) + len(_BEFORE)]
    load = (
        f'const e=document.createElement("script");e.type="module";e.src="{PLACE}{program[0]}";'
        "document.head.appendChild(e);})();"
    )
    head = (
        f'<link rel="modulepreload" href="{PLACE}{program[0]}"><link rel="stylesheet" href="{PLACE}{styles[0]}">'
        f"<script>{before}{load}</script>"
    )
    return page[: found.start()] + head + page[found.end() :], dict([styles, program])


def _bytes(text: str) -> bytes:
    """Of base 88: four bytes, the highest first, in five digits; what is left over in one digit more than bytes."""
    value = np.full(256, -1, dtype=np.int64)
    value[np.frombuffer(_DIGITS, dtype=np.uint8)] = np.arange(len(_DIGITS))
    digits = value[np.frombuffer(text.encode("latin-1"), dtype=np.uint8)]
    if (digits < 0).any():
        raise ValueError("its program has a letter that is no digit")
    whole = len(digits) // 5 * 5
    numbers = digits[:whole].reshape(-1, 5) @ 88 ** np.arange(4, -1, -1)
    rest, number = digits[whole:], 0
    for digit in rest:
        number = number * 88 + int(digit)
    left = max(len(rest) - 1, 0)
    return (numbers & 0xFFFFFFFF).astype(">u4").tobytes() + (number % 256**left).to_bytes(left, "big")


def _file(content: bytes, kind: str) -> tuple[str, ClientFile]:
    name = f"viser-{hashlib.sha256(content).hexdigest()[:16]}.{kind}"
    media_type = {"css": "text/css", "js": "text/javascript"}[kind]
    return name, ClientFile(gzip.compress(content, 6, mtime=0), f"{media_type}; charset=utf-8")
