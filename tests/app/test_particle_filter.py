"""A session of the particle filter answers every call that one of belief propagation does, but has no messages."""

from __future__ import annotations

import json

import httpx
import pytest

from app.schemas import Session
from app.schemas_particles import ParticleReasons
from app.schemas_results import Trace
from tests.app import small_sessions as small

PRIOR = json.loads((small.CABINET / "open" / "prior.json").read_text())
READS = (
    "graph",
    "trace",
    "decision?max_std=0.001",
    "beliefs/handle1",
    "beliefs/drawer1/marginals",
    "beliefs/drawer1/particles",
    "beliefs/drawer1/particles/3",
    "beliefs/drawer1/particles/3/picture.png",
    "estimate",
    "estimate.png",
)


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    """A session at iteration 5, the first two of them a search."""
    return small.after(client, 5, method="particle_filter", prior=PRIOR)


def test_it_says_by_which_method_it_infers(client: httpx.Client, path: str) -> None:
    answer = client.get(path)
    Session.model_validate_json(answer.content)
    assert answer.json()["method"] == client.get(f"{path}/estimate").json()["method"] == "particle_filter"
    trace = client.get(f"{path}/trace")
    Trace.model_validate_json(trace.content)
    stages = [row["stage"] for row in trace.json()["iterations"]]
    # two iterations of search are asked for, of which a narrow prior leaves one
    assert stages == ["start", "search", *["particle filter"] * 4]


def test_its_recording_answers_as_it_does(client: httpx.Client, path: str) -> None:
    content = client.get(f"{path}/recording").content
    made = client.post("/api/v1/recordings", files={"file": ("run.sqlite", content)})
    assert made.status_code == 201, made.text
    assert made.json()["method"] == "particle_filter"
    recorded = f"/api/v1/sessions/{made.json()['id']}"
    own = ("session_id", "state", "changes")
    for call in READS:
        one, other = client.get(f"{path}/{call}"), client.get(f"{recorded}/{call}")
        assert (one.status_code, other.status_code) == (200, 200), (call, one.text, other.text)
        if one.headers["content-type"] == "application/json":
            mine, theirs = ({k: v for k, v in each.json().items() if k not in own} for each in (one, other))
            if call == "trace":
                for row in (*mine["iterations"], *theirs["iterations"]):
                    row.pop("event")
            assert mine == theirs, call


def test_a_weight_is_the_whole_objects(client: httpx.Client, path: str) -> None:
    """The same terms for every part, the prior on the frame among them; particles know their joints."""
    for index in (0, 17, 39):
        told = []
        for part in ("frame", "drawer1", "handle3"):
            answer = client.get(f"{path}/beliefs/{part}/particles/{index}")
            ParticleReasons.model_validate_json(answer.content)
            found = answer.json()
            shares = found["shares"]
            assert shares["prior"] < 0 and shares["messages"] == {} and found["messages"] == []
            assert found["log_weight"] == pytest.approx(shares["unary"] + shares["prior"] + shares["constant"])
            assert set(found["joint_positions"]) == {"slide1", "slide2", "slide3"}
            assert "in iteration 4, moved by the diffusion" in found["origin"]
            told.append((found["log_weight"], shares, found["joint_positions"], found["ancestor"]))
        assert told[0] == told[1] == told[2]


def test_it_sends_no_messages(client: httpx.Client, path: str) -> None:
    answer = client.get(f"{path}/messages/frame/drawer1")
    assert answer.status_code == 404
    assert "iteration 5 (particle filter) has no messages" in answer.json()["detail"]


def test_reset_it_makes_the_same_numbers_again(client: httpx.Client, path: str) -> None:
    before = small.numbers(client, path)
    assert client.post(f"{path}/reset").json()["iteration"] == 0
    small.step(client, path, 5)
    assert small.numbers(client, path) == before
