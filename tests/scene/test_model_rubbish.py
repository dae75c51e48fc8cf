"""Whatever bytes come as a model, only ModelError goes out, and its text is one line."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pmpnbp.errors import ModelError
from pmpnbp.files import MEBIBYTE
from pmpnbp.scene.meshes import load_mesh
from pmpnbp.scene.model_files import ModelLimits
from pmpnbp.scene.urdf import load_model
from pmpnbp.scene.urdf_check import check_urdf

LIMITS = ModelLimits(unpacked_bytes=MEBIBYTE, entries=50, triangles=10_000)
URDF = """<?xml version="1.0"?>
<robot name="r">
 <link name="a"><visual><origin xyz="0 0 1" rpy="1 2 3"/><geometry><box size="1 2 3"/></geometry></visual></link>
 <link name="b"><collision><geometry><cylinder radius="1" length="2"/></geometry></collision></link>
 <link name="c"><visual><geometry><mesh filename="package://p/t.stl" scale="1 1 -1"/></geometry></visual></link>
 <joint name="i" type="revolute">
  <parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/>
 </joint>
 <joint name="j" type="prismatic">
  <parent link="b"/><child link="c"/><limit upper="1"/><mimic joint="i" offset=".5"/>
 </joint>
</robot>
"""
WORDS = [
    *("a", "b", "c", "i", "j", "r", "0", "-1", "1e400", "nan", "1e-320", "fixed", "floating", "planar", "continuous"),
    *(
        "",
        '"',
        "<",
        ">",
        "/>",
        "&amp;",
        "&x;",
        "é",
        "\x00",
        "<link",
        "</robot>",
        "<!DOCTYPE x>",
        "<![CDATA[",
        "../t.stl",
    ),
]
KINDS = (".stl", ".obj", ".dae", ".glb", ".ply")


def solid() -> trimesh.Trimesh:
    return trimesh.creation.box()


def exported(kind: str) -> bytes:
    data = solid().export(file_type=kind[1:])
    return data.encode() if isinstance(data, str) else data


@st.composite
def edited(draw: st.DrawFn, original: bytes, pieces: list[bytes]) -> bytes:
    """The original with up to four stretches of it replaced, and sometimes its end cut off."""
    data = original
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, max(len(data) - 1, 0)))
        piece = draw(st.sampled_from(pieces) | st.binary(max_size=8))
        # as long in half of the cases: where lengths are checked little else would get further
        length = len(piece) if draw(st.booleans()) else draw(st.integers(0, 12))
        data = data[:start] + piece + data[start + length :]
    return data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) else data


def zipped(urdf: str = URDF) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("r/r.urdf", urdf)
        archive.writestr("r/p/t.stl", solid().export(file_type="stl"))
    return file.getvalue()


def only_model_errors(path: Path) -> bool:
    """Whether it loaded."""
    try:
        load_model(path, limits=LIMITS)
    except ModelError as error:
        assert "\n" not in str(error)
        return False
    return True


def test_the_untouched_originals_load(tmp_path: Path) -> None:
    (tmp_path / "m.zip").write_bytes(zipped())
    assert only_model_errors(tmp_path / "m.zip")
    for kind in KINDS:
        assert len(load_mesh(exported(kind), kind, "mesh", 100).faces) == 12


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=edited(URDF.encode(), [word.encode() for word in WORDS]))
def test_edited_urdfs(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "p").mkdir(exist_ok=True)
    solid().export(tmp_path / "p/t.stl")
    (tmp_path / "m.urdf").write_bytes(text)
    only_model_errors(tmp_path / "m.urdf")


ATTRIBUTES = URDF.split('"')[3::2]  # from the second on: the first is the XML version


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    which=st.integers(0, len(ATTRIBUTES) - 1), value=st.sampled_from(WORDS) | st.floats().map(str) | st.text(max_size=5)
)
def test_one_attribute_with_another_value(tmp_path: Path, which: int, value: str) -> None:
    """Well-formed more often than edits by position are, so that it gets further."""
    quoted = URDF.split('"')
    quoted[2 * which + 3] = value
    path = tmp_path / "m.urdf"
    path.write_text('"'.join(quoted).replace("package://p/t.stl", "t.stl"), encoding="utf-8", errors="surrogatepass")
    solid().export(tmp_path / "t.stl")
    only_model_errors(path)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=edited(zipped(), [b"PK\x01\x02", b"PK\x03\x04", b"PK\x05\x06", b"\xff\xff\xff\xff", b"\0\0\0\0", b"../x"]))
def test_edited_zips(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "m.zip"
    path.write_bytes(data)
    only_model_errors(path)


@settings(max_examples=200)
@given(data=st.binary(max_size=200))
def test_bytes_that_were_never_xml(data: bytes) -> None:
    with pytest.raises(ModelError):
        check_urdf(data)


@pytest.mark.parametrize("kind", KINDS)
def test_edited_meshes(kind: str) -> None:
    loaded, refused = 0, [""]

    @settings(max_examples=150)
    @given(data=edited(exported(kind), [b"9999999", b"-1", b"nan", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\n", b" "]))
    def check(data: bytes) -> None:
        nonlocal loaded, refused
        try:
            load_mesh(data, kind, "mesh", 1000)
            loaded += 1
        except ModelError as error:
            assert "\n" not in str(error)
            refused.append(str(error))

    check()
    assert loaded and len(refused) > 1, refused[-1]  # both ways were taken
