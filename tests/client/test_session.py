"""A session on a server: is everything that REST tells of it told in Python, and everything done?"""

from __future__ import annotations

import io
import json
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pmpnbp.client.client import Client
from pmpnbp.client.decisions import Sight, View
from pmpnbp.client.session import RemoteSession
from pmpnbp.errors import EstimateError, PmpnbpError, RecordingError, ServerError, StorageError
from pmpnbp.library.playback import open_recording
from tests.app import small_sessions as small
from tests.app.test_names_in_paths import session as session_of_names
from tests.client.failing_servers import Scripted, refused, told
from tests.servers import Served

STATUS = {"id": "0123456789abcdef", "name": None, "view_url": "/sessions/0123456789abcdef/", "error": None}
POSE = np.array([1.6, 0.2, 0.6, 0.5, -0.5, -0.5, 0.5])


@pytest.fixture
def fresh(client: Client, served: Served) -> RemoteSession:
    """At iteration 0."""
    return client.open_session(small.create(served.client).rsplit("/", 1)[1])


@pytest.fixture(scope="module")
def rested(client: Client, served: Served) -> RemoteSession:
    """One that has come to rest, with a posterior; for tests that read."""
    session = client.open_session(small.create(served.client).rsplit("/", 1)[1])
    session.run(40, until="converged")
    assert session.wait("converged").converged
    return session


def rest(served: Served, session: RemoteSession, path: str) -> Any:
    return served.client.get(f"/api/v1/sessions/{session.id}/{path}").json()


def test_it_runs_and_rests(fresh: RemoteSession) -> None:
    assert fresh.run(3)["iterations"] == 3
    found = fresh.wait("idle")
    assert (found.iteration, fresh.status()["state"], found.converged) == (3, "paused", False)
    assert fresh.step()["iteration"] == 4
    assert fresh.step(2)["iteration"] == 6
    assert fresh.reset()["iteration"] == 0
    anew = fresh.reset(method="particle_filter", particles=50, seed=7)
    assert (anew["method"], anew["particles"], anew["seed"]) == ("particle_filter", 50, 7)
    assert fresh.reset(seed=8)["particles"] == 50
    assert fresh.pause()["state"] == "paused"


def test_what_was_told_before_a_change_says_that_it_is_outdated(fresh: RemoteSession) -> None:
    fresh.step(2)
    before = fresh.estimate()
    fresh.change(effective_share=0.2)
    after = fresh.wait("idle")
    assert (before.outdated, after.outdated, after.iteration) == (False, True, 2)
    assert after.verdict == f"Outdated, scans or settings have changed since: {before.verdict}"
    assert after.summary.endswith("\nNext: let it make more iterations")
    assert before.to_dict() == after.to_dict()
    fresh.step()
    assert not fresh.estimate().outdated and "Outdated" not in fresh.estimate().verdict


def test_it_runs_as_far_as_it_was_made_for(client: Client, fresh: RemoteSession) -> None:
    status = fresh.status()
    session = client.session(status["model_id"], status["scan_ids"], roi=small.ROI, iterations=4, **small.QUICK)
    session.run()
    assert session.wait("idle").iteration == 4


def test_it_is_paused_while_it_runs(fresh: RemoteSession) -> None:
    assert fresh.run(100_000)["state"] in ("running", "waiting")
    with pytest.raises(ServerError, match="pause it first") as caught:
        fresh.step()
    assert caught.value.status == 409
    assert fresh.pause()["state"] == "paused"
    assert fresh.wait("idle").iteration == fresh.status()["iteration"] < 100_000


def test_settings_are_changed(fresh: RemoteSession) -> None:
    assert fresh.change(effective_share=0.2, triangles=50)["config"] == small.QUICK | {
        "effective_share": 0.2,
        "triangles": 50,
    }
    with pytest.raises(ServerError, match="nonsense") as caught:
        fresh.change(nonsense=1)
    assert caught.value.status == 422


def test_it_is_called_by_another_name_and_found_by_its_tags(client: Client, fresh: RemoteSession) -> None:
    assert fresh.name == "cabinet in depth.png"
    assert fresh.rename(" the kitchen's ")["name"] == fresh.name == "the kitchen's"
    assert fresh.tag("kitchen", "to check")["tags"] == ["kitchen", "to check"]
    assert [one.id for one in client.sessions("kitchen", "to check")] == [fresh.id]
    assert client.sessions("kitchen", "elsewhere") == []
    assert fresh.tag()["tags"] == client.sessions("kitchen") == []
    with pytest.raises(ServerError, match="name in the body") as caught:
        fresh.rename("")
    assert caught.value.status == 422


def test_scans_join_and_replace(client: Client, fresh: RemoteSession) -> None:
    folder = small.CABINET / "arm"
    (first,) = fresh.status()["scan_ids"]
    second = client.upload_scan(folder / "depth.png", folder / "camera.json")
    assert fresh.add_scan(second)["scan_ids"] == [first, second.id]
    with pytest.raises(ServerError, match="already") as caught:
        fresh.add_scan(second.id)
    assert caught.value.status == 409
    (third,) = fresh.add_scan(folder / "depth.png", "replaces", camera=folder / "camera.json")["scan_ids"]
    assert third not in (first, second.id)


def test_an_estimate_is_result_json(served: Served, rested: RemoteSession) -> None:
    found, members, own = rested.estimate(), rest(served, rested, "estimate"), ("session_id", "state", "outdated")
    assert found.to_dict() == {name: value for name, value in members.items() if name not in own}
    assert found.fit == "good" and found.joints["slide1"].std is not None
    older = rested.estimate(2)
    assert (older.iteration, older.fit) == (2, None)
    between = next(row["iteration"] for row in rested.trace(2) if row["fit"] is None)
    assert rested.estimate(between).fit is None and rested.estimate(between, posterior=True).fit is not None


def test_an_estimate_is_drawn_as_it_was(rested: RemoteSession) -> None:
    with (
        Image.open(io.BytesIO(rested.estimate().picture(100))) as small_one,
        Image.open(io.BytesIO(rested.picture())) as one,
    ):
        assert (small_one.format, small_one.size, one.size) == ("PNG", (100, 75), (640, 480))
    assert rested.estimate(0).picture(100) == rested.picture(100, iteration=0) != rested.estimate().picture(100)
    assert rested.estimate(0)._repr_html_().startswith("<div><img")
    with pytest.raises(ServerError, match="width") as caught:
        rested.picture(1)
    assert caught.value.status == 422


def test_its_page_is_opened(rested: RemoteSession, served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(shown.append(url)) or len(shown) < 3)
    rested.estimate().show()
    with Client(served.url, "a&b") as known:
        known.open_session(rested.id).show()
    assert shown == [f"{served.url}/sessions/{rested.id}/", f"{served.url}/sessions/{rested.id}/?token=a%26b"]
    with pytest.raises(PmpnbpError, match=f"no browser opens on this machine; the page is at {rested.url}$"):
        rested.show()


def test_a_decision(rested: RemoteSession) -> None:
    found = rested.decision()
    assert (found.action, found.certain, found.blocking, found.views, found.sight) == ("act", True, (), (), {})
    assert found.max_std == 0.0025 and found.iteration == rested.status()["iteration"] and "frame" in found.links
    found = rested.decision("drawer3", 1e-6)
    assert (found.action, found.links, found.blocking) == ("look", ("drawer3",), ("drawer3",))
    assert "drawer3 may be off" in found.reason
    assert isinstance(found.sight["drawer3"], Sight) and 0 < found.sight["drawer3"].seen <= 1
    assert [view.gain for view in found.views] == sorted((view.gain for view in found.views), reverse=True)
    best = found.views[0]
    assert best.pose.shape == (7,) and best.expected_std_xyz["drawer3"].shape == (3,) and best.worthwhile
    assert np.linalg.norm(best.pose[3:]) == pytest.approx(1)
    older = rested.decision("drawer3", views=[POSE], iteration=1)
    assert (older.iteration, older.action) == (1, "look") and "iteration 1 is of the search" in older.reason


def test_a_planners_own_views_are_ranked(served: Served, rested: RemoteSession) -> None:
    other = np.array([0.2, 1.6, 0.6, 0, 0, -(0.5**0.5), 0.5**0.5])
    members = {"position": {"x": 1.6, "y": 0.2, "z": 0.6}, "orientation": {"w": 0.5, "x": -0.5, "y": -0.5, "z": 0.5}}
    asked = {"links": ["drawer3", "drawer1"], "max_std": 1e-6, "views": [{"pose": members, "cost": 2.0}]}
    answer = served.client.post(f"/api/v1/sessions/{rested.id}/decision", json=asked).json()["views"]
    (view,) = rested.decision(["drawer3", "drawer1"], 1e-6, [(POSE, 2.0)]).views
    assert (view.cost, view.gain) == (2.0, answer[0]["expected_gain_nats"])
    np.testing.assert_allclose(view.pose, POSE, atol=1e-12)
    assert {name: std.tolist() for name, std in view.expected_std_xyz.items()} == answer[0]["expected_std_xyz"]
    for views in (np.array([POSE, other]), [POSE.tolist(), (other, 1.0)], [view, (other, 2.0)]):
        assert len(rested.decision("drawer3", 1e-6, views).views) == 2
    costs = [one.cost for one in rested.decision("drawer3", 1e-6, [POSE, view]).views]
    assert costs == [1.0, 2.0]  # of equal ones the cheaper first
    with pytest.raises(PmpnbpError, match=r"a view has the shape \(3,\); expected a pose \(7,\), or a pair"):
        rested.decision(views=[np.zeros(3)])
    # three links instead of a list of them
    with pytest.raises(PmpnbpError, match="a view is 'd'; expected a pose"):
        rested.decision("drawer1", 1e-6, "drawer2")
    assert isinstance(view, View)


def test_a_decision_is_asked_again_where_its_answer_is_lost(rested: RemoteSession, relay: Any, at_once: None) -> None:
    with Client(relay(0).url) as far:
        session = RemoteSession(far._calls, rested.status())
        assert session.decision().action == "act"


def test_particles(served: Served, rested: RemoteSession) -> None:
    found, members = rested.belief("handle1"), rest(served, rested, "beliefs/handle1")
    assert (found.link, found.part, found.frame_id) == ("handle1", "drawer1", "world")
    assert (found.iteration, found.particles.shape) == (members["iteration"], (40, 7))
    for name in ("particles", "log_weights", "log_unary"):
        np.testing.assert_allclose(getattr(found, name), np.array(members[name], dtype=float), rtol=1e-12)
    assert np.exp(found.log_weights).sum() == pytest.approx(1)
    assert rested.belief("handle1", 0).iteration == 0
    assert "particles" not in repr(found)
    with pytest.raises(ServerError, match="link 'wing' is not in the model; it has frame, drawer1"):
        rested.belief("wing")


def test_messages(served: Served, rested: RemoteSession) -> None:
    found, members = rested.message("frame", "handle1", 4), rest(served, rested, "messages/frame/handle1?iteration=4")
    assert (found.sender, found.receiver, found.link, found.iteration) == ("frame", "drawer1", "handle1", 4)
    for name in ("particles", "log_weights", "log_unary", "log_neighbour"):
        np.testing.assert_allclose(getattr(found, name), np.array(members[name], dtype=float), rtol=1e-12)
    with pytest.raises(ServerError, match="has no messages") as caught:
        rested.message("frame", "drawer1", 0)
    assert caught.value.status == 404


def test_draws_of_the_posterior(served: Served, rested: RemoteSession) -> None:
    found, members = rested.posterior("drawer2"), rest(served, rested, "posterior/drawer2")
    assert (found.link, found.posterior_iteration) == ("drawer2", members["posterior_iteration"])
    for name in ("particles", "log_weights", "mode"):
        np.testing.assert_allclose(getattr(found, name), np.array(members[name], dtype=float), rtol=1e-12)
    assert found.particles.shape == (*found.mode.shape, 7) and found.mode.dtype == np.int64
    with pytest.raises(ServerError, match="has no posterior"):
        rested.posterior("drawer2", 1)


def test_draws_for_arviz_are_those_of_the_recording(rested: RemoteSession, tmp_path: Path) -> None:
    with open_recording(rested.recording(tmp_path / "r.sqlite")) as recording:
        expected = recording.estimate().to_arviz(50)
    found = rested.estimate().to_arviz(50)
    assert list(found.posterior.joint.values) == ["slide1", "slide2", "slide3"]
    for group in ("posterior", "sample_stats"):
        for name, values in expected[group].items():
            np.testing.assert_array_equal(found[group][name].values, values.values)
            assert found[group][name].dims == values.dims
        for name, value in expected[group].attrs.items():
            if name != "created_at":
                np.testing.assert_array_equal(found[group].attrs[name], value)
    with pytest.raises(EstimateError, match="during the search there is no posterior, and nothing to draw from"):
        rested.estimate(1).to_arviz()


def test_draws_of_some_links(served: Served, rested: RemoteSession) -> None:
    path = f"/api/v1/sessions/{rested.id}/posterior?format=npz"
    content = served.client.get(f"{path}&links=drawer2,frame").content
    with np.load(io.BytesIO(content)) as file:
        assert file["links"].tolist() == ["drawer2", "frame"]
        np.testing.assert_array_equal(file["particles"][:, 0], rested.posterior("drawer2").particles)
        assert file["joint_positions"].shape == (len(file["log_weights"]), len(file["joints"]))
    small.problem(served.client.get(f"{path}&links=wing"), 404, "link 'wing' is not in the model")


@pytest.mark.parametrize("name", ["robot/drawer1", "100%2F", "a?b#c", "Schublade ü/抽屉", "robot/../marginals", "a, b"])
def test_names_that_an_address_must_encode(client: Client, served: Served, name: str) -> None:
    path, _ = session_of_names(served.client, "robot/base", name)
    session = client.open_session(path.rsplit("/", 1)[1])
    assert session.belief(name).link == session.message("robot/base", name).link == name
    assert session.message(name, "robot/base").link == "robot/base"
    assert session.posterior(name).link == name
    assert session.decision([name]).links == session.decision(name).links == (name,)


def test_the_trace(served: Served, rested: RemoteSession) -> None:
    assert rested.trace() == rest(served, rested, "trace")["iterations"]
    assert [row["iteration"] for row in rested.trace(3)][:2] == [4, 5]


def test_a_recording_comes_whole_or_not_at_all(
    client: Client, served: Served, rested: RemoteSession, scripted: Callable[..., Scripted], tmp_path: Path
) -> None:
    path = rested.recording(str(tmp_path / "kept.sqlite"))
    kept = client.upload_recording(path)
    assert (kept.name, kept.status()["state"]) == ("kept", "recorded")
    assert kept.estimate().to_dict() == rested.estimate().to_dict() and kept.wait("certain").certain
    assert len(kept.trace()) == len(rested.trace())
    np.testing.assert_array_equal(kept.belief("drawer1", 4).particles, rested.belief("drawer1", 4).particles)
    with pytest.raises(ServerError, match=f"'{kept.id}' is a recording; it cannot iterate") as refusal:
        kept.step()
    assert refusal.value.status == 409
    (listed,) = client.recordings()
    assert (listed.id, listed.name, listed.url) == (kept.id, kept.name, kept.url)
    assert listed.rename("top drawer")["name"] == listed.name == client.recordings()[0].name == "top drawer"
    listed.delete()
    assert client.recordings() == []
    with pytest.raises(RecordingError, match=r"recording 'none\.sqlite' cannot be read: No such file"):
        client.upload_recording(tmp_path / "none.sqlite")
    before = path.read_bytes()
    with (
        Client(scripted(refused(507, "its disk is full")).url) as far,
        pytest.raises(ServerError, match="disk is full"),
    ):
        RemoteSession(far._calls, STATUS).recording(path)
    assert path.read_bytes() == before and [one.name for one in tmp_path.iterdir()] == ["kept.sqlite"]
    with pytest.raises(StorageError, match=r"recording 'r\.sqlite' cannot be written: No such file or directory"):
        rested.recording(tmp_path / "nowhere" / "r.sqlite")
    (tmp_path / "folder").mkdir()
    with pytest.raises(StorageError, match="recording 'folder' cannot be written"):
        rested.recording(tmp_path / "folder")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["folder", "kept.sqlite"]


def test_a_session_is_deleted(client: Client, fresh: RemoteSession) -> None:
    fresh.delete()
    with pytest.raises(ServerError, match=f"session '{fresh.id}' is not here") as caught:
        fresh.status()
    assert caught.value.status == 404


def test_waiting_ends_with_rest_though_it_is_not_certain(fresh: RemoteSession) -> None:
    assert not fresh.wait("certain").certain
    fresh.run(1)
    assert fresh.wait("converged").iteration == 1


def test_waiting_ends_with_the_time(fresh: RemoteSession) -> None:
    fresh.run(100_000)
    with pytest.raises(
        ServerError, match=f"session '{fresh.id}' is not idle after 0 s, but (running|waiting)$"
    ) as caught:
        fresh.wait("idle", timeout=0)
    assert caught.value.status is None
    fresh.pause()


def test_waiting_goes_on_beyond_one_call(
    scripted: Callable[..., Scripted], rested: RemoteSession, served: Served
) -> None:
    """Also where the estimate is converged, but of an iteration before the last change."""
    members = rest(served, rested, "estimate")
    going = told(members | {"state": "running", "converged": False})
    stale = told(members | {"state": "running", "converged": True})
    done = stale
    server = scripted(going, stale, told(STATUS | {"converged": False}), done, told(STATUS | {"converged": True}))
    with Client(server.url) as far:
        assert RemoteSession(far._calls, STATUS).wait("converged", timeout=1000).converged
    waits = [request.path.split("?")[1] for request in server.requests if "wait=" in request.path]
    assert waits == ["wait=converged&timeout=50.0"] * 3


def test_waiting_ends_with_a_failure(scripted: Callable[..., Scripted], rested: RemoteSession, served: Served) -> None:
    members = rest(served, rested, "estimate") | {"state": "failed"}
    server = scripted(told(members), told(STATUS | {"state": "failed", "error": "the data directory is full"}))
    with Client(server.url) as far, pytest.raises(ServerError, match=r"is failed: the data directory is full$"):
        RemoteSession(far._calls, STATUS).wait("idle")


def test_an_estimate_of_another_kind_is_told(scripted: Callable[..., Scripted]) -> None:
    with Client(scripted(told({"iteration": 3}), told({"iteration": 3})).url) as far:
        session = RemoteSession(far._calls, STATUS)
        with pytest.raises(PmpnbpError, match=r"this is no estimate as result\.json has it"):
            session.estimate()
        with pytest.raises(ServerError, match="the server's answer is not an estimate"):
            session.wait()


def test_json_of_arrays_is_sent(scripted: Callable[..., Scripted]) -> None:
    server = scripted(told(STATUS))
    with Client(server.url) as far:
        RemoteSession(far._calls, STATUS).change(effective_share=np.float64(0.5), triangles=np.int64(5))
    assert json.loads(server.requests[0].body) == {"config": {"effective_share": 0.5, "triangles": 5}}
    assert server.requests[0].headers["Content-Type"] == "application/json"
