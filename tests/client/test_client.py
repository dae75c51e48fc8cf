"""Models, scans and sessions of a server, as Python has them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pmpnbp.client.client import Client
from pmpnbp.client.entries import Joint, Part
from pmpnbp.errors import ModelError, PriorError, ScanError, ServerError
from tests.app import small_sessions as small
from tests.client.failing_servers import Scripted, told
from tests.servers import Served

DEPTH, CAMERA = small.CABINET / "open" / "depth.png", small.CABINET / "open" / "camera.json"
CAMERA_MEMBERS = json.loads(CAMERA.read_text())


def depth_metres() -> np.ndarray[Any, Any]:
    with Image.open(DEPTH) as picture:
        return np.asarray(picture).astype(np.float32) / 1000


def test_a_model(client: Client) -> None:
    model = client.upload_model(small.CABINET / "cabinet.urdf")
    assert (model.name, model.file_name) == ("cabinet", "cabinet.urdf")
    assert model.links[:2] == ("frame", "drawer1")
    assert Joint("slide1", "prismatic", "frame", "drawer1", 0.0, 0.32, None) in model.joints
    assert Part("drawer1", ("drawer1", "handle1")) in model.parts
    assert model in client.models()
    client.delete_model(model.id)
    assert model not in client.models()
    with pytest.raises(ServerError, match=f"model '{model.id}' is not here") as caught:
        client.delete_model(model.id)
    assert caught.value.status == 404


def test_a_scan(client: Client) -> None:
    scan = client.upload_scan(str(DEPTH), str(CAMERA))
    assert scan.points == np.count_nonzero(depth_metres())
    assert scan.valid_fraction == pytest.approx(scan.points / (640 * 480))
    assert (scan.camera.width, scan.camera.fx, scan.camera.frame_id) == (640, CAMERA_MEMBERS["fx"], "world")
    expected = np.reshape(CAMERA_MEMBERS["T_world_camera"], (4, 4))
    np.testing.assert_allclose(scan.camera.T_world_camera, expected, atol=1e-12)
    assert scan.bounds.shape == (6,) and (scan.bounds[:3] < scan.bounds[3:]).all()
    assert scan.id in [one.id for one in client.scans()]
    client.delete_scan(scan.id)
    assert scan.id not in [one.id for one in client.scans()]


@pytest.mark.parametrize(
    "camera", [CAMERA_MEMBERS | {"T_world_camera": np.eye(4)}, CAMERA_MEMBERS | {"fx": np.float64(500)}]
)
def test_depth_in_an_array_is_that_of_a_file(client: Client, camera: dict[str, Any]) -> None:
    of_file, of_array = client.upload_scan(DEPTH, CAMERA), client.upload_scan(depth_metres(), camera)
    assert (of_array.points, of_array.file_name) == (of_file.points, "scan.npz")
    assert of_array.camera.fx == camera["fx"]
    np.testing.assert_allclose(of_array.camera.T_world_camera.ravel(), np.ravel(camera["T_world_camera"]), atol=1e-12)


@pytest.mark.parametrize("shape", [(1200, 3), (30, 40, 3)])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_points_in_an_array(client: Client, rng: np.random.Generator, shape: tuple[int, ...], dtype: Any) -> None:
    points = rng.uniform([-0.5, -0.5, 1.0], [0.5, 0.5, 1.2], (30, 40, 3))
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.5, 0.5, 30))
    points[..., 0], points[..., 1] = across * points[..., 2], down * points[..., 2]
    scan = client.upload_scan(points.reshape(shape).astype(dtype))
    assert scan.points > 0
    assert scan.bounds[2] >= 0.99 and scan.bounds[5] <= 1.21


@pytest.mark.parametrize(
    ("array", "text"),
    [
        (np.zeros(7), r"shape \(7,\); expected depth \(H, W\), or points"),
        (np.zeros((2, 3, 4)), r"shape \(2, 3, 4\); expected"),
        (np.zeros((4, 5), np.uint16), "array of uint16; expected floats, in metres"),
    ],
)
def test_an_array_that_is_no_scan(client: Client, array: np.ndarray[Any, Any], text: str) -> None:
    with pytest.raises(ScanError, match=text):
        client.upload_scan(array)


def test_files_that_cannot_be_read(client: Client, tmp_path: Path) -> None:
    (tmp_path / "latin").write_bytes(b"\xff")
    (tmp_path / "list").write_text("[1]")
    with pytest.raises(ModelError, match=r"model 'none\.urdf' cannot be read: No such file or directory"):
        client.upload_model(tmp_path / "none.urdf")
    with pytest.raises(ScanError, match=r"scan 'none\.png' cannot be read: No such file"):
        client.upload_scan(tmp_path / "none.png")
    with pytest.raises(ScanError, match="camera file 'none' cannot be read: No such file"):
        client.upload_scan(DEPTH, tmp_path / "none")
    with pytest.raises(ScanError, match="camera file 'latin' is no text in UTF-8"):
        client.upload_scan(DEPTH, tmp_path / "latin")
    for name, text in (("none", "cannot be read"), ("latin", "is no text"), ("list", "is no JSON object")):
        with pytest.raises(PriorError, match=f"prior '{name}' {text}"):
            client.session("0" * 16, "1" * 16, prior=tmp_path / name)
    (tmp_path / "text").write_text("{")
    with pytest.raises(PriorError, match="prior 'text' is no JSON: "):
        client.session("0" * 16, "1" * 16, prior=tmp_path / "text")


def test_the_server_says_what_is_wrong_with_a_file(client: Client, tmp_path: Path) -> None:
    (tmp_path / "bad.urdf").write_text("<robot")
    with pytest.raises(ServerError, match=r"^the URDF is not well-formed XML") as caught:
        client.upload_model(tmp_path / "bad.urdf")
    assert caught.value.status == 422


def test_a_file_whose_name_is_no_text(client: Client, tmp_path: Path) -> None:
    path = tmp_path / "m\udcffy.urdf"
    path.write_bytes((small.CABINET / "cabinet.urdf").read_bytes())
    assert client.upload_model(path).name == "cabinet"


def test_a_session_of_files(client: Client) -> None:
    """Model and scans are uploaded for it."""
    session = client.session(
        str(small.CABINET / "cabinet.urdf"),
        [DEPTH, depth_metres()],
        camera=CAMERA,
        method="particle_filter",
        particles=30,
        iterations=7,
        seed=np.int64(3),
        roi=np.reshape(small.ROI, (2, 3)),
        prior={"kind": "uniform", "orientation": "any"},
        max_std=0.01,
        name="kitchen",
        **small.QUICK,
    )
    status = session.status()
    asked = {
        "method": "particle_filter",
        "particles": 30,
        "iterations": 7,
        "seed": 3,
        "roi": small.ROI,
        "max_std": 0.01,
    }
    assert {name: status[name] for name in asked} == asked
    assert status["prior"] == {"kind": "uniform", "orientation": "any"} and status["config"] == small.QUICK
    assert len(status["scan_ids"]) == 2 and status["model_id"] in [model.id for model in client.models()]
    assert (session.name, status["iteration"], status["state"]) == ("kitchen", 0, "paused")
    assert "'kitchen'" in repr(session) and session.id in repr(session)


def test_a_session_of_what_is_there(client: Client, tmp_path: Path) -> None:
    model, scan = client.upload_model(small.CABINET / "cabinet.urdf"), client.upload_scan(DEPTH, CAMERA)
    (tmp_path / "prior.json").write_text('{"kind": "uniform", "orientation": "upright"}')
    first = client.session(model, scan, roi=small.ROI, prior=tmp_path / "prior.json", **small.QUICK)
    second = client.session(model.id, [scan.id], roi=small.ROI, **small.QUICK)
    for session in (first, second):
        assert (session.status()["model_id"], session.status()["scan_ids"]) == (model.id, [scan.id])
    assert first.status()["prior"] == {"kind": "uniform", "orientation": "upright"}
    ids = [one.id for one in client.sessions()]
    assert ids[-2:] == [first.id, second.id]
    assert [one.id for one in client.sessions(limit=1, offset=len(ids) - 2)] == [first.id]
    with pytest.raises(ServerError, match="session") as caught:
        client.delete_model(model.id)
    assert caught.value.status == 409


def test_only_what_is_given_is_sent(scripted: Callable[..., Scripted]) -> None:
    server = scripted(told({"id": "a", "name": None, "view_url": "/sessions/a/"}, 201))
    with Client(server.url) as far:
        far.session("0" * 16, "1" * 16)
    assert json.loads(server.requests[0].body) == {"model_id": "0" * 16, "scan_ids": ["1" * 16]}


def test_what_was_uploaded_for_a_session_that_is_refused_is_deleted(client: Client, served: Served) -> None:
    def there() -> list[str]:
        return [entry["id"] for kind in ("models", "scans") for entry in served.client.get(f"/api/v1/{kind}").json()]

    before = there()
    with pytest.raises(ServerError, match="particles") as caught:
        client.session(small.CABINET / "cabinet.urdf", DEPTH, camera=CAMERA, particles=-1)
    assert caught.value.status == 422
    with pytest.raises(ScanError, match="cannot be read"):
        client.session(small.CABINET / "cabinet.urdf", Path("none.png"), camera=CAMERA)
    assert there() == before


def test_a_session_is_opened_by_its_id(client: Client, served: Served) -> None:
    path = small.create(served.client)
    session = client.open_session(path.rsplit("/", 1)[1])
    assert session.url == f"{served.url}/sessions/{session.id}/" and session.status()["id"] == session.id
    for id in ("nothing", "a/b", "../models"):
        with pytest.raises(ServerError) as caught:
            client.open_session(id)
        assert caught.value.status == 404


def test_a_client_is_closed_with_its_block(served: Served) -> None:
    with Client(served.url) as made:
        made.models()
    with pytest.raises(RuntimeError, match="closed"):
        made.models()
