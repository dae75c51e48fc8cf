"""8: links whose names have a slash, as ROS gives them, and names without end."""

from __future__ import annotations

from urllib.parse import quote

import httpx

from tests.app.attacks import entries
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.poisoned_text import GAUSSIAN
from tests.app.attacks.target import Target

BASE, DRAWER = "robot/frame", "robot/drawer1"


def attack(target: Target, outcome: Outcome) -> None:
    """Everything that is asked for by a link's name."""
    outcome.did.append(f"a model with links {BASE} and {DRAWER}; names of 1 MB")
    with target.client() as client:
        prior = GAUSSIAN | {"link": BASE}
        session = entries.small_session(target, client, 5, entries.WITH_SLASHES, prior=prior)
        estimate = outcome.answered("GET estimate", client.get(f"{session}/estimate"), {200}).json()
        outcome.expect({BASE, DRAWER} <= set(estimate["links"]), f"the estimate has links {list(estimate['links'])}")
        one, other = quote(BASE, safe=""), quote(DRAWER, safe="")
        for path in (
            *(f"beliefs/{other}{query}" for query in ("", "?format=npz", "?format=ply")),
            f"beliefs/{other}/marginals",
            f"beliefs/{other}/particles",
            f"beliefs/{other}/particles/0",
            f"beliefs/{other}/particles/0/picture.png",
            *(f"messages/{one}/{other}{query}" for query in ("", "?format=npz", "?format=ply")),
            f"messages/{other}/{one}",
            f"decision?links={other}",
            f"decision?links={DRAWER}",
            f"posterior?links={other}",
        ):
            answer = outcome.answered(f"GET {path}", client.get(f"{session}/{path}"), {200})
            _is_of(outcome, path, answer)
        answer = client.get(f"{session}/posterior/{other}?iteration=0")  # of the search, which has none
        outcome.answered(f"GET posterior/{other} of the search", answer, {404})
        outcome.expect(DRAWER in answer.text or "posterior" in answer.text, f"posterior/{other}: {answer.text[:160]}")
        body = {"links": [DRAWER]}
        outcome.answered("POST decision", client.post(f"{session}/decision", json=body), {200})
        for state in ({"part": DRAWER}, {"part": DRAWER, "particle": 0}, {"edge": [BASE, DRAWER]}, {"prior": prior}):
            answer = client.patch(f"{session}/views/attacked", json=state)
            outcome.answered(f"PATCH of a view with {next(iter(state))}", answer, {200})
        outcome.answered("the scene as a page", client.get(f"{session}/views/attacked/scene.html"), {200})
        for path, expected in ((f"beliefs/{quote('robot/none', safe='')}", 404), ("beliefs/robot%2F", 404)):
            answer = client.get(f"{session}/{path}")
            outcome.answered(f"GET {path}", answer, {expected})
            outcome.expect("nothing is at" not in answer.text, f"GET {path} is not understood: {answer.text[:120]}")
        plain = client.get(f"{session}/beliefs/{DRAWER}")
        outcome.happened.append(f"GET beliefs/{DRAWER} with the slash as it is: {plain.status_code}")
        _long_names(target, outcome, client)


def _is_of(outcome: Outcome, path: str, answer: httpx.Response) -> None:
    """Where JSON names the link, it is the one that was asked for."""
    if answer.status_code == 200 and "json" in answer.headers["content-type"]:
        link = answer.json().get("link", DRAWER)
        outcome.expect(link in (BASE, DRAWER), f"GET {path} answers for link {link!r}")


def _long_names(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    long = "n" * (1 << 20)
    for what, text in {
        "link": entries.URDF.replace('"drawer1"', f'"{long}"'),
        "joint": entries.URDF.replace('"slide1"', f'"{long}"'),
        "robot": entries.URDF.replace('"cabinet"', f'"{long}"'),
    }.items():
        answer = entries.upload_model(client, text)
        outcome.answered(f"a {what}'s name of 1 MB", answer, {422})
        outcome.expect(
            len(answer.content) < 10_000, f"a {what}'s name of 1 MB: the answer is {len(answer.content)} bytes"
        )
        target.keep("models", answer)
    outcome.answered("GET /models afterwards", client.get("/api/v1/models"), {200})
