"""A foot that looks the same when it is turned by half is said to, over REST as by every other way."""

from __future__ import annotations

from pathlib import Path

import httpx
import numpy as np
import pytest

from benchmarks.scene_rooms import floor_scene
from sample_data.scenes import write_scene
from sample_data.urdf_text import box, joint, link, robot
from tests.app import small_sessions as small

LEVER = robot(
    "lever",
    [
        link("foot", [box((0.4, 0.25, 0.2), (0, 0, 0.1))]),
        link("arm", [box((0.4, 0.06, 0.25), (0.1, 0, 0.125))]),
        joint("turn", "revolute", "foot", "arm", (0, 0, 0.2), axis=(0, 0, 1), limits=(-3.1, 3.1)),
    ],
)


def test_nobody_is_sent_to_look_again_at_what_looks_the_same(client: httpx.Client, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    write_scene(tmp_path, floor_scene(rng, LEVER, {"turn": 0.9}, 1.4, 0.2, things=0), rng)
    model = client.post("/api/v1/models", files={"file": ("lever.urdf", LEVER.encode())}).json()["id"]
    scan = client.post(
        "/api/v1/scans",
        files={"file": ("depth.png", (tmp_path / "depth.png").read_bytes())},
        data={"camera": (tmp_path / "camera.json").read_text()},
    ).json()["id"]
    session = small.create(client, model_id=model, scan_id=scan, roi=None, particles=100, config={})
    client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    assert small.at_rest(client, session)["converged"]

    estimate = client.get(f"{session}/estimate").json()
    assert estimate["fit"] == "good" and len(estimate["alternatives"]) == 2
    assert [link["doubts"][:1] for link in estimate["links"].values()] == [["alike"], []]
    place, way = estimate["unknown"]
    assert place.startswith("joint 'turn' may be at ") and way == "'foot' may be turned in 2 ways that look the same"
    # where it was and half a turn from there
    degrees = sorted(float(place.split()[word].rstrip("°")) for word in (5, 7))
    assert degrees == pytest.approx(np.degrees([0.9 - np.pi, 0.9]), abs=1.5)

    decision = client.get(f"{session}/decision").json()
    assert (decision["action"], decision["blocking"]) == ("look", ["foot"])
    assert decision["reason"].endswith(
        "; no view would tell how these are turned, which look the same in other turns: foot"
    )
    assert not any(view["worthwhile"] for view in decision["views"])
    assert client.get(f"{session}/decision?links=arm").json()["action"] == "act"
