"""Every scan format gives back the depth that was written, and says what is wrong with a file that cannot be used."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.scene.scan_files import load_scan
from tests.scene.box_rooms import FLOOR, WALL, camera_at, see
from tests.scene.scan_writers import pcd, ply

SCAN = see(
    camera_at([2.0, 0.5, 1.2], [0.2, 0.0, 0.3], width=64, height=48), [FLOOR, WALL, (0.1, -0.2, 0, 0.5, 0.2, 0.5)]
)
# not measured: one row, one pixel
HOLED = SCAN.depth.copy()
HOLED[0] = HOLED[20, 30] = 0.0
MATRIX = poses.to_matrix(SCAN.camera.pose_world_camera).ravel().tolist()


@pytest.fixture
def camera_path(tmp_path: Path) -> Path:
    c = SCAN.camera
    members = {"width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**members, "T_world_camera": MATRIX, "frame_id": "room", "stamp": 3.0}))
    return path


def organised() -> NDArray[np.float32]:
    """(H, W, 3) points in the camera frame, NaN where nothing was measured."""
    points = SCAN.camera.back_project(HOLED)
    points[HOLED == 0] = np.nan
    return points


def written(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def test_png_in_millimetres(tmp_path: Path, camera_path: Path) -> None:
    Image.fromarray(np.rint(HOLED * 1000).astype(np.uint16)).save(tmp_path / "depth.png")
    scan = load_scan(tmp_path / "depth.png", camera_path)
    np.testing.assert_allclose(scan.depth, HOLED, atol=0.00051)
    assert scan.depth[20, 30] == 0 and scan.depth.dtype == np.float32
    assert (scan.frame_id, scan.stamp) == ("room", 3.0)
    np.testing.assert_allclose(scan.camera.pose_world_camera, SCAN.camera.pose_world_camera, atol=1e-9)


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<f2"])
@pytest.mark.parametrize("fortran", [False, True])
def test_depth_arrays(tmp_path: Path, camera_path: Path, dtype: str, fortran: bool) -> None:
    array = np.where(HOLED == 0, np.nan, HOLED).astype(dtype)
    array = np.asfortranarray(array) if fortran else array
    np.save(tmp_path / "depth.npy", array)
    np.savez_compressed(tmp_path / "depth.npz", depth=array, label=np.arange(3))
    expected = np.where(HOLED == 0, 0, HOLED.astype(dtype)).astype(np.float32)
    for name in ("depth.npy", "depth.npz"):
        np.testing.assert_array_equal(load_scan(tmp_path / name, camera_path).depth, expected)


def organised_files(folder: Path) -> list[Path]:
    points = organised()
    np.save(folder / "points.npy", points)
    np.savez(folder / "points.npz", points=points.astype(np.float64))
    return [
        folder / "points.npy",
        folder / "points.npz",
        *(written(folder, f"{data}.pcd", pcd(points, data)) for data in ("ascii", "binary", "binary_compressed")),
        written(folder, "more.pcd", pcd(points, "binary", fields=["rgb", "z", "normal:3", "x", "y"], kind="f8")),
        written(folder, "packed.pcd", pcd(points, "binary_compressed", fields=["z", "normal:3", "y", "rgb", "x"])),
        written(folder, "text.pcd", pcd(points, "ascii", fields=["normal:3", "z", "x", "y"], newline="\r\n")),
    ]


def test_organised_clouds_with_a_camera_file(tmp_path: Path, camera_path: Path) -> None:
    for path in organised_files(tmp_path):
        scan = load_scan(path, camera_path)
        np.testing.assert_array_equal(scan.depth, HOLED, err_msg=path.name)
        assert scan.frame_id == "room"


def test_organised_clouds_have_their_camera_fitted(tmp_path: Path) -> None:
    for path in organised_files(tmp_path):
        scan = load_scan(path)
        np.testing.assert_array_equal(scan.depth, HOLED, err_msg=path.name)
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(scan.camera, name) == pytest.approx(getattr(SCAN.camera, name), abs=1e-3), path.name
        np.testing.assert_array_equal(scan.camera.pose_world_camera, poses.IDENTITY)


def loose_files(folder: Path, points: NDArray[np.floating]) -> list[Path]:
    np.save(folder / "loose.npy", points)
    np.savez(folder / "loose.npz", points=points)
    rows = [f"{p[0]!r} {p[1]!r}\t{p[2]!r}  17 0.5 name" for p in points.tolist()]
    commas = [",".join(repr(value) for value in [*p, 1.0]) for p in points.tolist()]
    return [
        folder / "loose.npy",
        folder / "loose.npz",
        written(folder, "loose.xyz", "\n".join(["# x y z", *rows]).encode()),
        written(folder, "marked.xyz", "\n".join(rows).encode("utf-8-sig")),
        written(folder, "loose.txt", "\r\n".join(["// x, y, z", "", *commas, ""]).encode()),
        *(written(folder, f"{data}.pcd", pcd(points, data)) for data in ("ascii", "binary", "binary_compressed")),
        *(
            written(folder, f"{name}.ply", ply(points, name, kind=kind, newline=newline))
            for name, kind, newline in [
                ("ascii", "double", "\r\n"),
                ("binary_little_endian", "float", "\n"),
                ("binary_big_endian", "double", "\r\n"),
            ]
        ),
    ]


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_a_cloud_in_another_encoding_is_told_by_its_name(tmp_path: Path, encoding: str) -> None:
    path = written(tmp_path, "wide.xyz", "\ufeff0.1 0.2 1\n0.1 0.21 1.1\n".encode(encoding))
    with pytest.raises(ScanError, match=r"scan 'wide\.xyz' is UTF-16 text; expected UTF-8 or ASCII"):
        load_scan(path)


def test_loose_clouds_with_a_camera_file_fill_its_picture(tmp_path: Path, camera_path: Path) -> None:
    points = organised().reshape(-1, 3)
    for path in loose_files(tmp_path, points):
        scan = load_scan(path, camera_path)
        np.testing.assert_allclose(scan.depth, HOLED, atol=1e-6, err_msg=path.name)


def test_loose_clouds_through_a_virtual_camera(tmp_path: Path) -> None:
    points = organised().reshape(-1, 3)
    measured = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    for path in loose_files(tmp_path, points):
        scan = load_scan(path)
        filled = scan.depth > 0
        assert 0.5 * len(measured) < filled.sum() <= len(measured)
        assert filled.mean() > 0.9
        # every pixel's ray passes a measured point of its depth by no more than the pixel's diagonal
        rows, columns = np.nonzero(filled)
        seen = scan.camera.project(measured)
        for row, column in zip(rows[::97], columns[::97], strict=True):
            near = (np.abs(seen[:, :2] - [column, row]) <= 0.5 + 1e-6).all(axis=1)
            assert scan.depth[row, column] == pytest.approx(measured[near, 2].min(), abs=1e-6)


def test_a_loose_cloud_is_seen_from_its_viewpoint(tmp_path: Path) -> None:
    """The points of a room in world coordinates, with the sensor's pose in the file: depth as from there."""
    world = poses.transform_points(SCAN.camera.pose_world_camera, organised().reshape(-1, 3).astype(np.float64))
    viewpoint = " ".join(repr(value) for value in SCAN.camera.pose_world_camera.tolist())
    scan = load_scan(written(tmp_path, "world.pcd", pcd(world, kind="f8", viewpoint=viewpoint)))
    np.testing.assert_allclose(scan.camera.pose_world_camera, SCAN.camera.pose_world_camera, atol=1e-12)
    assert scan.depth[scan.depth > 0].min() == pytest.approx(HOLED[HOLED > 0].min(), abs=1e-5)
    organised_world = world.reshape(*HOLED.shape, 3)
    scan = load_scan(written(tmp_path, "rows.pcd", pcd(organised_world, kind="f8", viewpoint=viewpoint)))
    np.testing.assert_allclose(scan.depth, HOLED, atol=1e-6)
    assert scan.camera.fx == pytest.approx(SCAN.camera.fx, abs=1e-3)


def test_a_sparse_cloud_bins_its_camera(tmp_path: Path, camera_path: Path, rng: np.random.Generator) -> None:
    """A twentieth of the pixels would be a picture of holes."""
    points = organised().reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    np.save(tmp_path / "few.npy", points[rng.permutation(len(points))[: len(points) // 20]])
    scan = load_scan(tmp_path / "few.npy", camera_path)
    assert scan.camera.width < SCAN.camera.width / 3
    assert (scan.depth > 0).mean() > 0.6
    np.testing.assert_array_equal(scan.camera.pose_world_camera, camera_pose(camera_path))


def camera_pose(camera_path: Path) -> NDArray[np.float64]:
    return poses.from_matrix(np.reshape(json.loads(camera_path.read_text())["T_world_camera"], (4, 4)))


def test_the_nearest_point_of_a_pixel_is_seen(tmp_path: Path, camera_path: Path) -> None:
    near, far = organised().reshape(-1, 3), organised().reshape(-1, 3) * np.float32(1.5)
    np.save(tmp_path / "both.npy", np.concatenate([far, near, far]))
    np.testing.assert_allclose(load_scan(tmp_path / "both.npy", camera_path).depth, HOLED, atol=1e-6)


def test_clouds_in_another_frame_than_the_camera_are_told(tmp_path: Path, camera_path: Path) -> None:
    world = poses.transform_points(SCAN.camera.pose_world_camera, organised().astype(np.float64))
    np.save(tmp_path / "world.npy", world)
    with pytest.raises(ScanError, match=r"no pinhole camera puts the points of scan 'world\.npy' at their rows"):
        load_scan(tmp_path / "world.npy")
    with pytest.raises(ScanError, match=r"sees the points of scan 'world\.npy' .* pixels from their rows and columns"):
        load_scan(tmp_path / "world.npy", camera_path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.jpg", b"", "has the suffix '.jpg'; expected one of .png, .npy"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "is not a PNG that can be read"),
        ("a.npy", b"PK", "does not start as a NumPy file does"),
        ("a.npz", b"PK", "is not an .npz archive that can be read"),
        ("a.xyz", b"", "holds no points"),
        ("a.xyz", b"1 2 3\n1 2 three\n", "line 2 of the points in scan 'a.xyz' is '1 2 three'"),
        ("a.xyz", b"1 2\n", "expected numbers x, y and z in columns 1, 2, 3"),
        ("a.xyz", b"nan nan nan\n", "has no valid point in front of its sensor"),
        ("a.xyz", b"1 1 -2\n0 0 0\n", "has no valid point in front of its sensor"),
        ("a.xyz", b"0 0 2000\n", "at most 1 km"),
        ("a.pcd", b"hello", "has no PCD header that ends with a DATA line"),
        ("a.ply", b"hello", "has no PLY header"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "has no element 'vertex'"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "x, y and z, each"),
        ("a.ply", b"ply\nelement vertex 1\nend_header\n", "has no format"),
        ("a.ply", b"ply\nformat ascii 1.0\nelephant\nend_header\n", "'elephant', which PLY does not know"),
    ],
)
def test_what_is_said_of_a_file_that_cannot_be_used(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    with pytest.raises(ScanError) as caught:
        load_scan(written(tmp_path, name, content))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"POINTS 3072", b"POINTS 3071", "says POINTS 3071, but WIDTH x HEIGHT is 64 x 48"),
        (b"WIDTH 64", b"WIDTH 64 2", "has 2 numbers after WIDTH; expected one"),
        (b"WIDTH 64", b"WIDTH -64", "says WIDTH '-64'; expected whole numbers"),
        (b"WIDTH 64\nHEIGHT 48", b"WIDTH 640000\nHEIGHT 480000", "but WIDTH x HEIGHT"),
        (b"FIELDS x y z", b"FIELDS x y w", "has FIELDS x y w; expected x, y and z, each once"),
        (b"FIELDS x y z", b"FIELDS x y z x", "names 4 FIELDS, 3 SIZE"),
        (b"SIZE 4 4 4", b"SIZE 4 4 3", "of TYPE F and SIZE 3, which PCD does not have"),
        (b"COUNT 1 1 1", b"COUNT 1 1 2", "expected x, y and z, each once and single"),
        (b"COUNT 1 1 1", b"COUNT 1 1 0", "has a COUNT of 0 to 1"),
        (b"DATA binary", b"DATA zip", "has DATA 'zip'; expected ascii, binary or binary_compressed"),
        (b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT 0 0 0 0 0 0 0", "expected seven numbers x y z qw qx qy qz"),
        (b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT 0 0 nan 1 0 0 0", "expected seven numbers x y z qw qx qy qz"),
        (
            b"WIDTH 64\nHEIGHT 48\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3072",
            b"WIDTH 64\nHEIGHT 49\nPOINTS 3136",
            "is cut short: 3136 points of 12 bytes need 37632 bytes, and 36864 are there",
        ),
        (
            b"WIDTH 64\nHEIGHT 48\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3072",
            b"WIDTH 99999999\nHEIGHT 9999\nPOINTS 999899990001",
            "says it holds 999899990001 points; expected at most 10000000",
        ),
    ],
)
def test_a_pcd_header_that_lies(tmp_path: Path, old: bytes, new: bytes, said: str) -> None:
    content = pcd(organised())
    assert old in content
    with pytest.raises(ScanError) as caught:
        load_scan(written(tmp_path, "a.pcd", content.replace(old, new)))
    assert said in str(caught.value)


def test_depth_needs_a_camera_of_its_size(tmp_path: Path, camera_path: Path) -> None:
    np.save(tmp_path / "depth.npy", HOLED)
    with pytest.raises(ScanError, match=r"scan 'depth\.npy' is a depth image and needs a camera file; none was given"):
        load_scan(tmp_path / "depth.npy")
    np.save(tmp_path / "depth.npy", HOLED[:-1])
    with pytest.raises(ScanError, match=r"scan 'depth\.npy' is 64x47 pixels, but its camera file says 64x48"):
        load_scan(tmp_path / "depth.npy", camera_path)
    np.save(tmp_path / "depth.npy", np.zeros_like(HOLED))
    with pytest.raises(ScanError, match=r"scan 'depth\.npy' has no valid point"):
        load_scan(tmp_path / "depth.npy", camera_path)
    np.save(tmp_path / "depth.npy", np.rint(HOLED * 1000).astype(np.uint16))
    with pytest.raises(ScanError, match="holds uint16; expected floats in metres"):
        load_scan(tmp_path / "depth.npy", camera_path)


def test_a_picture_is_not_depth(tmp_path: Path, camera_path: Path) -> None:
    Image.fromarray(np.zeros((48, 64), dtype=np.uint8)).save(tmp_path / "grey.png")
    with pytest.raises(ScanError, match="is a PNG of mode L; expected 16-bit greyscale, millimetres"):
        load_scan(tmp_path / "grey.png", camera_path)


def test_arrays_that_are_no_scan(tmp_path: Path, camera_path: Path) -> None:
    np.savez(tmp_path / "a.npz", depths=HOLED)
    with pytest.raises(ScanError, match="holds the arrays 'depths'; expected one of 'depth' and 'points'"):
        load_scan(tmp_path / "a.npz", camera_path)
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ScanError, match="expected real numbers of at most 64 bits"):
        load_scan(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", b"\0" * 250_000_000)
    with pytest.raises(ScanError, match="unpacks to 250000000 bytes, more than a scan can have"):
        load_scan(tmp_path / "bomb.npz")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match=r"scan 'none\.png' cannot be read: No such file or directory"):
        load_scan(tmp_path / "none.png")
    with pytest.raises(ScanError, match="cannot be read: Is a directory"):
        (tmp_path / "folder.ply").mkdir()
        load_scan(tmp_path / "folder.ply")


def test_the_real_organised_cloud_is_its_depth_image(shared_data: Path) -> None:
    """A RealSense frame both as PNG with camera.json and as PCD without: the fit finds the intrinsics."""
    folder = shared_data / "real_xarm7" / "frame_0"
    image, cloud = load_scan(folder / "depth.png", folder / "camera.json"), load_scan(folder / "scan.pcd")
    np.testing.assert_allclose(cloud.depth, image.depth, atol=2e-6)
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(cloud.camera, name) == pytest.approx(getattr(image.camera, name), abs=1e-3)
