"""An uploaded recording answers as the session did that it came from, and only that: it cannot be made to iterate."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app import cli
from app.schemas import Session
from app.schemas_results import Trace
from pmpnbp.errors import RecordingError
from pmpnbp.recording import Recording
from tests.app import small_sessions as small

READS = (
    "graph",
    "trace",
    "decision",
    "decision?max_std=0.001",
    "beliefs/handle1",
    "beliefs/frame?format=npz&iteration=3",
    "messages/frame/drawer1",
    "beliefs/drawer1/marginals?iteration=4",
    "beliefs/drawer1/particles",
    "beliefs/drawer1/particles/3",
    "beliefs/drawer1/particles/3/picture.png",
    "estimate",
    "estimate?iteration=2",
)


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    """A session at iteration 8, to which settings and a view were added on the way."""
    # the view is of another scene: told to mind, the session would begin its search again
    made = small.after(client, 4, name="kitchen", config=small.QUICK | {"view_explained": 0}, max_std=0.02)
    assert client.patch(made, json={"config": {"effective_share": 0.2}}).status_code == 200
    small.step(client, made, 2)
    view = small.upload_scan(client, "second_view")
    assert client.post(f"{made}/scans", json={"scan_id": view}).status_code == 200
    small.step(client, made, 2)
    return made


@pytest.fixture(scope="module")
def content(client: httpx.Client, path: str) -> bytes:
    return client.get(f"{path}/recording").content


@pytest.fixture(scope="module")
def recorded(client: httpx.Client, content: bytes) -> str:
    return upload(client, content)


def upload(client: httpx.Client, content: bytes, name: str = "kitchen.sqlite") -> str:
    answer = client.post("/api/v1/recordings", files={"file": (name, content)})
    assert answer.status_code == 201, answer.text
    return f"/api/v1/sessions/{answer.json()['id']}"


def altered(content: bytes, path: Path, script: str) -> bytes:
    path.write_bytes(content)
    connection = sqlite3.connect(path)
    connection.executescript(script)
    connection.close()
    return path.read_bytes()


def plain(value: Any) -> Any:
    """Without what tells one from the other: ids, states, and the numbers of events."""
    if isinstance(value, dict):
        own = ("session_id", "state", "event", "changes")
        return {name: plain(member) for name, member in value.items() if name not in own}
    return [plain(member) for member in value] if isinstance(value, list) else value


def problem(answer: httpx.Response, status: int, text: str) -> None:
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json"), answer.text
    assert text in answer.json()["detail"]


@pytest.mark.parametrize("call", READS)
def test_it_reads_as_its_session(client: httpx.Client, path: str, recorded: str, call: str) -> None:
    one, other = client.get(f"{path}/{call}"), client.get(f"{recorded}/{call}")
    assert (one.status_code, other.status_code) == (200, 200), other.text
    if one.headers["content-type"] == "application/json":
        assert plain(one.json()) == plain(other.json())
        assert other.json()["session_id"] == recorded.rpartition("/")[2]
    elif "npz" not in call:  # which names its session
        assert one.content == other.content


def test_it_says_that_it_is_a_recording(client: httpx.Client, path: str, recorded: str) -> None:
    answer = client.get(recorded)
    Session.model_validate_json(answer.content)
    found, session = answer.json(), client.get(path).json()
    assert (found["kind"], found["state"], found["name"]) == ("recording", "recorded", "kitchen")
    assert session["kind"] == "session"
    for name in ("iteration", "method", "particles", "seed", "roi", "max_std", "converged", "certain"):
        assert found[name] == session[name], name
    assert found["prior"] == {"kind": "uniform", "orientation": "upright"}
    assert found["view_url"] == f"/sessions/{found['id']}/"
    assert found["config"]["effective_share"] == 0.2
    assert found["id"] not in [session["id"] for session in client.get("/api/v1/sessions").json()]


def test_changes_are_told(client: httpx.Client, path: str, recorded: str) -> None:
    answer = client.get(f"{recorded}/trace")
    Trace.model_validate_json(answer.content)
    told = client.get(f"{path}/trace").json()["changes"]
    assert told[0] == {"after_iteration": 4, "config": {"effective_share": 0.2}}
    assert (told[1]["after_iteration"], len(told[1]["scan_id"])) == (6, 16)
    assert answer.json()["changes"] == [told[0], {"after_iteration": 6, "scan_id": "view 1", "mode": "joins"}]
    rows = client.get(f"{recorded}/trace?after=6").json()["iterations"]
    assert rows == answer.json()["iterations"][7:] and [row["iteration"] for row in rows] == [7, 8]


def test_the_estimate_is_drawn(client: httpx.Client, path: str, recorded: str) -> None:
    for query in ("", "?view=1", "?iteration=2&width=200"):
        one, other = (client.get(f"{place}/estimate.png{query}") for place in (path, recorded))
        if one.status_code == 503:
            pytest.skip(one.json()["detail"])
        assert other.content == one.content
    problem(client.get(f"{recorded}/estimate.png?view=2"), 404, "view 2 of recording")


def test_a_scene_that_changed_is_told_as_it_was(client: httpx.Client) -> None:
    """What was seen first is shown with the iterations that saw it, in the session and in its recording."""
    path, later = small.after(client, 4), small.upload_scan(client, "second_view")
    before = client.get(f"{path}/estimate.png?iteration=2&width=100")
    assert client.post(f"{path}/scans", json={"scan_id": later, "mode": "replaces"}).status_code == 200
    small.step(client, path, 2)
    recorded = upload(client, client.get(f"{path}/recording").content)
    assert client.get(f"{recorded}/trace").json()["changes"] == [
        {"after_iteration": 4, "scan_id": "view 1", "mode": "replaces"}
    ]
    for call in ("estimate?iteration=3", "estimate", "graph", "beliefs/drawer1/particles"):
        assert plain(client.get(f"{recorded}/{call}").json()) == plain(client.get(f"{path}/{call}").json())
    assert client.get(f"{recorded}/graph").json()["views"] == 1
    if before.status_code == 503:
        pytest.skip(before.json()["detail"])
    pictures = [client.get(f"{place}/estimate.png?iteration=2&width=100").content for place in (path, recorded)]
    assert pictures == [before.content] * 2
    newest = [client.get(f"{place}/estimate.png?iteration=6&width=100").content for place in (path, recorded)]
    assert newest[0] == newest[1] != before.content


def test_it_cannot_be_told_to_do_anything(client: httpx.Client, recorded: str) -> None:
    id = recorded.rpartition("/")[2]
    for method, place, body in (
        ("POST", "/run", {}),
        ("POST", "/step", {}),
        ("POST", "/pause", None),
        ("POST", "/reset", None),
        ("PATCH", "", {"config": {}}),
        ("POST", "/scans", {"scan_id": "0123456789abcdef"}),
        ("DELETE", "", None),
    ):
        answer = client.request(method, recorded + place, json=body)
        problem(answer, 409, f"'{id}' is a recording; it cannot iterate; create a session from its model and scans")
    assert client.get(recorded).status_code == 200


def test_its_file_stays_as_it_came(client: httpx.Client, content: bytes, recorded: str) -> None:
    digest = hashlib.sha256(content).hexdigest()
    answer = client.get(f"{recorded}/recording")
    assert 'filename="kitchen.sqlite"' in answer.headers["content-disposition"]
    assert hashlib.sha256(answer.content).hexdigest() == digest
    kept = client.get(f"/api/v1/recordings/{recorded.rpartition('/')[2]}/file")
    assert hashlib.sha256(kept.content).hexdigest() == digest


def test_events_tell_how_it_ends_and_its_new_name_until_it_is_deleted(client: httpx.Client, content: bytes) -> None:
    path = upload(client, content)
    entry = path.replace("sessions", "recordings")
    with client.stream("GET", f"{path}/events") as answer:
        lines = answer.iter_lines()
        told: dict[str, Any] = {}
        while len(told) < 2:
            line = next(lines)
            if line.startswith("event: "):
                told[line.removeprefix("event: ")] = json.loads(next(lines).removeprefix("data: "))
        assert told["iteration"]["iteration"] == 8
        assert (told["state"]["state"], told["state"]["iteration"]) == ("recorded", 8)
        assert client.patch(entry, json={"name": "top drawer"}).status_code == 200
        assert "event: state" in lines
        assert json.loads(next(lines).removeprefix("data: ")) == told["state"] | {"name": "top drawer"}
        assert client.delete(entry).status_code == 204
        assert [line for line in lines if line.startswith("event: ")] == []
    problem(client.get(path), 404, "is not here")


def test_waiting_for_it_ends_at_once(client: httpx.Client, recorded: str) -> None:
    found = client.get(f"{recorded}/estimate?wait=certain&timeout=600").json()
    assert (found["state"], found["iteration"]) == ("recorded", 8)


def test_it_is_there_after_a_restart(serve: Callable[..., Any], content: bytes) -> None:
    first = serve()
    path = upload(first.client, content)
    told = first.client.get(f"{path}/trace").json()
    first.app.state.sessions.close()
    first.app.state.store.close()
    assert serve().client.get(f"{path}/trace").json() == told


# Recordings that no session made


def test_rows_that_the_command_line_did_not_write_are_made(client: httpx.Client, tmp_path: Path) -> None:
    """Equal to those of a session that made the same iterations, but for what time it took."""
    scene = small.CABINET / "open"
    options = [f"--config={name}={value}" for name, value in small.QUICK.items()]
    status = cli.main(
        [
            "estimate",
            str(small.CABINET / "cabinet.urdf"),
            str(scene / "depth.png"),
            "--camera",
            str(scene / "camera.json"),
            f"--roi={','.join(str(number) for number in small.ROI)}",
            "--particles",
            "40",
            "--seed",
            "11",
            "--iterations",
            "60",
            "--quiet",
            *options,
            "--out",
            str(tmp_path / "result.json"),
            "--recording",
            str(tmp_path / "command.sqlite"),
        ]
    )
    assert status == 0
    recorded = upload(client, (tmp_path / "command.sqlite").read_bytes())
    path = small.create(client)
    client.post(f"{path}/run", json={"iterations": 60, "until": "converged"})
    small.at_rest(client, path)
    mine, theirs = (client.get(f"{place}/trace").json()["iterations"] for place in (recorded, path))
    timed = ("seconds", "elapsed", "event")
    assert [{k: v for k, v in row.items() if k not in timed} for row in mine] == [
        {k: v for k, v in row.items() if k not in timed} for row in theirs
    ]
    assert mine[-1]["converged"] and not mine[-2]["converged"]
    assert mine[-1]["elapsed"] == pytest.approx(sum(row["seconds"] for row in mine))
    assert small.numbers(client, recorded) == small.numbers(client, path)
    assert client.get(recorded).json()["converged"]
    assert client.get(f"{recorded}/trace").json()["iterations"] == mine


# Recordings that are damaged


@pytest.mark.parametrize("share", [0.97, 0.9, 0.85])
def test_what_was_cut_short_opens_as_far_as_it_is_whole(client: httpx.Client, share: float) -> None:
    path = small.after(client, 8)
    content = client.get(f"{path}/recording").content
    cut = content[: int(len(content) * share)]
    recorded = upload(client, cut)
    newest = client.get(recorded).json()["iteration"]
    assert 0 <= newest < 8
    rows, whole = (plain(client.get(f"{place}/trace").json()["iterations"]) for place in (recorded, path))
    assert [{**row, "elapsed": 0} for row in rows] == [{**row, "elapsed": 0} for row in whole[: newest + 1]]
    assert small.numbers(client, recorded) == small.numbers(client, path, newest)
    assert client.get(f"{recorded}/beliefs/frame/particles/0").status_code == 200
    assert client.get(f"{recorded}/recording").content == cut
    document = client.get(recorded.replace("sessions", "recordings")).json()
    assert document["notes"] == [f"what comes after iteration {newest} is damaged and is left out"]
    problem(client.get(f"{recorded}/estimate?iteration=8"), 404, f"it has 0 to {newest}")


def test_without_a_scan_that_came_later_it_opens_as_far_as_that(
    client: httpx.Client, path: str, content: bytes, tmp_path: Path
) -> None:
    lost = altered(content, tmp_path / "lost.sqlite", "UPDATE scans SET depth = x'00' WHERE number = 1")
    recorded = upload(client, lost)
    assert client.get(recorded).json()["iteration"] == 6
    assert small.numbers(client, recorded) == small.numbers(client, path, 6)
    found = client.get(f"{recorded}/trace").json()
    assert (len(found["iterations"]), len(found["changes"])) == (7, 1)
    assert client.get(f"{recorded}/graph").json()["views"] == 1


def test_rows_that_are_none_are_made_anew(client: httpx.Client, recorded: str, content: bytes, tmp_path: Path) -> None:
    """Also one that is a row but for a number that JSON cannot send, one that is certain of links without a posterior,
    and the newest. A phase that contradicts its stage is not believed."""
    rows = client.get(f"{recorded}/trace").json()["iterations"]
    endless = json.dumps(rows[7]).replace(f'"seconds": {rows[7]["seconds"]}', '"seconds": 1e999')
    other = json.dumps(rows[6]).replace('"drawer1"', '"door"')
    certain = json.dumps(rows[0] | {"certain_by_link": dict.fromkeys(rows[0]["particle_std_xyz"], True)})
    told = {
        0: certain,
        1: "no JSON",
        2: json.dumps(rows[2] | {"phase": "at rest"}),
        3: "{}",
        4: '{"iteration": 4}',
        5: "[" * 5000,
        6: other,
        7: endless,
        8: "null",
    }
    script = ";".join(f"UPDATE summaries SET text = '{text}' WHERE iteration = {at}" for at, text in told.items())
    found = client.get(f"{upload(client, altered(content, tmp_path / 'a', script))}/trace")
    Trace.model_validate_json(found.content)
    for mine, theirs in zip(found.json()["iterations"], rows, strict=True):
        assert {**mine, "elapsed": 0} == {**theirs, "elapsed": 0}


def test_an_iteration_that_does_not_fit_the_model_is_not_shown(
    client: httpx.Client, content: bytes, tmp_path: Path
) -> None:
    """Whatever shape or number is wrong: a sentence, for that iteration alone."""
    wrong = {
        "belief.poses": np.zeros((2, 40, 7)),
        "belief.log_weights": np.full((4, 40), np.nan),
        "belief.source": np.full((4, 40), 99, dtype=np.uint8),
        "belief.neighbour": np.full((4, 40), 50, dtype=np.int32),
        "mle": np.full((4, 7), np.inf),
        "messages.joint_draw": np.zeros(3),
        "log_message_shares": np.zeros((4, 40, 1)),
    }
    file = tmp_path / "wrong.sqlite"
    file.write_bytes(content)
    connection = sqlite3.connect(file)
    for iteration, (name, array) in enumerate(wrong.items(), start=1):
        planes = np.ascontiguousarray(array).reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
        connection.execute(
            "INSERT OR REPLACE INTO arrays VALUES (?, ?, ?, ?, ?)",
            (iteration, name, array.dtype.str, json.dumps(array.shape), zlib.compress(planes.tobytes())),
        )
    connection.commit()
    connection.close()
    recorded = upload(client, file.read_bytes())
    for call in ("estimate", "beliefs/frame", "beliefs/frame/marginals", "beliefs/frame/particles/0"):
        for iteration in range(1, 8):
            answer = client.get(f"{recorded}/{call}?iteration={iteration}")
            problem(answer, 404, f"iteration {iteration} does not fit the model of its recording")
        assert client.get(f"{recorded}/{call}?iteration=8").status_code == 200


def test_a_file_that_has_gone_bad_says_so(serve: Callable[..., Any], content: bytes) -> None:
    served = serve()
    path = upload(served.client, content)
    id = path.rpartition("/")[2]
    file = served.app.state.store.file("recordings", id)
    file.write_bytes(b"nothing of what was there" * 100)
    found = served.client.get(path)
    Session.model_validate_json(found.content)
    assert (found.json()["state"], found.json()["iteration"]) == ("recorded", None)
    assert "is not a recording" in found.json()["error"]
    for call in ("estimate", "trace", "graph", "estimate.png", "beliefs/frame/particles"):
        problem(served.client.get(f"{path}/{call}"), 409, "only delete helps")
    assert served.client.delete(f"/api/v1/recordings/{id}").status_code == 204


def test_a_recording_whose_parts_are_no_list_is_damaged(content: bytes, tmp_path: Path) -> None:
    for number, value in enumerate(("5", "null", '["a"]', '[{"links": []}]')):
        file = tmp_path / f"{number}.sqlite"
        altered(content, file, f"UPDATE inputs SET value = '{value}' WHERE name = 'parts'")
        with pytest.raises(RecordingError, match="is damaged: its inputs cannot be read"):
            Recording(file)
