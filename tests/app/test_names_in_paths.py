"""Do links whose names hold slashes, per cents and other signs reach their beliefs, messages and views?"""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from app.routes.named import HIDDEN, two_names
from tests.app import small_sessions as small

NAMES = ("robot/drawer1", "100%2F", "a?b#c", "x \"y\" 'z'", "Schublade ü/抽屉", "robot/../marginals")


def urdf(first: str, second: str) -> bytes:
    """The sample cabinet, whose frame and first drawer are called so."""
    text = (small.CABINET / "cabinet.urdf").read_text(encoding="utf-8")
    for old, new in (("frame", first), ("drawer1", second)):
        escaped = new.replace("&", "&amp;").replace('"', "&quot;")
        text = re.sub(f'(link|name)="{old}"', lambda found, e=escaped: f'{found[1]}="{e}"', text)
    return text.encode()


def session(client: httpx.Client, first: str, second: str) -> tuple[str, dict[str, Any]]:
    answer = client.post("/api/v1/models", files={"file": ("cabinet.urdf", urdf(first, second))})
    assert answer.status_code == 201, answer.text
    return small.after(client, 5, model_id=answer.json()["id"]), answer.json()


@pytest.mark.parametrize("name", NAMES)
def test_a_link_is_found_by_its_encoded_name(client: httpx.Client, name: str) -> None:
    path, model = session(client, "robot/base", name)
    assert {"robot/base", name} <= set(model["links"])
    link, base = quote(name, safe=""), quote("robot/base", safe="")
    for call in ("", "/marginals", "/particles", "/particles/3", "/particles/3?iteration=4"):
        answer = client.get(f"{path}/beliefs/{link}{call}")
        assert answer.status_code == 200, answer.text
        assert answer.json()["link"] == name
    assert client.get(f"{path}/beliefs/{link}/particles/3/picture.png").headers["content-type"] == "image/png"
    assert client.get(f"{path}/posterior/{link}").json()["link"] == name
    for one, other, receiver in ((base, link, name), (link, base, "robot/base")):
        answer = client.get(f"{path}/messages/{one}/{other}")
        assert answer.status_code == 200, answer.text
        assert answer.json()["link"] == receiver
    assert client.get(f"{path}/decision", params={"links": name}).json()["links"] == [name]
    assert name in client.get(f"{path}/estimate").json()["links"]
    view = client.patch(f"{path}/views/v1", json={"part": name, "edge": ["robot/base", name]})
    assert (view.status_code, view.json()["part"]) == (200, name)


def test_names_with_commas_are_found_in_a_query(client: httpx.Client) -> None:
    path, _ = session(client, "a", "a,b")
    for call in ("decision", "posterior"):

        def asked(*links: str, call: str = call) -> httpx.Response:
            return client.get(f"{path}/{call}", params={"links": links})

        for links, names in (
            (("a,b",), ["a,b"]),
            (("a", "a,b", "a"), ["a", "a,b"]),
            (("drawer2,a", "a,b"), ["drawer2", "a", "a,b"]),
        ):
            told = asked(*links).raise_for_status().json()
            found = told["links"] if call == "decision" else dict.fromkeys(one["link"] for one in told["coordinates"])
            assert [name for name in found if name] == names
        small.problem(asked("a,b", "a,c"), 404, "link 'c' is not in the model; it has a, a,b")
        small.problem(asked(""), 404, "link '' is not in the model")
        declared = client.get("/openapi.json").json()["paths"][f"/api/v1/sessions/{{session_id}}/{call}"]["get"]
        (links_of_it,) = (one for one in declared["parameters"] if one["name"] == "links")
        assert {"type": "string"} in [one.get("items") for one in links_of_it["schema"]["anyOf"]]


def test_slashes_that_are_not_encoded_are_told_apart_where_they_can_be(client: httpx.Client) -> None:
    path, _ = session(client, "robot/base", "robot/drawer1")
    for call in ("", "/marginals", "/particles/3"):
        assert client.get(f"{path}/beliefs/robot/drawer1{call}").json()["link"] == "robot/drawer1"
    found = client.get(f"{path}/messages/robot/base/robot/drawer1").json()
    assert (found["from"], found["link"]) == ("robot/base", "robot/drawer1")
    small.problem(client.get(f"{path}/messages/robot/base/robot/none"), 404, "is not in the model")
    small.problem(client.get(f"{path}/beliefs/robot%2Fnone"), 404, "link 'robot/none' is not in the model")
    small.problem(client.get(f"{path}/beliefs/"), 404, "link '' is not in the model")


@pytest.mark.parametrize(
    ("text", "known", "names"),
    [
        ("a/b", {"a", "b"}, ("a", "b")),
        (f"a{HIDDEN}b/c", {"a/b", "c"}, ("a/b", "c")),
        ("a/b/c", {"a/b", "c"}, ("a/b", "c")),
        ("a/b/c", {"a", "b/c"}, ("a", "b/c")),
        ("a/b/c", {"a", "b/c", "a/b", "c"}, ("a/b", "c")),
        (f"a/b{HIDDEN}c", {"a", "b/c", "a/b", "c"}, ("a", "b/c")),
        ("a/b/c", set(), ("a/b", "c")),
    ],
)
def test_two_names_are_parted(text: str, known: set[str], names: tuple[str, str]) -> None:
    assert two_names(text, known) == names


def test_the_document_names_its_parameters_as_before(client: httpx.Client) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    root = "/api/v1/sessions/{session_id}"
    for path in (
        "beliefs/{link}",
        "beliefs/{link}/particles/{index}",
        "posterior/{link}",
        "messages/{sender}/{receiver}",
    ):
        assert f"{root}/{path}" in paths


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("n" * 1_000_000, "of more than 4096 characters"),
        ("n" * 300, "has 300 characters; expected at most 255"),
        ("a&#x85;b", "has the character U+0085"),
        ("..", "is a step of a path"),
    ],
)
def test_what_is_no_name_is_refused(client: httpx.Client, name: str, says: str) -> None:
    link = f'<robot name="r"><link name="{name}"/></robot>'
    joint = (
        '<robot name="r"><link name="a"/><link name="b"/>'
        f'<joint name="{name}" type="fixed"><parent link="a"/><child link="b"/></joint></robot>'
    )
    for text in (link, joint, f'<robot name="{name}"><link name="a"/></robot>'):
        answer = client.post("/api/v1/models", files={"file": ("a.urdf", text.encode())})
        small.problem(answer, 422, says)
        assert len(answer.content) < 1000
