"""Is it seen when the page reads what the server no longer answers? Every page test runs under `strict_answers`."""

from __future__ import annotations

import copy

import pytest
from playwright.sync_api import Page

from tests.app import small_sessions as small
from tests.browser.conftest import Troubles, document, strict_answers
from tests.browser.session_page import opened, wait
from tests.servers import Served


@pytest.fixture(scope="module")
def session(served: Served) -> str:
    return small.after(served.client, 2)


@pytest.mark.parametrize(
    ("schema", "member"),
    [("LinkEstimate", "visible_fraction"), ("Session", "max_std"), ("TraceRow", "std_xyz"), ("GraphPart", "links")],
)
def test_a_renamed_member_is_seen(
    page: Page, served: Served, session: str, troubles: Troubles, schema: str, member: str
) -> None:
    renamed = copy.deepcopy(document())
    members = renamed["components"]["schemas"][schema]["properties"]
    members[f"new_{member}"] = members.pop(member)
    page.add_init_script(strict_answers(renamed))
    troubles.expect("")  # the page cannot work: what matters is that it says why
    page.goto(f"{served.url}/sessions/{session.rsplit('/', 1)[1]}/")
    wait(page, lambda: any(f"'{member}'" in text for text in troubles.found))


def test_a_page_of_a_server_that_keeps_its_word_has_no_trouble(
    page: Page, served: Served, session: str, troubles: Troubles
) -> None:
    opened(page, served, session)
    assert page.evaluate(
        "fetch('/api/v1/sessions').then((a) => a.text()).then((t) => JSON.parse(t)[0].view_url)"
    ).startswith("/sessions/")
    assert troubles.unexpected() == []
