"""The graph of a session: parts and joints of its model, in the colours that the pictures have."""

from __future__ import annotations

import json
from itertools import combinations

import httpx
import numpy as np
import pytest

from app.schemas_particles import Graph
from pmpnbp.pictures.palette import DARK_PAPER, STANDS_OUT, contrast, hexadecimal, part_colour, part_colour_on_dark, rgb
from tests.app import small_sessions as small
from tests.pictures.test_palette import VISION, lab

WAGON = """<robot name="wagon">
  <link name="ground"/>
  <link name="body"><visual><geometry><box size="0.6 0.3 0.2"/></geometry></visual></link>
  <link name="turret"/>
  <link name="barrel"><visual><geometry><box size="0.4 0.05 0.05"/></geometry></visual></link>
  <link name="flag"><visual><geometry><box size="0.1 0.02 0.1"/></geometry></visual></link>
  <joint name="roam" type="planar"><parent link="ground"/><child link="body"/><axis xyz="0 0 1"/></joint>
  <joint name="pan" type="continuous"><parent link="body"/><child link="turret"/><axis xyz="0 0 1"/></joint>
  <joint name="tilt" type="revolute"><parent link="turret"/><child link="barrel"/><axis xyz="0 1 0"/>
    <limit lower="-0.2" upper="1" effort="1" velocity="1"/></joint>
  <joint name="wave" type="planar"><parent link="body"/><child link="flag"/><axis xyz="0 0 1"/></joint>
</robot>"""


def test_the_graph_of_the_cabinet(client: httpx.Client) -> None:
    path = small.create(client)
    answer = client.get(f"{path}/graph")
    Graph.model_validate_json(answer.content)
    found = answer.json()
    assert [part["name"] for part in found["parts"]] == ["frame", "drawer1", "drawer2", "drawer3"]
    assert found["parts"][1]["links"] == ["drawer1", "handle1"]
    slide = {"name": "slide1", "type": "prismatic", "lower": 0.0, "upper": 0.32}
    assert found["edges"][0] == {"parent": "frame", "child": "drawer1", "joints": [slide]}
    assert [edge["child"] for edge in found["edges"]] == ["drawer1", "drawer2", "drawer3"]
    assert (found["views"], found["truth"]) == (1, False)
    assert [part["colour"] for part in found["parts"]] == [hexadecimal(part_colour(number)) for number in range(4)]
    truth = json.loads((small.CABINET / "open" / "truth.json").read_text())
    known = small.create(client, truth={name: truth[name] for name in ("links", "joints")})
    assert client.get(f"{known}/graph").json()["truth"] is True


def test_joints_between_two_parts_are_one_edge(client: httpx.Client) -> None:
    """A link without a surface passes motion on; a joint above the first part is no edge."""
    answer = client.post("/api/v1/models", files={"file": ("wagon.urdf", WAGON.encode())})
    assert answer.status_code == 201, answer.text
    path = small.create(client, model_id=answer.json()["id"])
    found = client.get(f"{path}/graph").json()
    assert [part["name"] for part in found["parts"]] == ["body", "barrel", "flag"]
    barrel, flag = found["edges"]
    assert [joint["name"] for joint in barrel["joints"]] == ["pan", "tilt"]
    assert barrel["joints"][0]["upper"] == pytest.approx(np.pi)
    assert (barrel["joints"][1]["lower"], barrel["joints"][1]["upper"]) == (-0.2, 1.0)
    (wave,) = flag["joints"]
    assert len(wave["lower"]) == len(wave["upper"]) == 3
    assert wave["upper"][2] == pytest.approx(np.pi)


def test_views_are_those_of_the_newest_iteration(client: httpx.Client) -> None:
    path = small.create(client)
    added = client.post(f"{path}/scans", json={"scan_id": small.upload_scan(client, "second_view")})
    assert added.status_code == 200, added.text
    assert client.get(f"{path}/graph").json()["views"] == 1
    small.step(client, path)
    assert client.get(f"{path}/graph").json()["views"] == 2


@pytest.mark.parametrize("vision", VISION)
def test_colours_on_dark_stand_out_and_stay_apart(vision: str) -> None:
    dark = [part_colour_on_dark(number) for number in range(18)]
    assert min(contrast(colour, rgb(DARK_PAPER)) for colour in dark) >= STANDS_OUT
    seen = [lab(colour, vision) for colour in dark]
    assert min(np.linalg.norm(one - other) for one, other in combinations(seen[:6], 2)) > 20
    for hue in range(6):
        uses = seen[hue::6]
        assert min(np.linalg.norm(one - other) for one, other in combinations(uses, 2)) > 5


def test_contrast_is_that_of_the_web() -> None:
    assert contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21)
    assert contrast((255, 255, 255), (119, 119, 119)) == pytest.approx(4.48, abs=0.01)
