"""camera.json: what is read from it, and what is said of one that cannot be used."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.scene.camera_file import load_camera

PLAIN = {"width": 64, "height": 48, "fx": 60.5, "fy": 61.0, "cx": 31.5, "cy": 23.5}
IDENTITY = np.eye(4).ravel().tolist()


def text(**changed: object) -> str:
    return json.dumps({**PLAIN, **changed})


def test_intrinsics_alone() -> None:
    read = load_camera(text())
    camera = read.camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == tuple(PLAIN.values())
    np.testing.assert_array_equal(camera.pose_world_camera, poses.IDENTITY)
    assert (read.frame_id, read.stamp) == ("world", None)


def test_what_is_no_pose_is_left_alone() -> None:
    also = {"T_world_camera": None, "world_frame": "map", "camera_name": "left", "distortion": [0.0] * 5, "R": IDENTITY}
    np.testing.assert_array_equal(load_camera(text(**also)).camera.pose_world_camera, poses.IDENTITY)


@pytest.mark.parametrize("name", ["T_camera_world", "t_world_camera", "T_world_cam", "pose_world_camera"])
def test_a_pose_by_another_name_is_refused(name: str) -> None:
    """It would be as if there were none, and all that is found be told in the camera's frame."""
    said = f"has a member '{name}', but no 'T_world_camera'; expected the camera's pose in world by that name"
    with pytest.raises(ScanError, match=said):
        load_camera(text(**{name: IDENTITY}))
    load_camera(text(**{name: IDENTITY}, T_world_camera=IDENTITY))


def test_pose_frame_and_stamp(tmp_path: Path) -> None:
    pose = poses.from_xyz_rpy([1.0, -2.0, 0.5], [0.3, -0.2, 1.1])
    path = tmp_path / "camera.json"
    rows = poses.to_matrix(pose).ravel().tolist()
    path.write_text(text(T_world_camera=rows, frame_id="map", stamp=12.5, model="Xtion"), encoding="utf-8-sig")
    read = load_camera(path)
    np.testing.assert_allclose(poses.to_matrix(read.camera.pose_world_camera), poses.to_matrix(pose), atol=1e-12)
    assert (read.frame_id, read.stamp) == ("map", 12.5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "is not JSON (line 1"),
        ("[1]", "holds a list; expected an object"),
        ("null", "holds null; expected an object"),
        ("[" * 100_000, "nested too deep"),
        ('{"width": ' + "9" * 5000 + "}", "number too long"),
        ("{}", "has no 'width'"),
        (text(width=0), "'width' of the camera text is 0; expected whole pixels from 1 to 8192"),
        (text(width=64.5), "is 64.5; expected whole pixels"),
        (text(height=True), "'height' of the camera text is True; expected a finite number"),
        (text(fx=-1), "is -1; expected a focal length in pixels, above zero"),
        (text(cx="31"), "'cx' of the camera text is '31'; expected a finite number"),
        (text(cy=float("nan")), "'cy' of the camera text is nan; expected a finite number"),
        (text(fy=10**400), "expected a finite number"),
        (text(T_world_camera=IDENTITY[:12]), "is not a list of 16 finite numbers"),
        (text(T_world_camera=[*IDENTITY[:15], None]), "is not a list of 16 finite numbers"),
        (text(T_world_camera=[float("nan"), *IDENTITY[1:]]), "is not a list of 16 finite numbers"),
        (text(T_world_camera=[2.0, *IDENTITY[1:]]), "the upper left 3x3 block of the matrix is not a rotation"),
        (text(T_world_camera=[-1.0, *IDENTITY[1:]]), "the upper left 3x3 block of the matrix is not a rotation"),
        (text(T_world_camera=[*IDENTITY[:12], 1, 2, 3, 1]), "does not end with the row 0 0 0 1"),
        (
            text(T_world_camera=[*IDENTITY[:3], -10001, *IDENTITY[4:]]),
            "'T_world_camera' of the camera text holds a number of the size 10001; expected metres, at most 10000 from",
        ),
        (text(cx=1e12), "has a pixel that looks 1.653e+10 m to the side at a depth of 1 m; expected 'fx', 'fy', 'cx'"),
        (text(frame_id=3), "'frame_id' of the camera text is 3; expected the name of a frame"),
        (text(stamp="noon"), "'stamp' of the camera text is 'noon'"),
        (text(stamp=1.7e18), "'stamp' of the camera text is 1.7e+18; expected seconds, at most 1e+12"),
        (text(cx=-1e13), "'cx' of the camera text is -10000000000000.0; expected pixels, at most 1e+12"),
    ],
)
def test_what_is_said_of_a_camera_that_cannot_be_used(content: str, said: str) -> None:
    with pytest.raises(ScanError) as caught:
        load_camera(content)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match=r"camera file 'none\.json' cannot be read: No such file"):
        load_camera(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(ScanError, match=r"camera file 'binary\.json' is not UTF-8 text"):
        load_camera(tmp_path / "binary.json")
    (tmp_path / "long.json").write_bytes(b" " * ((1 << 20) + 1))
    with pytest.raises(ScanError, match="is larger than 1048576 bytes"):
        load_camera(tmp_path / "long.json")
