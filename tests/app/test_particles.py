"""One belief looked at closely: what is told of particles is what the recording has, and weights are explained."""

from __future__ import annotations

import io
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from app.schemas_particles import HeaviestParticles, Marginals, ParticleReasons
from pmpnbp.pictures import particle_picture as pictures
from pmpnbp.pictures.palette import KIND_COLOURS, rgb
from pmpnbp.potentials.pixel_kinds import PixelKind
from pmpnbp.recording import Recording
from tests.app import small_sessions as small
from tests.pictures.test_palette import VISION, lab


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    """A session at iteration 6, the first two of them a search that keeps many hypotheses and finds the object."""
    return small.after(client, 6, config=small.QUICK | {"search_islands": 40})


@pytest.fixture(scope="module")
def recording(client: httpx.Client, path: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.sqlite"
    file.write_bytes(client.get(f"{path}/recording").content)
    return file


def heaviest(client: httpx.Client, path: str, link: str, iteration: int, limit: int = 50) -> list[dict[str, Any]]:
    answer = client.get(f"{path}/beliefs/{link}/particles?iteration={iteration}&limit={limit}")
    HeaviestParticles.model_validate_json(answer.content)
    found: list[dict[str, Any]] = answer.json()["particles"]
    return found


@pytest.mark.parametrize("iteration", [0, 2, 6])
def test_particles_are_the_beliefs_heaviest_first(client: httpx.Client, path: str, iteration: int) -> None:
    belief = client.get(f"{path}/beliefs/handle1?iteration={iteration}").json()
    found = heaviest(client, path, "handle1", iteration)
    assert sorted(one["index"] for one in found) == list(range(40))
    assert [one["log_weight"] for one in found] == sorted(belief["log_weights"], reverse=True)
    for one in found:
        assert one["pose"] == belief["particles"][one["index"]]
        assert one["log_unary"] == belief["log_unary"][one["index"]]
        assert one["weight"] == pytest.approx(np.exp(one["log_weight"]))
    assert heaviest(client, path, "handle1", iteration, 3) == found[:3]


def test_the_terms_of_a_weight_sum_up_to_it(client: httpx.Client, path: str, recording: Path) -> None:
    """For every particle and part; the constant is the same for all of a part, as nothing else is left."""
    with Recording(recording) as opened:
        report = opened.report(6)
        parts = opened.parts
    assert report.messages is not None
    for node, part in enumerate(parts):
        constants = []
        for index in range(0, 40, 7):
            answer = client.get(f"{path}/beliefs/{part}/particles/{index}")
            ParticleReasons.model_validate_json(answer.content)
            found = answer.json()
            shares = found["shares"]
            assert found["log_weight"] == report.belief.log_weights[node, index]
            assert shares["unary"] == pytest.approx(
                report.inverse_temperature[node] * report.belief.log_unary[node, index]
            )
            total = shares["unary"] + shares["prior"] + sum(shares["messages"].values())
            assert found["log_potential"] == pytest.approx(total)
            assert found["log_weight"] == pytest.approx(total + shares["constant"])
            constants.append(shares["constant"])
            for message in found["messages"]:
                assert message["log_share"] == pytest.approx(message["log_unary"] + message["log_neighbour"])
                assert shares["messages"][message["from"]] == message["log_share"]
                (joint,) = message["joint_draw"]
                assert joint == (f"slide{part[-1]}" if part != "frame" else f"slide{message['from'][-1]}")
            expected = {"drawer1", "drawer2", "drawer3"} if part == "frame" else {"frame"}
            assert set(shares["messages"]) == expected
        assert np.ptp(constants) < 1e-9


def test_a_gaussian_prior_is_a_term(client: httpx.Client) -> None:
    prior = json.loads((small.CABINET / "open" / "prior.json").read_text())
    path = small.after(client, 4, prior=prior)
    for link, factor in ((prior["link"], True), ("drawer2", False)):
        found = client.get(f"{path}/beliefs/{link}/particles/0").json()
        assert (found["shares"]["prior"] < 0) is factor


def test_descent_can_be_followed(client: httpx.Client, path: str) -> None:
    """Each particle names one of the iteration before, of its own part or of a neighbour, and says so in a sentence."""
    told = {one["source"] for one in heaviest(client, path, "drawer1", 6)}
    assert told == {"own", "neighbour"}
    for one in heaviest(client, path, "drawer1", 6):
        found = client.get(f"{path}/beliefs/drawer1/particles/{one['index']}").json()
        assert {name: found[name] for name in one} == one
        assert found["ancestor_part"] == ("frame" if one["source"] == "neighbour" else "drawer1")
        assert found["neighbour"] == ("frame" if one["source"] == "neighbour" else None)
        assert f"particle {one['ancestor']} of {found['ancestor_part']} in iteration 5" in found["origin"]
        assert ("slide1" in found["origin"]) == (one["source"] == "neighbour")
        before = client.get(f"{path}/beliefs/{found['ancestor_part']}/particles/{one['ancestor']}?iteration=5").json()
        # a particle of an own ancestor has moved by its diffusion alone
        if one["source"] == "own":
            assert np.linalg.norm(np.subtract(before["pose"][:3], found["pose"][:3])) < 0.1


def test_the_search_tells_joint_positions(client: httpx.Client, path: str) -> None:
    found = client.get(f"{path}/beliefs/drawer1/particles/0?iteration=1").json()
    assert set(found["joint_positions"]) == {"slide1", "slide2", "slide3"} and found["messages"] == []
    frame = client.get(f"{path}/beliefs/frame/particles/0?iteration=1").json()
    moved = np.linalg.norm(np.subtract(found["pose"][:3], frame["pose"][:3]))
    other = client.get(f"{path}/beliefs/drawer1/particles/1?iteration=1").json()
    assert other["joint_positions"] != found["joint_positions"] and moved > 0
    start = client.get(f"{path}/beliefs/drawer1/particles/0?iteration=0").json()
    assert (start["origin"], start["ancestor"]) == ("It was placed at the start.", None)
    assert client.get(f"{path}/beliefs/drawer1/particles/0").json()["joint_positions"] is None


def test_marginals_are_of_the_particles(client: httpx.Client, path: str) -> None:
    answer = client.get(f"{path}/beliefs/handle2/marginals?iteration=5&bins=16")
    Marginals.model_validate_json(answer.content)
    found = answer.json()
    assert (found["iteration"], found["link"], found["part"]) == (5, "handle2", "drawer2")
    names = [one["name"] for one in found["marginals"]]
    assert names == ["x", "y", "z", "roll", "pitch", "yaw", "joint slide2"]
    belief = client.get(f"{path}/beliefs/handle2?iteration=5").json()
    weights = np.exp(belief["log_weights"])
    positions = np.array(belief["particles"])[:, :3]
    estimate = client.get(f"{path}/estimate?iteration=5").json()
    for axis, one in enumerate(found["marginals"][:3]):
        expected, _ = np.histogram(positions[:, axis], one["edges"], weights=weights)
        np.testing.assert_allclose(np.array(one["density"]) * np.diff(one["edges"]), expected, atol=1e-12)
        assert one["estimate"] == estimate["links"]["handle2"]["pose"]["position"]["xyz"[axis]]
    assert found["marginals"][6]["estimate"] == pytest.approx(estimate["joints"]["slide2"]["position"])


def test_what_is_not_there_is_named(client: httpx.Client, path: str) -> None:
    for call, says in {
        "door/marginals": "link 'door' is not in the model; it has frame",
        "frame/particles?iteration=9": "it has 0 to 6",
        "frame/particles/40": "particle 40 is not here; a part has particles 0 to 39",
        "frame/particles/40/picture.png": "particle 40 is not here",
        "frame/particles/0/picture.png?view=1": "view 1 of session",
    }.items():
        answer = client.get(f"{path}/beliefs/{call}")
        assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
        assert says in answer.json()["detail"]


# The picture


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_picture_shows_the_kinds_in_their_colours(client: httpx.Client, path: str, theme: str) -> None:
    """In its third panel, as large a share of each as the legend's count says."""
    best, worst = (heaviest(client, path, "frame", 6)[place]["index"] for place in (0, -1))
    shares = []
    for index in (best, worst):
        answer = client.get(f"{path}/beliefs/frame/particles/{index}/picture.png?theme={theme}")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
        with Image.open(io.BytesIO(answer.content)) as image:
            assert image.width == 720 and image.mode == "RGB"
            shown = np.asarray(image)[:220, 484:708].reshape(-1, 3)
        of = {kind: float(np.mean(np.all(shown == rgb(colour), axis=1))) for kind, colour in KIND_COLOURS.items()}
        shares.append((of[PixelKind.EXPLAINED] - of[PixelKind.SEEN_THROUGH]) / sum(of.values()))
        assert sum(of.values()) > 0.08
    assert shares[0] > shares[1]


def test_a_part_out_of_sight_has_a_picture_too(recording: Path) -> None:
    """All of the scan, and no pixel of any kind."""
    with Recording(recording) as opened:
        problem, report = opened.problem(6), opened.report(6)
    away = report.belief.poses.copy()
    away[..., :3] += 500.0
    moved = type(report.belief)(**{**vars(report.belief), "poses": away})
    png = pictures.particle_picture(problem, type(report)(**{**vars(report), "belief": moved}), 1, 0, width=600)
    with Image.open(io.BytesIO(png)) as image:
        colours = {colour for _, colour in image.crop((400, 25, 600, 180)).getcolors(1 << 16) or ()}
    assert not colours & {rgb(colour) for colour in KIND_COLOURS.values()}


@pytest.mark.parametrize("vision", VISION)
def test_kinds_can_be_told_apart(vision: str) -> None:
    """Those that speak for and against, by 20 units of L*a*b*; the three that count little, by 12 from all others."""
    seen = {kind: lab(rgb(colour), vision) for kind, colour in KIND_COLOURS.items()}
    loud = (PixelKind.EXPLAINED, PixelKind.IN_FRONT, PixelKind.SEEN_THROUGH)
    assert min(np.linalg.norm(seen[one] - seen[other]) for one, other in combinations(loud, 2)) > 20
    assert min(np.linalg.norm(seen[one] - seen[other]) for one, other in combinations(seen, 2)) > 12
