"""Where a model's files are looked for, and that nothing outside its folder or beyond its limits is read."""

from __future__ import annotations

import re
import stat
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pmpnbp.errors import ModelError
from pmpnbp.files import MEBIBYTE
from pmpnbp.scene.model_files import ModelLimits, open_model

LIMITS = ModelLimits()


@pytest.fixture
def pack(tmp_path: Path) -> Callable[..., Path]:
    def zipped(entries: dict[str, str], compression: int = zipfile.ZIP_DEFLATED) -> Path:
        path = tmp_path / "m.zip"
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name, text in entries.items():
                archive.writestr(name, text)
        return path

    return zipped


def read(path: Path, filename: str, limits: ModelLimits = LIMITS) -> str:
    with open_model(path, limits) as files:
        return files.read_mesh(filename, "a", limits).decode()


def sentence(path: Path, limits: ModelLimits = LIMITS, filename: str | None = None) -> str:
    with pytest.raises(ModelError) as caught, open_model(path, limits) as files:
        files.read_urdf(limits)
        if filename is not None:
            files.read_mesh(filename, "a", limits)
    assert "\n" not in str(caught.value)
    return str(caught.value)


PACKAGE = {
    "ws/my_robot/urdf/r.urdf": "<robot/>",
    "ws/my_robot/meshes/a.stl": "in the package",
    "ws/my_robot/urdf/b.stl": "beside the URDF",
    "ws/other/c.stl": "in another package",
    "top.stl": "at the top",
}


@pytest.mark.parametrize(
    ("filename", "found"),
    [
        ("b.stl", "beside the URDF"),
        ("./../meshes/a.stl", "in the package"),
        ("package://my_robot/meshes/a.stl", "in the package"),
        ("package://renamed/meshes/a.stl", "in the package"),
        ("package://other/c.stl", "in another package"),
        ("file://b.stl", "beside the URDF"),
        ("file:///top.stl", "at the top"),
    ],
)
def test_meshes_are_found_in_a_zip(pack: Callable[..., Path], filename: str, found: str) -> None:
    assert read(pack(PACKAGE), filename) == found


def test_a_package_is_found_anywhere_in_a_zip(pack: Callable[..., Path]) -> None:
    path = pack({"r.urdf": "", "deep/down/parts/x/a.stl": "far"})
    assert read(path, "package://parts/x/a.stl") == "far"


def test_a_file_s_own_folder_is_its_root(tmp_path: Path) -> None:
    (tmp_path / "urdf").mkdir()
    (tmp_path / "outside.stl").write_text("secret")
    (tmp_path / "urdf/inside.stl").write_text("open")
    (tmp_path / "urdf/door.stl").symlink_to(tmp_path / "outside.stl")
    path = tmp_path / "urdf/r.urdf"
    path.write_text("<robot/>")
    for name in ("inside.stl", "package://any/inside.stl", f"file://{tmp_path}/urdf/inside.stl"):
        assert read(path, name) == "open"
    for name in ("../outside.stl", str(tmp_path / "outside.stl"), f"file://{tmp_path}/outside.stl", "door.stl"):
        assert sentence(path, filename=name) == (
            f"mesh '{name}' of link 'a' lies outside the model's folder, and nothing outside it is read; "
            "zip the URDF together with its meshes"
        )
    assert sentence(path, filename="package://p/no.stl") == (
        "mesh 'package://p/no.stl' of link 'a' is missing: packages are looked for in the model's folder only; "
        "zip the URDF together with its meshes"
    )


def test_meshes_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text("<robot/>")
    (tmp_path / "big.stl").write_bytes(bytes(MEBIBYTE + 1))
    assert sentence(path, filename="no.stl") == "mesh 'no.stl' of link 'a' is missing"
    assert sentence(path, filename="x" * 5000) == f"mesh '{'x' * 5000}' of link 'a' is missing"
    assert sentence(path, filename="http://host/a.stl") == (
        "mesh 'http://host/a.stl' of link 'a' starts with 'http://', expected a path, file:// or package://"
    )
    small = ModelLimits(mesh_bytes=MEBIBYTE)
    assert sentence(path, small, "big.stl") == "mesh 'big.stl' of link 'a' is larger than 1 MiB"


def test_a_mesh_in_another_case_is_told_of(tmp_path: Path, pack: Callable[..., Path]) -> None:
    (tmp_path / "urdf" / "Meshes").mkdir(parents=True)
    (tmp_path / "urdf" / "Meshes" / "Arm.STL").write_text("")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "Secret.stl").write_text("")
    (tmp_path / "urdf" / "door").symlink_to(tmp_path / "outside")
    path = tmp_path / "urdf" / "r.urdf"
    path.write_text("<robot/>")
    for name in ("meshes/arm.stl", "./Meshes/arm.STL", "package://robot/meshes/Arm.stl"):
        assert sentence(path, filename=name) == (
            f"mesh '{name}' of link 'a' is missing; there is 'Meshes/Arm.STL', which differs in upper and lower case "
            "only"
        )
    assert sentence(path, filename="meshes/leg.stl") == "mesh 'meshes/leg.stl' of link 'a' is missing"
    assert "Secret" not in sentence(path, filename="Door/secret.stl")
    zipped = pack({"r.urdf": "", "deep/robot/Arm.stl": ""})
    assert sentence(zipped, filename="package://robot/arm.stl").endswith(
        "is missing; there is 'deep/robot/Arm.stl', which differs in upper and lower case only"
    )


def test_models_that_cannot_be_opened(tmp_path: Path) -> None:
    assert sentence(tmp_path / "no.urdf") == "model 'no.urdf' is not there, expected a URDF file or a zip holding one"
    (tmp_path / "dir.urdf").mkdir()
    assert sentence(tmp_path / "dir.urdf") == (
        "model 'dir.urdf' is a folder, expected a URDF file or a zip holding one"
    )
    (tmp_path / "r.urdf.xacro").write_text("")
    assert sentence(tmp_path / "r.urdf.xacro").endswith(
        "is a xacro template, expected a URDF: expand it with xacro first"
    )
    (tmp_path / "r.zip").write_text("text")
    assert sentence(tmp_path / "r.zip") == "model 'r.zip' is not a zip file"
    (tmp_path / "big.urdf").write_bytes(bytes(MEBIBYTE + 1))
    assert (
        sentence(tmp_path / "big.urdf", ModelLimits(urdf_bytes=MEBIBYTE)) == "the URDF 'big.urdf' is larger than 1 MiB"
    )


@pytest.mark.parametrize("name", ["../r.urdf", "a/../../r.urdf", "/r.urdf", "..\\r.urdf", "C:\\r.urdf"])
def test_paths_out_of_a_zip_are_refused(pack: Callable[..., Path], tmp_path: Path, name: str) -> None:
    assert sentence(pack({"ok.urdf": "", name: ""})) == (
        f"zip 'm.zip' holds '{name}', expected relative paths without '..'"
    )
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["m.zip"]


def test_a_path_of_many_folders_is_refused(pack: Callable[..., Path]) -> None:
    assert read(pack({"r.urdf": "", "f/" * 63 + "a.stl": "far"}), "f/" * 63 + "a.stl") == "far"
    for steps in (65, 2000):
        told = sentence(pack({"ok.urdf": "", "f/" * (steps - 1) + "a.stl": ""}))
        assert told == f"zip 'm.zip' holds a path of {steps} steps, expected at most 64"


def test_links_in_a_zip_are_refused(tmp_path: Path) -> None:
    entry = zipfile.ZipInfo("r.urdf")
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        archive.writestr(entry, "/etc/hostname")
    assert sentence(tmp_path / "m.zip") == "zip 'm.zip' holds 'r.urdf', which is a link or device, expected files"


def test_a_zip_s_limits_are_counted_not_believed(pack: Callable[..., Path]) -> None:
    path = pack({"r.urdf": "", "a.stl": "0" * (2 * MEBIBYTE)})
    assert path.stat().st_size < 10_000
    assert sentence(path, ModelLimits(unpacked_bytes=MEBIBYTE)) == "zip 'm.zip' unpacks to more than 1 MiB"
    data = path.read_bytes()
    true, small = struct.pack("<I", 2 * MEBIBYTE), struct.pack("<I", 10)
    assert data.count(true) == 2
    path.write_bytes(data.replace(true, small))  # both headers say ten bytes now
    assert re.match("zip 'm.zip' is damaged: Bad CRC-32", sentence(path, ModelLimits(unpacked_bytes=MEBIBYTE)))
    entries = {f"{i}.stl": "" for i in range(4)}
    assert sentence(pack(entries), ModelLimits(entries=3)) == "zip 'm.zip' has 4 entries, expected at most 3"


def test_damaged_zips(pack: Callable[..., Path]) -> None:
    path = pack({"r.urdf": "<robot/>" * 100})
    data = path.read_bytes()
    path.write_bytes(data[:60])
    assert sentence(path) == "zip 'm.zip' is damaged: File is not a zip file"
    path.write_bytes(data[:40] + b"\xff" * 4 + data[44:])
    assert sentence(path).startswith("zip 'm.zip' is damaged: ")
    path.write_bytes(
        data[:6] + b"\x01" + data[7:].replace(b"PK\x01\x02\x14\x03\x14\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01")
    )
    assert sentence(path) == "zip 'm.zip' is protected by a password"
    assert sentence(pack({"a": "", "a/r.urdf": ""})).startswith("zip 'm.zip' is damaged: ")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_the_same_name_twice(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        archive.writestr("r.urdf", "a")
        archive.writestr("r.urdf", "b")
    assert sentence(tmp_path / "m.zip") == "zip 'm.zip' holds 'r.urdf' twice"


def test_the_shallowest_urdf_is_the_model(pack: Callable[..., Path]) -> None:
    entries = {"./": "", "__MACOSX/x.urdf": "", "robot/._r.urdf": "", "robot/r.urdf": "mine", "robot/old/r.urdf": ""}
    with open_model(pack(entries), LIMITS) as files:
        assert files.read_urdf(LIMITS) == b"mine"
        folder = files.root
    assert not folder.exists()
    assert sentence(pack({"a/x.urdf": "", "b/y.URDF": ""})) == (
        "zip 'm.zip' holds several URDFs, expected one: a/x.urdf, b/y.URDF"
    )
    assert sentence(pack({"b.stl": "", "a.xml": ""})) == "zip 'm.zip' holds no .urdf file; it has a.xml, b.stl"
    assert sentence(pack({})) == "zip 'm.zip' holds no .urdf file; it has nothing"


def test_the_folder_goes_when_reading_fails(pack: Callable[..., Path]) -> None:
    with pytest.raises(ModelError), open_model(pack({"r.urdf": ""}), LIMITS) as files:
        folder = files.root
        assert folder.exists()
        files.read_mesh("no.stl", "a", LIMITS)
    assert not folder.exists()
