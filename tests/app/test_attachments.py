"""Names of files that answers are kept as: those who read RFC 6266 have them as they are, all others something safe."""

from __future__ import annotations

from email.message import Message

import pytest

from app.routes.attachments import attachment


@pytest.mark.parametrize(
    ("name", "safe", "whole"),
    [
        ("drawer1-14.ply", "drawer1-14.ply", "drawer1-14.ply"),
        ("ящик-14.ply", "____-14.ply", "ящик-14.ply"),
        ("引き出し", "____", "引き出し"),
        ('a"b\r\nSet-Cookie: x.ply', "a_b__Set-Cookie__x.ply", "a_b__Set-Cookie_ x.ply"),
        ("top/left-1.ply", "left-1.ply", "top_left-1.ply"),
    ],
)
def test_a_file_has_its_name_in_any_script(name: str, safe: str, whole: str) -> None:
    header = attachment(name)["Content-Disposition"]
    assert header.isascii() and header.isprintable()
    assert f'filename="{safe}"' in header
    read = Message()
    read["Content-Disposition"] = header.replace('filename="', 'plain="', 1) if "filename*" in header else header
    assert read.get_filename() == whole
