"""Results over REST: they are `pmpnbp estimate`'s number for number, at any iteration and in every form."""

from __future__ import annotations

import io
import json
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app import cli
from app.schemas_results import BeliefParticles, Decision, Estimate, MessageParticles, PosteriorDraws, Trace, TraceRow
from pmpnbp.geometry import poses
from pmpnbp.json_text import json_bytes
from pmpnbp.readout import particle_statistics
from pmpnbp.recording import Recording
from tests.app import small_sessions as small

LINKS = ["frame", "drawer1", "handle1", "drawer2", "handle2", "drawer3", "handle3"]


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    """A session at iteration 6, whose truth is known."""
    truth = json.loads((small.CABINET / "open" / "truth.json").read_text())
    made = small.after(client, 6, truth={name: truth[name] for name in ("links", "joints")}, name="a cabinet/open")
    return made


def problem(answer: httpx.Response, status: int, text: str) -> None:
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json"), answer.text
    assert text in answer.json()["detail"]


@pytest.mark.parametrize("prior", [None, "prior.json"])
def test_a_session_equals_the_command_line(client: httpx.Client, tmp_path: Path, prior: str | None) -> None:
    """Number for number, every iteration of the recording too; `seconds` excepted."""
    scene = small.CABINET / "open"
    options = [f"--config={name}={value}" for name, value in small.QUICK.items()]
    options += [] if prior is None else ["--prior", str(scene / prior)]
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
    known = None if prior is None else json.loads((scene / prior).read_text())
    path = small.create(client, prior=known)
    client.post(f"{path}/run", json={"iterations": 60, "until": "converged"})
    small.at_rest(client, path)
    expected = json.loads((tmp_path / "result.json").read_text())
    del expected["seconds"]
    assert small.numbers(client, path) == expected
    (tmp_path / "session.sqlite").write_bytes(client.get(f"{path}/recording").content)
    with Recording(tmp_path / "command.sqlite") as one, Recording(tmp_path / "session.sqlite") as other:
        assert one.iterations() == other.iterations()
        for number in one.iterations():
            mine, theirs = one.report(number), other.report(number)
            assert mine.belief.poses.tobytes() == theirs.belief.poses.tobytes()
            assert mine.belief.log_weights.tobytes() == theirs.belief.log_weights.tobytes()
            assert mine.map_poses.tobytes() == theirs.map_poses.tobytes()


def test_an_estimate_is_what_its_description_says(client: httpx.Client, path: str) -> None:
    answer = client.get(f"{path}/estimate")
    Estimate.model_validate_json(answer.content)
    found = answer.json()
    assert found["session_id"] == path.rpartition("/")[2] and found["state"] == "paused"
    assert list(found["links"]) == LINKS and found["schema"] == "pmpnbp/estimate-2"


def test_an_older_estimate_is_told_as_it_was_when_it_was_new(client: httpx.Client) -> None:
    path = small.create(client)
    told = [client.get(f"{path}/estimate").content]
    for _ in range(4):
        small.step(client, path)
        told.append(client.get(f"{path}/estimate").content)
    assert [client.get(f"{path}/estimate?iteration={number}").content for number in range(5)] == told
    problem(client.get(f"{path}/estimate?iteration=5"), 404, "iteration 5 of session")
    problem(client.get(f"{path}/estimate?iteration=5"), 404, "is not here; it has 0 to 4")
    problem(client.get(f"{path}/estimate?iteration=-1"), 422, "iteration in the query")


def test_wait_answers_when_it_is_so(client: httpx.Client) -> None:
    path = small.create(client)
    client.post(f"{path}/run", json={"iterations": 5000, "until": "converged"})
    found = client.get(f"{path}/estimate?wait=converged&timeout=600").json()
    assert found["converged"]
    found = client.get(f"{path}/estimate?wait=idle&timeout=600").json()
    assert found["state"] == "paused" and found["converged"]
    # nothing iterates: what it is not yet it will never be, and nobody waits for it
    certain = found["certain"]
    assert client.get(f"{path}/estimate?wait=certain&timeout=600").json()["certain"] == certain


def test_wait_ends_with_its_time_or_with_a_pause(shared: Any, client: httpx.Client) -> None:
    path = small.create(client)
    client.post(f"{path}/run", json={"iterations": 100_000})
    began = time.monotonic()
    assert client.get(f"{path}/estimate?wait=idle&timeout=0.3").json()["state"] == "running"
    assert time.monotonic() - began >= 0.3
    pause = threading.Timer(0.3, lambda: httpx.post(f"{shared.url}{path}/pause", timeout=None))
    pause.start()
    assert client.get(f"{path}/estimate?wait=idle&timeout=600").json()["state"] == "paused"
    pause.join()


def test_a_session_that_is_deleted_while_it_is_waited_for_is_not_there(shared: Any, client: httpx.Client) -> None:
    path = small.create(client)
    client.post(f"{path}/run", json={"iterations": 100_000})
    delete = threading.Timer(0.3, lambda: httpx.delete(f"{shared.url}{path}", timeout=None))
    delete.start()
    answer = client.get(f"{path}/estimate?wait=idle&timeout=600")
    delete.join()
    assert answer.status_code == 404 and "was deleted while" in answer.json()["detail"]


def test_a_belief_is_what_the_estimate_is_read_from(client: httpx.Client, path: str) -> None:
    """The particles' spread in the estimate follows from the particles and weights."""
    estimate = client.get(f"{path}/estimate").json()
    for link in LINKS:
        answer = client.get(f"{path}/beliefs/{link}")
        BeliefParticles.model_validate_json(answer.content)
        found = answer.json()
        assert (found["link"], found["iteration"], found["frame_id"]) == (link, 6, "world")
        assert found["part"] == link.replace("handle", "drawer")
        particles = np.array(found["particles"])
        weights = np.exp(np.array([-np.inf if one is None else one for one in found["log_weights"]]))
        assert particles.shape == (40, 7) and weights.sum() == pytest.approx(1)
        pose = estimate["links"][link]["pose"]
        middle = np.array([*(pose["position"][n] for n in "xyz"), *(pose["orientation"][n] for n in "wxyz")])
        spread = particle_statistics.std_xyz(particle_statistics.covariance(middle, particles, weights))
        np.testing.assert_allclose(spread, estimate["links"][link]["particle_std_xyz"], atol=1e-9)


@pytest.mark.parametrize("place", ["beliefs/handle1", "messages/frame/handle1"])
def test_particles_are_the_same_in_every_form(client: httpx.Client, path: str, place: str) -> None:
    told = client.get(f"{path}/{place}?iteration=5").json()
    particles = np.array(told["particles"])
    npz = client.get(f"{path}/{place}?iteration=5&format=npz")
    with np.load(io.BytesIO(npz.content)) as file:
        assert file["particles"].tobytes() == particles.tobytes()
        weights = file["log_weights"]
        assert [None if one == -np.inf else one for one in weights.tolist()] == told["log_weights"]
        assert (file["frame_id"], file["iteration"]) == ("world", 5)
    ply = client.get(f"{path}/{place}?iteration=5&format=ply")
    assert ".ply" in ply.headers["content-disposition"]
    header, _, data = ply.content.partition(b"end_header\n")
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property double ")]
    assert f"element vertex {len(particles)}".encode() in header
    table = np.frombuffer(data, "<f8").reshape(-1, len(names))
    assert names[:8] == ["x", "y", "z", "qw", "qx", "qy", "qz", "log_weights"]
    assert table[:, :7].tobytes() == particles.tobytes() and table[:, 7].tobytes() == weights.tobytes()
    problem(client.get(f"{path}/{place}?format=xml"), 422, "format in the query")


def test_a_message_is_the_recordings(client: httpx.Client, path: str, tmp_path: Path) -> None:
    """Poses of the receiver's part, carried to the link that was named."""
    (tmp_path / "run.sqlite").write_bytes(client.get(f"{path}/recording").content)
    with Recording(tmp_path / "run.sqlite") as recording:
        messages, model = recording.report(6).messages, recording.problem(6).mrf.model
    assert messages is not None
    names = [part.name for part in model.parts]
    for sender, receiver in (("handle2", "frame"), ("frame", "handle2")):
        answer = client.get(f"{path}/messages/{sender}/{receiver}")
        MessageParticles.model_validate_json(answer.content)
        found = answer.json()
        ends = (names.index(found["from"]), names.index(found["to"]))
        (number,) = np.flatnonzero((messages.sender == ends[0]) & (messages.receiver == ends[1]))
        part = model.parts[ends[1]]
        expected = poses.multiply(messages.poses[number], part.poses_part_link[part.links.index(receiver)])
        np.testing.assert_array_equal(found["particles"], expected)
        assert found["link"] == receiver and len(found["log_neighbour"]) == 40


def test_what_is_not_there_is_named(client: httpx.Client, path: str) -> None:
    problem(client.get(f"{path}/beliefs/door"), 404, "link 'door' is not in the model; it has frame, drawer1")
    problem(client.get(f"{path}/beliefs/frame?iteration=9"), 404, "it has 0 to 6")
    problem(
        client.get(f"{path}/messages/drawer1/drawer2"), 404, "no message goes from 'drawer1' to 'drawer2'; there are"
    )
    problem(client.get(f"{path}/messages/door/frame"), 404, "link 'door' is not in the model")
    problem(client.get(f"{path}/messages/frame/drawer1?iteration=1"), 404, "iteration 1 (search) has no messages")
    problem(client.get(f"{path}/decision?links=frame,door"), 404, "link 'door' is not in the model")


def test_the_trace_tells_each_iteration(client: httpx.Client, path: str) -> None:
    answer = client.get(f"{path}/trace")
    Trace.model_validate_json(answer.content)
    rows = answer.json()["iterations"]
    assert [row["iteration"] for row in rows] == [0, 1, 2, 3, 4, 5, 6]
    assert [row["stage"] for row in rows][:4] == ["start", "search", "search", "belief propagation"]
    assert [row["phase"] for row in rows] == ["searching"] * 3 + ["settling"] * 4
    assert rows[0]["log_likelihood"] is None  # the start has none; NaN would be no JSON
    estimate = client.get(f"{path}/estimate").json()
    assert rows[6]["particle_std_xyz"] == {link: estimate["links"][link]["particle_std_xyz"] for link in LINKS}
    # not at rest: there is no posterior yet
    assert [rows[6][name] for name in ("std_xyz", "fit", "posterior_iteration", "certain")] == [None, None, None, False]
    assert rows[1]["certain_by_link"] is rows[6]["certain_by_link"] is None
    assert rows[6]["add"] == {name: part["add"] for name, part in estimate["truth"]["parts"].items()}
    assert set(rows[6]["effective_sample_size"]) == set(rows[6]["add"])
    assert [row["elapsed"] for row in rows] == sorted(row["elapsed"] for row in rows)
    for asked, iterations in {
        "after=4": [5, 6],
        "after=1&last=3": [2, 3],
        "last=0": [0],
        "limit=7": [0, 1, 2, 3, 4, 5, 6],
        "limit=3": [0, 3, 6],
        "limit=4": [0, 2, 4, 6],
        "limit=5": [0, 2, 4, 6],
        "limit=1": [6],
        "after=1&limit=2": [3, 6],
    }.items():
        found = client.get(f"{path}/trace?{asked}").json()["iterations"]
        assert found == [rows[iteration] for iteration in iterations], asked


@pytest.fixture(scope="module")
def rested(client: httpx.Client) -> str:
    """A session at rest, whose settings are those of a user: its estimate is one to act on."""
    path = small.create(client, config={"search_iterations": 4, "search_proposals": 1500, "search_islands": 10})
    client.post(f"{path}/run", json={"iterations": 100, "until": "converged"})
    found = small.at_rest(client, path)
    assert found["converged"] and found["fit"] == "good", found
    return path


def test_at_rest_the_estimate_tells_the_posterior_and_the_row_the_same(client: httpx.Client, rested: str) -> None:
    answer = client.get(f"{rested}/estimate")
    Estimate.model_validate_json(answer.content)
    found, state = answer.json(), client.get(rested).json()
    (*_, row) = client.get(f"{rested}/trace").json()["iterations"]
    TraceRow.model_validate(row)
    assert (found["fit"], found["fit_reason"]) == (row["fit"], row["fit_reason"]) == (state["fit"], state["fit_reason"])
    assert found["posterior_iteration"] == row["posterior_iteration"] == row["iteration"]
    assert row["std_xyz"] == {link: found["links"][link]["std_xyz"] for link in LINKS}
    assert found["certain"] == row["certain"] == state["certain"]
    assert row["certain_by_link"] == {link: found["links"][link]["certain"] for link in LINKS}
    for joint in found["joints"].values():
        low, high = joint["interval"]
        assert joint["lower"] <= low <= joint["position"] + 3 * joint["std"] and high <= joint["upper"]


def test_the_posterior_stays_while_the_estimate_does(client: httpx.Client, rested: str) -> None:
    """Iterations at rest are told with the one that was read out first; also when they are looked at again."""
    first = client.get(f"{rested}/estimate").json()
    small.step(client, rested, 2)
    after = client.get(f"{rested}/estimate").json()
    assert after["iteration"] == first["iteration"] + 2 and after["converged"]
    rows = client.get(f"{rested}/trace").json()["iterations"]
    told = rows[-1]["posterior_iteration"]
    assert told is not None and told <= after["iteration"] and after["posterior_iteration"] == told
    again = client.get(f"{rested}/estimate?iteration={after['iteration'] - 1}").json()
    assert again["posterior_iteration"] == rows[-2]["posterior_iteration"]
    assert rows[-2]["std_xyz"] == {link: again["links"][link]["std_xyz"] for link in LINKS}


def test_a_run_that_ends_before_anything_is_at_rest_tells_whether_the_object_was_found(client: httpx.Client) -> None:
    path = small.create(client)
    client.post(f"{path}/run", json={"iterations": 4}).raise_for_status()
    assert not small.at_rest(client, path)["converged"]
    found = client.get(f"{path}/estimate").json()
    assert (found["iteration"], found["converged"], found["posterior_iteration"]) == (4, False, 4)
    assert found["fit"] is not None and client.get(path).json()["fit"] == found["fit"]
    # who makes one iteration after the other looks at the algorithm, and may ask for it
    small.step(client, path)
    assert client.get(f"{path}/estimate").json()["fit"] is None
    assert client.get(f"{path}/estimate?posterior=true").json()["fit"] is not None


def test_a_run_until_certain_ends_when_it_is_or_when_it_will_not_be(client: httpx.Client, rested: str) -> None:
    config = {"search_iterations": 4, "search_proposals": 1500, "search_islands": 10}
    for limit, certain in ((1.0, True), (1e-6, False)):
        path = small.create(client, config=config, max_std=limit)
        client.post(f"{path}/run", json={"iterations": 5000, "until": "certain"})
        found = small.at_rest(client, path)
        assert found["converged"] and found["certain"] == certain and found["iteration"] < 200


def test_a_posterior_is_read_out_where_it_is_asked_for(client: httpx.Client, path: str) -> None:
    plain = client.get(f"{path}/estimate").json()
    asked = client.get(f"{path}/estimate?posterior=true").json()
    assert plain["fit"] is None and asked["fit"] is not None and asked["posterior_iteration"] == 6
    assert all(len(link["std_xyz"]) == 3 for link in asked["links"].values())
    assert asked == client.get(f"{path}/estimate?posterior=true").json()
    searching = client.get(f"{path}/estimate?iteration=1&posterior=true").json()
    assert searching["fit"] is None and searching["links"]["frame"]["std_xyz"] is None


def test_draws_of_the_posterior_are_those_that_the_estimate_tells_of(client: httpx.Client, rested: str) -> None:
    estimate = client.get(f"{rested}/estimate").json()
    for link in ("frame", "handle2"):
        answer = client.get(f"{rested}/posterior/{link}")
        PosteriorDraws.model_validate_json(answer.content)
        found = answer.json()
        assert found["posterior_iteration"] == estimate["posterior_iteration"] and found["link"] == link
        draws, weights = np.array(found["particles"]), np.exp(np.array(found["log_weights"], dtype=float))
        told = estimate["links"][link]
        middle = np.array(
            [*(told["pose"]["position"][n] for n in "xyz"), *(told["pose"]["orientation"][n] for n in "wxyz")]
        )
        covariance = particle_statistics.covariance(middle, draws, np.nan_to_num(weights))
        np.testing.assert_allclose(covariance.ravel(), told["covariance"], atol=1e-12)
        shares = np.bincount(found["mode"], np.nan_to_num(weights))
        assert shares == pytest.approx([other["weight"] for other in estimate["alternatives"]])
    file = client.get(f"{rested}/posterior/frame?format=npz")
    with np.load(io.BytesIO(file.content)) as arrays:
        assert {"particles", "log_weights", "mode", "posterior_iteration"} <= set(arrays.files)
    assert client.get(f"{rested}/posterior/frame?format=ply").content.startswith(b"ply")
    problem(client.get(f"{rested}/posterior/frame?iteration=1"), 404, "iteration 1 (search) has no posterior")
    problem(client.get(f"{rested}/posterior/door"), 404, "link 'door' is not in the model")


def test_the_decision_is_to_act_where_all_asked_links_are_certain(client: httpx.Client, rested: str) -> None:
    links = client.get(f"{rested}/estimate").json()["links"]
    worst = {name: max(*link["std_xyz"], link["expected_add"]) for name, link in links.items()}
    ordered = sorted(worst, key=lambda name: worst[name])
    limit = worst[ordered[3]]
    found = client.get(f"{rested}/decision?max_std={limit}").json()
    Decision.model_validate(found)
    assert (found["action"], found["certain"], len(found["views"])) == ("look", False, 6)
    assert set(found["blocking"]) == {name for name in worst if worst[name] > limit} != set()
    for view in found["views"]:
        assert set(view["expected_std_xyz"]) == set(found["blocking"]) and view["expected_gain_nats"] >= 0
    assert found["reason"].startswith(found["blocking"][0]) and "may be off by more than" in found["reason"]
    asked = ",".join(ordered[:2])
    found = client.get(f"{rested}/decision?links={asked}&max_std={limit}").json()
    assert (found["action"], found["certain"], found["blocking"], found["links"]) == ("act", True, [], ordered[:2])
    assert "the scan confirms" in found["reason"] and found["views"] == []
    assert client.get(f"{rested}/decision").json()["max_std"] == 0.0025


def test_a_planner_s_own_views_are_ranked_by_what_they_tell_over_their_cost(client: httpx.Client, rested: str) -> None:
    narrow = client.get(f"{rested}/decision?max_std=1e-6").json()
    assert narrow["reason"].endswith("may be off by more than 0.001 mm, or turned by more than 0.0008°")
    offered = narrow["views"]
    turned_away = json.loads(json.dumps(offered[0]["pose"]))
    turned_away["position"]["z"] += 30.0  # nothing of the object is in sight
    dear = {"pose": offered[0]["pose"], "cost": 1000.0}
    body = {
        "links": ["drawer1", "frame"],
        "max_std": 1e-6,
        "views": [{"pose": turned_away}, {"pose": offered[0]["pose"]}],
    }
    found = client.post(f"{rested}/decision", json=body).json()
    Decision.model_validate(found)
    assert found["action"] == "look" and found["links"] == ["drawer1", "frame"] and len(found["views"]) == 2
    best, worst = found["views"]
    assert best["pose"]["position"]["z"] < worst["pose"]["position"]["z"]
    assert worst["expected_gain_nats"] == pytest.approx(0.0, abs=1e-9)
    assert client.post(f"{rested}/decision", json={"views": [dear]}).json()["views"][0]["cost"] == 1000.0
    # where to look is told although there is nothing to look for, when it was asked
    assert client.post(f"{rested}/decision", json={"max_std": 1000, "views": [dear]}).json()["action"] == "act"


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ({"links": ["door"]}, "link 'door' is not in the model"),
        ({"links": []}, "links"),
        ({"max_std": 0}, "max_std"),
        ({"views": []}, "views"),
        ({"views": [{"pose": {}}]}, "position"),
        (
            {
                "views": [
                    {"pose": {"position": {"x": 0, "y": 0, "z": 1e9}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}
                ]
            },
            "z",
        ),
        (
            {
                "views": [
                    {"pose": {"position": {"x": 0, "y": 0, "z": 1}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 0.5}}}
                ]
            },
            "a view's orientation has length 0.5; expected a unit quaternion x, y, z, w",
        ),
    ],
)
def test_what_is_no_decision_to_make_is_told(
    client: httpx.Client, rested: str, body: dict[str, Any], text: str
) -> None:
    answer = client.post(f"{rested}/decision", json=body)
    problem(answer, 404 if body.get("links") == ["door"] else 422, text)


def test_during_the_search_the_decision_is_to_look(client: httpx.Client) -> None:
    path = small.after(client, 1)
    found = client.get(f"{path}/decision?max_std=1000").json()
    Decision.model_validate(found)
    assert (found["action"], found["certain"]) == ("look", False) and "is of the search" in found["reason"]


def test_where_the_object_is_not_the_decision_says_so(client: httpx.Client) -> None:
    """The region holds a corner of the cabinet: what is laid onto it is not the object."""
    x0, y0, z0, x1, y1, _ = small.ROI
    path = small.create(client, roi=[x0, y0, z0, x1, (y0 + y1) / 2 - 0.1, z0 + 0.25])
    client.post(f"{path}/run", json={"iterations": 40, "until": "converged"})
    small.at_rest(client, path)
    told = client.get(f"{path}/estimate?posterior=true").json()
    assert told["fit"] != "good" and not told["certain"]
    found = client.get(f"{path}/decision?max_std=1000").json()
    assert (found["action"], found["reason"]) == ("no_fit", told["fit_reason"])


def test_the_recording_is_one_file_also_while_it_is_written(client: httpx.Client, tmp_path: Path) -> None:
    path = small.create(client, name="../a kitchen")
    client.post(f"{path}/run", json={"iterations": 100_000})
    while client.get(path).json()["iteration"] < 8:
        time.sleep(small.PATIENCE)
    answer = client.get(f"{path}/recording")
    client.post(f"{path}/pause")
    assert answer.headers["content-type"] == "application/vnd.sqlite3"
    assert 'filename="a_kitchen.sqlite"' in answer.headers["content-disposition"]
    (tmp_path / "run.sqlite").write_bytes(answer.content)
    with Recording(tmp_path / "run.sqlite") as recording:
        there = recording.iterations()
        assert recording.sound() and there == [*range(there[-1] + 1)] and there[-1] >= 8
        recording.state(there[-1])


def test_no_copy_of_a_recording_stays(shared: Any, path: str) -> None:
    before = [*(shared.config.data_dir / "incoming").iterdir()]
    assert len(shared.client.get(f"{path}/recording").content) > 10_000
    assert [*(shared.config.data_dir / "incoming").iterdir()] == before


def test_what_json_does_not_have_becomes_null() -> None:
    told = {"a": float("nan"), "b": [1.5, float("-inf")], "c": {"d": (float("inf"), "ü")}}
    assert json.loads(json_bytes(told)) == {"a": None, "b": [1.5, None], "c": {"d": [None, "ü"]}}


def test_a_result_is_made_ahead_only_for_those_who_ask_again(shared: Any) -> None:
    path = small.after(shared.client, 1)
    archive = shared.app.state.sessions.get(path.rpartition("/")[2]).archive
    assert archive.present.known_text is None
    assert shared.client.get(f"{path}/estimate").status_code == 200
    small.step(shared.client, path)
    assert archive.present.known_text is not None  # who asks again does not wait
    small.step(shared.client, path)
    assert archive.present.known_text is None  # nobody has asked again
