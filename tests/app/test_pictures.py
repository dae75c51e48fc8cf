"""A picture shows the parts where they are, in their colours, over what the camera saw."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.backdrop import backdrop, scaled
from pmpnbp.pictures.palette import PAPER, part_colours, rgb
from pmpnbp.pictures.part_images import NOTHING, DrawingError, PartImages, smoothed
from pmpnbp.pictures.pictures import KEPT, LONGEST, Pictures, picture_size
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.articulated_object import ArticulatedObject, Mesh
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.urdf import load_model

if TYPE_CHECKING:
    from tests.servers import Served

URDF = """
<robot name="chest">
  <link name="world_frame"/>
  <link name="body"><visual><geometry><box size="0.4 0.5 0.6"/></geometry></visual></link>
  <link name="drawer"><visual><geometry><box size="0.3 0.4 0.2"/></geometry></visual></link>
  <link name="knob"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
  <joint name="floor" type="fixed"><parent link="world_frame"/><child link="body"/></joint>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="drawer"/><origin xyz="0.06 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="turn" type="continuous"><parent link="body"/><child link="knob"/><origin xyz="0 0 0.34"/></joint>
</robot>
"""
# Off centre, with pixels that are not square.
CAMERA = Camera(321, 240, 300.0, 290.0, 150.3, 125.8)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedObject:
    path = tmp_path_factory.mktemp("model") / "chest.urdf"
    path.write_text(URDF)
    return load_model(path)


@pytest.fixture(scope="module")
def part_poses(model: ArticulatedObject) -> Array:
    """In the frame of a camera at the origin: 1.6 m ahead, turned, the drawer half out."""
    turn = poses.quaternion_multiply(
        poses.from_rotation_vector(np.array([0.0, 0.5, 0.0])), np.array([0.5, 0.5, 0.5, -0.5])
    )
    root = np.concatenate([[0.05, 0.02, 1.6], turn])
    return model.part_poses(root, np.array([0.2, 0.0]))


@pytest.fixture(scope="module")
def scan(model: ArticulatedObject, part_poses: Array) -> Scan:
    """The object before a wall, as an ideal camera sees it."""
    depth, _ = render(CAMERA, prepare_surfaces(model, directions=4, points=8), part_poses)
    return Scan(CAMERA, np.where(depth > 0, depth, np.float32(2.5)))


@pytest.fixture(scope="module")
def drawing() -> Iterator[Pictures]:
    """Skips where there is no OpenGL, but not in CI, which installs it."""
    try:
        PartImages().close()
    except DrawingError as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(str(error))
    made = Pictures()
    yield made
    made.close()


def pixels(png: bytes) -> NDArray[np.int64]:
    with Image.open(io.BytesIO(png)) as picture:
        assert picture.mode == "RGB"
        return np.asarray(picture).astype(np.int64)


def hue_of_part(shown: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(h, w): the part whose colour a pixel's is nearest to in direction, its grey taken off; -1: is grey."""

    def direction(colour: Any) -> Any:
        plain = np.asarray(colour, dtype=float) - np.mean(colour, axis=-1, keepdims=True)
        return plain / np.maximum(np.linalg.norm(plain, axis=-1, keepdims=True), 1e-9)

    alike = direction(shown) @ direction(np.array(part_colours(count))).T
    coloured = shown.max(axis=-1) - shown.min(axis=-1) > 40
    return np.where(coloured, alike.argmax(axis=-1), NOTHING)


def test_parts_are_where_the_rasteriser_has_them(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    """Each part's pixels, in its own colour: all but a pixel along its outline."""
    _, number = render(CAMERA, prepare_surfaces(model, directions=4, points=8), part_poses)
    shown = hue_of_part(pixels(drawing.draw(scan, model, part_poses)), len(model.parts))
    inside = number.astype(np.int64)
    same = np.ones(number.shape, dtype=bool)
    for shift in (-1, 1):
        for axis in (0, 1):
            same &= np.roll(number, shift, axis) == number
    assert set(np.unique(inside[same])) == {NOTHING, 0, 1, 2}
    wrong = same & (shown != inside)
    assert np.count_nonzero(wrong) <= 0.002 * np.count_nonzero(same)


def test_parts_are_there_to_a_tenth_of_a_pixel(drawing: Pictures, model: ArticulatedObject, part_poses: Array) -> None:
    """Their middles, in the image that pictures are made of, at twice the size, depth to a millimetre."""
    fine = scaled(CAMERA, 2 * CAMERA.width, 2 * CAMERA.height)
    depth, number = render(fine, prepare_surfaces(model, directions=4, points=8), part_poses)
    with ThreadPoolExecutor(1) as thread:
        images = thread.submit(PartImages).result()
        found = thread.submit(images.draw, fine, model, part_poses).result()
        thread.submit(images.close).result()
    for part in range(3):
        ours, theirs = np.argwhere(found.part == part), np.argwhere(number == part)
        assert len(theirs) > 400
        np.testing.assert_allclose(ours.mean(axis=0), theirs.mean(axis=0), atol=0.2)
    both = (found.part == number) & (number != NOTHING)
    assert np.quantile(np.abs(found.depth - depth)[both], 0.98) < 0.001
    assert np.all(found.depth[found.part == NOTHING] == 0)
    along = np.einsum("hwk,hwk->hw", found.normal, fine.rays())
    assert np.all(along[found.part != NOTHING] <= 1e-6)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=-1)[found.part != NOTHING], 1, atol=1e-4)


def test_the_world_does_not_show(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan, rng: np.random.Generator
) -> None:
    """A camera that stands elsewhere, with the parts before it, sees the same as one without a pose."""
    place = np.concatenate([rng.uniform(-50, 50, 3), poses.random_quaternions(rng, ())])
    moved = replace(scan, camera=replace(CAMERA, pose_world_camera=place))
    here = pixels(drawing.draw(scan, model, part_poses))
    there = pixels(drawing.draw(moved, model, poses.multiply(place, part_poses)))
    assert np.mean(np.abs(here - there).max(axis=-1) > 8) < 0.001


def test_what_stands_in_front_shows_through(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    """A board over the left half: there the parts are only tinted."""
    depth = scan.depth.copy()
    left = slice(0, 150)
    depth[:, left] = 1.0
    number = hue_of_part(pixels(drawing.draw(scan, model, part_poses)), len(model.parts))
    plain, hidden = (
        pixels(drawing.draw(replace(scan, depth=shown), model, part_poses)) for shown in (scan.depth, depth)
    )
    colourful = [np.ptp(shown, axis=-1) for shown in (plain, hidden)]
    covered = number[:, left] == 0
    covered[:, -8:] = False
    assert np.count_nonzero(covered) > 1000
    assert colourful[1][:, left][covered].mean() < 0.4 * colourful[0][:, left][covered].mean()
    right = number[:, 170:] == 0
    np.testing.assert_allclose(plain[:, 170:][right], hidden[:, 170:][right], atol=12)


@pytest.mark.parametrize(
    ("size", "asked", "expected"),
    [
        ((640, 480), None, (640, 480)),
        ((640, 480), 320, (320, 240)),
        ((640, 480), 2000, (640, 480)),
        ((205, 154), None, (205, 154)),
        ((205, 154), 2000, (640, 481)),
        ((4000, 3000), None, (LONGEST, 1536)),
        ((100, 5000), None, (40, 2000)),
        ((1, 1), None, (1, 1)),
    ],
)
def test_sizes(size: tuple[int, int], asked: int | None, expected: tuple[int, int]) -> None:
    width, height = size
    scan = Scan(Camera(width, height, 500.0, 500.0, 0.0, 0.0), np.zeros((height, width), np.float32))
    assert picture_size(scan, asked) == expected
    assert max(expected) <= LONGEST


@pytest.mark.parametrize("width", [40, 100, 640])
def test_a_picture_has_the_size_that_was_asked_for(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan, width: int
) -> None:
    shown = pixels(drawing.draw(scan, model, part_poses, width))
    assert shown.shape == (round(240 * width / 321), width, 3)
    found = hue_of_part(shown, len(model.parts))
    assert {0, 1} <= set(np.unique(found))


def test_a_large_picture_is_drawn_once_over(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    wide = replace(scan, camera=scaled(CAMERA, 1284, 960), depth=np.kron(scan.depth, np.ones((4, 4), np.float32)))
    shown = hue_of_part(pixels(drawing.draw(wide, model, part_poses)), len(model.parts))
    small = hue_of_part(pixels(drawing.draw(scan, model, part_poses)), len(model.parts))
    assert shown.shape == (960, 1284)
    assert np.mean(shown[2::4, 2::4] == small) > 0.97


def test_nothing_to_see(drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan) -> None:
    """A scan that measured nothing, and parts behind the camera or around it."""
    empty = replace(scan, depth=np.zeros_like(scan.depth))
    behind = poses.multiply(np.array([0.0, 0.0, -9.0, 1.0, 0.0, 0.0, 0.0]), part_poses)
    shown = pixels(drawing.draw(empty, model, behind))
    assert np.all(shown == rgb(PAPER))
    assert {0, 1} <= set(np.unique(hue_of_part(pixels(drawing.draw(empty, model, part_poses)), 3)))
    around = part_poses - np.concatenate([part_poses[0, :3], np.zeros(4)])
    assert pixels(drawing.draw(scan, model, around)).shape == (240, 321, 3)


def test_a_backdrop_is_grey_and_nearer_is_lighter() -> None:
    depth = np.full((120, 160), 2.0, np.float32)
    depth[:, 80:] = 1.0
    grey = backdrop(Scan(Camera(160, 120, 150.0, 150.0, 79.5, 59.5), depth), 160, 120)
    assert np.ptp(grey, axis=-1).max() < 0.06
    assert grey[:, 100:].mean() > grey[:, :60].mean() + 0.05
    assert grey.min() > 0.5
    assert grey.max() <= 1.0


def test_single_lost_pixels_do_not_sparkle(rng: np.random.Generator) -> None:
    depth = np.full((120, 160), 1.5, np.float32)
    camera = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
    whole = backdrop(Scan(camera, depth), 160, 120)
    depth[rng.random(depth.shape) < 0.01] = 0.0
    np.testing.assert_allclose(backdrop(Scan(camera, depth), 160, 120), whole, atol=0.01)
    depth[40:80, 40:90] = 0.0
    np.testing.assert_allclose(backdrop(Scan(camera, depth), 160, 120)[60, 60], np.array(rgb(PAPER)) / 255, atol=0.01)


def test_corners_of_a_box_stay_sharp_and_a_ball_is_round() -> None:
    import trimesh

    box = trimesh.creation.box((1, 1, 1))
    _, normals = smoothed(Mesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32)))
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1, atol=1e-6)
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners, normals = smoothed(Mesh(np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32)))
    np.testing.assert_allclose(normals, corners / np.linalg.norm(corners, axis=1, keepdims=True), atol=0.02)


def test_pictures_asked_for_from_many_threads(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    expected = drawing.draw(scan, model, part_poses, 100)
    with ThreadPoolExecutor(8) as threads:
        drawn = threads.map(lambda _: drawing.draw(scan, model, part_poses, 100, scan_name="a"), range(24))
        assert set(drawn) == {expected}


def test_drawing_goes_on_when_another_one_ends(
    drawing: Pictures, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    """Both use the process's one display."""
    expected = drawing.draw(scan, model, part_poses, 100)
    other = Pictures()
    assert other.draw(scan, model, part_poses, 100) == expected
    other.close()
    assert drawing.draw(scan, model, part_poses, 100) == expected


def test_pictures_are_kept_for_a_while() -> None:
    drawing = Pictures()
    for number in range(KEPT):
        drawing.keep(number, b"%d" % number)
    assert drawing.kept(0) == b"0"
    drawing.keep("one more", b"x")
    assert (drawing.kept(0), drawing.kept(1)) == (b"0", None)
    drawing.close()


def test_without_opengl_there_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, model: ArticulatedObject, part_poses: Array, scan: Scan
) -> None:
    import pyrender

    def fails(*_: object) -> None:
        raise RuntimeError("no display\nhere")

    monkeypatch.setattr(pyrender, "OffscreenRenderer", fails)
    drawing = Pictures()
    with pytest.raises(DrawingError, match=r"^pictures cannot be drawn on this machine: .*\(no display here\)$"):
        drawing.draw(scan, model, part_poses)
    drawing.close()


def test_over_rest(served: Served, repository: Path, drawing: Pictures, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every iteration and view, at the width asked for; drawn once."""
    served.ready()
    client = served.client
    scenes = repository / "sample_data" / "cabinet"

    def upload(kind: str, path: Path, **fields: str) -> str:
        answer = client.post(f"/api/v1/{kind}", files={"file": (path.name, path.read_bytes())}, data=fields)
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    scans = [
        upload("scans", scenes / name / "depth.png", camera=(scenes / name / "camera.json").read_text())
        for name in ("self_occluded", "second_view")
    ]
    asked = {"model_id": upload("models", scenes / "cabinet.urdf"), "scan_ids": scans, "particles": 50}
    path = f"/api/v1/sessions/{client.post('/api/v1/sessions', json=asked).json()['id']}"
    assert client.post(f"{path}/step", json={"iterations": 1}).status_code == 200

    def get(**query: int) -> bytes:
        answer = client.get(f"{path}/estimate.png", params=query)
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"] == "image/png"
        return answer.content

    assert pixels(get()).shape == (480, 640, 3)
    assert pixels(get(width=320)).shape == (240, 320, 3)
    assert get(view=1, width=160) != get(view=0, width=160)
    assert get(iteration=0, width=160) != get(iteration=1, width=160)
    for query, status in (
        ({"view": 2}, 404),
        ({"iteration": 7}, 404),
        ({"view": -1}, 422),
        ({"width": 5}, 422),
        ({"width": 10**6}, 422),
    ):
        answer = client.get(f"{path}/estimate.png", params=query)
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
    assert client.get("/api/v1/sessions/nothing/estimate.png").status_code == 404

    def fails(*_: object, **__: object) -> None:
        raise DrawingError("no")

    monkeypatch.setattr(Pictures, "draw", fails)
    assert len(get(width=160)) > 1000  # was drawn before
    assert client.get(f"{path}/estimate.png", params={"width": 200}).status_code == 503
    monkeypatch.undo()
    assert len(get(width=200)) > 1000
