"""What is too far away for the inference is refused where it comes in, over REST and on the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.cli import main
from pmpnbp.scene.reach import FARTHEST
from tests.app import small_sessions as small
from tests.app.command_line import Capture

OPEN = small.CABINET / "open"
PRIOR = json.loads((OPEN / "prior.json").read_text())
LINK = '<link name="{}"><visual><origin xyz="{} 0 0"/><geometry><box size="{} 1 1"/></geometry></visual></link>'


def camera(x: float) -> dict[str, Any]:
    members = json.loads((OPEN / "camera.json").read_text())
    members["T_world_camera"][3] = x
    return dict(members)


def prior(x: float = 1.0, **members: Any) -> dict[str, Any]:
    position = {**PRIOR["pose"]["position"], "x": x}
    return {**PRIOR, "pose": {**PRIOR["pose"], "position": position}, **members}


def urdf(size: float = 1.0, x: float = 0.0) -> str:
    return f'<robot name="far">{LINK.format("a", x, size)}</robot>'


def upload_scan(client: httpx.Client, x: float) -> httpx.Response:
    files = {"file": ("depth.png", (OPEN / "depth.png").read_bytes())}
    return client.post("/api/v1/scans", files=files, data={"camera": json.dumps(camera(x))})


def test_rest_refuses_a_camera_a_model_and_a_prior_and_takes_those_at_the_limit(client: httpx.Client) -> None:
    answer = upload_scan(client, 1e5)
    assert (answer.status_code, "holds a number of the size 100000" in answer.text) == (422, True), answer.text
    for text in (urdf(size=1e6), urdf(x=-1e6)):
        answer = client.post("/api/v1/models", files={"file": ("far.urdf", text.encode())})
        assert (answer.status_code, "the surface of link 'a' lies up to " in answer.text) == (422, True), answer.text
    model_id, scan_id = small.upload_model(client), upload_scan(client, -FARTHEST).json()["id"]
    asked = small.body(model_id, scan_id, roi=None)
    for known, said in ((prior(20_000), "'position' in the prior"), (prior(std_xyz=[1e5] * 3), "'std_xyz' of the")):
        answer = client.post("/api/v1/sessions", json=asked | {"prior": known})
        assert (answer.status_code, said in answer.text) == (422, True), answer.text
    answer = client.post("/api/v1/sessions", json=asked | {"prior": prior(FARTHEST, std_xyz=[FARTHEST] * 3)})
    assert answer.status_code == 201, answer.text
    path = f"/api/v1/sessions/{answer.json()['id']}"
    stood = client.get(path).json()
    assert client.post(f"{path}/reset", json={"prior": prior(20_000)}).status_code == 422
    assert client.get(path).json() == stood
    small.step(client, path, 3)


@pytest.mark.parametrize(
    ("option", "content", "said"),
    [
        ("--camera", camera(1e5), "'T_world_camera' of camera file 'far.json' holds a number of the size 100000"),
        ("--prior", prior(-20_000), "'position' in prior file 'far.json' is {'x': -20000"),
        ("model", urdf(x=10_001), "the surface of link 'a' lies up to 10001.5 m from the root link 'a'"),
    ],
)
def test_the_command_line_says_so_in_one_sentence(
    option: str, content: Any, said: str, tmp_path: Path, capsys: Capture
) -> None:
    files = {"model": str(small.CABINET / "cabinet.urdf"), "--camera": str(OPEN / "camera.json")}
    far = tmp_path / ("far.urdf" if option == "model" else "far.json")
    far.write_text(content if option == "model" else json.dumps(content))
    model, *options = (files | {option: str(far)}).items()
    asked = [word for pair in options for word in pair]
    assert main(["estimate", model[1], str(OPEN / "depth.png"), *asked, "--iterations", "1", "--quiet"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
