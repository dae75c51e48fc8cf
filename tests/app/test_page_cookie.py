"""Does a page's cookie belong to one server alone, and survive its restart?"""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from app.page_cookie import FILE, page_cookie
from tests.servers import serving


def test_servers_beside_each_other_leave_each_others_cookie_alone(tmp_path: Path) -> None:
    """A browser sends the cookies of one port to all ports of the host, and keeps one of each name."""
    with ExitStack() as stack, httpx.Client(timeout=None) as browser:
        one, two = (stack.enter_context(serving(tmp_path / name))(token="the same") for name in ("one", "two"))
        for served in (one, two):
            assert browser.get(served.url, params={"token": "the same"}, follow_redirects=True).status_code == 200
        assert len(browser.cookies) == 2
        for served in (one, two):
            assert browser.get(f"{served.url}/api/v1/settings").status_code == 200
        theirs = {name: value for name, value in browser.cookies.items() if name != one.app.state.page_cookie.name}
        assert httpx.get(f"{one.url}/api/v1/settings", cookies=theirs).status_code == 401
        (name,) = theirs
        renamed = {one.app.state.page_cookie.name: theirs[name]}
        assert httpx.get(f"{one.url}/api/v1/settings", cookies=renamed).status_code == 401


def test_who_is_logged_in_stays_so_over_a_restart(tmp_path: Path) -> None:
    first = page_cookie(tmp_path, "token")
    assert page_cookie(tmp_path, "token") == first
    assert (tmp_path / FILE).stat().st_mode & 0o777 == 0o600
    other = page_cookie(tmp_path, "another token")
    assert other.name == first.name and other.value != first.value


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"id": "0123456z", "key": 1}', b"[" * 100_000, b"\xff"])
def test_a_damaged_file_is_made_anew(tmp_path: Path, content: bytes) -> None:
    first = page_cookie(tmp_path, "token")
    (tmp_path / FILE).write_bytes(content)
    second = page_cookie(tmp_path, "token")
    assert second != first and page_cookie(tmp_path, "token") == second


def test_where_it_cannot_be_written_the_server_starts_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert page_cookie(tmp_path, "token").name.startswith("pmpnbp-")
    assert "cannot be written" in caplog.text and not (tmp_path / FILE).exists()


def test_a_server_without_a_token_needs_none(tmp_path: Path) -> None:
    with serving(tmp_path) as start:
        start()
        assert not (tmp_path / FILE).exists()
