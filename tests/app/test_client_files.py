"""viser's program as files: unpacked as viser's own page does it, and its page where it is packed in another way."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import zstandard

from app.viewer import client_files, client_shaders

DIGITS = client_files._DIGITS.decode()


def packed(data: bytes) -> str:
    """Slow and obvious: whole groups of four bytes in five digits, what is left over in one digit more than bytes."""
    text = ""
    for start in range(0, len(data), 4):
        group = data[start : start + 4]
        number, digits = int.from_bytes(group, "big"), ""
        for _ in range(len(group) + 1):
            number, digit = divmod(number, 88)
            digits = DIGITS[digit] + digits
        assert number == 0
        text += digits
    return text


@pytest.mark.parametrize("length", range(1, 13))
def test_bytes_in_base_88_come_back(length: int) -> None:
    for data in (bytes(length), b"\xff" * length, bytes(range(7, 7 + length))):
        assert client_files._bytes(packed(data)) == data


def page(styles: str, program: str, unpack: str = "(async()=>{await init();rest();})();") -> str:
    text = packed(zstandard.compress((styles + program).encode()))
    sizes = f'data-ss="{len(styles)}" data-cs="{len(program)}"'
    return f'<html><head><script data-p="{text}" {sizes}>{unpack}</script></head><body></body></html>'


def test_a_packed_page_becomes_one_with_files() -> None:
    text, files = client_files._unpacked(page("a{color:red}", "console.log(1)"))
    contents = {name.rpartition(".")[2]: gzip.decompress(file.zipped) for name, file in files.items()}
    assert contents == {"css": b"a{color:red}", "js": b"console.log(1)"}
    assert "data-p" not in text and "rest()" not in text and text.index("await init();") < text.index("createElement")
    assert all(text.count(client_files.PLACE + name) > 0 for name in files)


def test_the_installed_viser_is_unpacked() -> None:
    text, files = client_files.client()
    assert len(files) == 2 and len(text) < 100_000


def test_its_shaders_end_as_they_are_told_more() -> None:
    (program,) = (file for name, file in client_files.client()[1].items() if name.endswith(".js"))
    text = gzip.decompress(program.zipped).decode()
    assert all(text.count(end) == 1 for end in client_shaders.LABELS)


@pytest.mark.parametrize(
    "broken",
    [
        "<html><head></head></html>",
        page("a", "b", unpack="another()"),
        page("a", "b").replace('data-p="', 'data-p=" '),
        page("a", "b").replace('data-ss="1"', 'data-ss="2"'),
        page("a", "b").replace('data-ss="1"', 'data-ss="0"'),
        page("a", "b").replace('data-p="', 'data-p="!!!!!'),
    ],
)
def test_a_page_packed_in_another_way_is_sent_as_it_is(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "index.html").write_text(broken)
    monkeypatch.setattr(client_files, "CLIENT_PAGE", tmp_path / "index.html")
    assert client_files.client.__wrapped__() == (broken, {})
    assert "as it is" in caplog.text
