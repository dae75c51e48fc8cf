"""Every sentence about a URDF that cannot be used, by its text; and what is let through."""

from __future__ import annotations

import re

import pytest

from pmpnbp.errors import ModelError
from pmpnbp.scene.urdf_check import check_urdf


def robot(inside: str) -> bytes:
    return f'<robot name="r">{inside}</robot>'.encode()


def link(inside: str) -> bytes:
    return robot(f'<link name="a">{inside}</link>')


def shape(inside: str) -> bytes:
    return link(f"<visual><geometry>{inside}</geometry></visual>")


LINKS = '<link name="a"/><link name="b"/><link name="c"/>'
ENDS = '<parent link="a"/><child link="b"/>'
NEXT_ENDS = '<parent link="b"/><child link="c"/>'


def joint(kind: str, inside: str = "", name: str = "j", ends: str = ENDS) -> str:
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def one_joint(kind: str, inside: str = "") -> bytes:
    return robot('<link name="a"/><link name="b"/>' + joint(kind, inside))


def two_joints(first: str, second: str) -> bytes:
    return robot(LINKS + joint("continuous", first, "i") + joint("continuous", second, "j", NEXT_ENDS))


SENTENCES = {
    "empty": (b"", "the URDF is not well-formed XML: no element found: line 1, column 0"),
    "unclosed": (b"<robot>", "the URDF is not well-formed XML: no element found: line 1, column 7"),
    "unbound prefix": (robot("<q:x/>"), "the URDF is not well-formed XML: unbound prefix: line 1, column 16"),
    "unknown encoding": (b'<?xml version="1.0" encoding="x-y"?><robot/>', "the URDF is not well-formed XML: "),
    "doctype": (
        b'<!DOCTYPE robot [<!ENTITY e "x">]><robot name="&e;"/>',
        "the URDF has a DOCTYPE, which is not accepted: no document type and no entities",
    ),
    "xacro": (
        b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>',
        "the file is a xacro template (it has <xacro:macro>), expected a URDF: expand it with xacro first",
    ),
    "depth": (b"<robot>" + b"<a>" * 64 + b"</a>" * 64 + b"</robot>", "the URDF nests elements more than 64 deep"),
    "elements": (robot("<a/>" * 200_000), "the URDF has more than 200000 elements"),
    "root element": (b"<sdf/>", "the file's root element is <sdf>, expected a plain <robot> (a URDF)"),
    "namespace": (b'<robot xmlns="u"/>', "the file's root element is <robot> in a namespace, expected a plain <robot>"),
    "no link": (robot(""), "the URDF has no <link>"),
    "nameless link": (robot("<link/>"), "a <link> of the URDF has no name"),
    "nameless joint": (robot(LINKS + '<joint type="fixed"/>'), "a <joint> of the URDF has no name"),
    "two links": (robot('<link name="a"/><link name="a"/>'), "two links are named 'a'"),
    "two joints": (robot(LINKS + joint("fixed") + joint("fixed", ends=NEXT_ENDS)), "two joints are named 'j'"),
    "two geometries": (
        link("<visual><geometry/><geometry/></visual>"),
        "a <visual> of link 'a' has 2 <geometry> elements, expected at most one",
    ),
    "no geometry": (link("<collision/>"), "a <collision> of link 'a' has no <geometry>"),
    "empty geometry": (
        shape(""),
        "the geometry of a <visual> of link 'a' holds nothing, expected one of box, cylinder, sphere, mesh",
    ),
    "capsule": (
        shape('<capsule radius="1" length="1"/>'),
        "the geometry of a <visual> of link 'a' holds <capsule>, expected one of box, cylinder, sphere, mesh",
    ),
    "no size": (shape("<box/>"), "<box> of a <visual> of link 'a' has no size"),
    "size of two": (
        shape('<box size="1 2"/>'),
        "size of the box in a <visual> of link 'a' is '1 2', expected 3 numbers, finite and at most 1e+06 in size",
    ),
    "negative radius": (
        shape('<sphere radius="-1"/>'),
        "radius of the sphere in a <visual> of link 'a' is '-1', expected positive metres, 1e-06 or more",
    ),
    "zero length": (
        shape('<cylinder radius="1" length="0"/>'),
        "length of the cylinder in a <visual> of link 'a' is '0', expected positive metres, 1e-06 or more",
    ),
    "nan radius": (
        shape('<sphere radius="nan"/>'),
        "radius of the sphere in a <visual> of link 'a' is 'nan', expected a number, finite and at most 1e+06 in size",
    ),
    "python's numbers": (shape('<sphere radius="1_0"/>'), "radius of the sphere in a <visual> of link 'a' is '1_0', "),
    "nameless mesh": (shape("<mesh/>"), "<mesh> of a <visual> of link 'a' has no filename"),
    "mesh kind": (
        shape('<mesh filename="a.blend"/>'),
        "mesh 'a.blend' in a <visual> of link 'a' is of no known kind, expected .stl, .obj, .dae, .glb, .ply",
    ),
    "mesh scale": (
        shape('<mesh filename="a.stl" scale="1 0 1"/>'),
        "scale of mesh 'a.stl' in a <visual> of link 'a' is '1 0 1', expected numbers of at least 1e-06 in size",
    ),
    "visual origin": (
        link('<visual><origin xyz="0 inf 0"/><geometry><sphere radius="1"/></geometry></visual>'),
        "origin xyz of a <visual> of link 'a' is '0 inf 0', expected 3 numbers, finite and at most 1e+06 in size",
    ),
    "joint origin": (
        one_joint("fixed", '<origin rpy="0 0 nan"/>'),
        "origin rpy of joint 'j' is '0 0 nan', expected 3 numbers, finite and at most 1e+06 in size",
    ),
    "no joint type": (
        robot(LINKS + '<joint name="j"/>'),
        "joint 'j' has no type, expected one of fixed, revolute, continuous, prismatic, planar, floating",
    ),
    "unknown joint type": (
        one_joint("screw"),
        "joint 'j' has the unknown type 'screw', expected one of fixed, revolute, continuous, prismatic, ",
    ),
    "no child": (robot(LINKS + '<joint name="j" type="fixed"><parent link="a"/></joint>'), "joint 'j' has no <child>"),
    "no parent link": (
        robot(LINKS + '<joint name="j" type="fixed"><parent/></joint>'),
        "<parent> of joint 'j' has no link",
    ),
    "zero axis": (one_joint("continuous", '<axis xyz="0 0 0"/>'), "axis of joint 'j' is '0 0 0', expected a direction"),
    "no limits": (one_joint("revolute"), "joint 'j' is revolute but has no limits, expected <limit lower=… upper=…>"),
    "effort alone": (
        one_joint("prismatic", '<limit effort="1" velocity="1"/>'),
        "joint 'j' is prismatic but has no limits, expected <limit lower=… upper=…>",
    ),
    "limits crossed": (
        one_joint("prismatic", '<limit lower="1" upper="-1"/>'),
        "joint 'j' has lower limit 1 above its upper limit -1",
    ),
    "nan limit": (
        one_joint("prismatic", '<limit lower="nan" upper="1"/>'),
        "lower limit of joint 'j' is 'nan', expected a number, finite and at most 1e+06 in size",
    ),
    "planar mimic": (
        one_joint("planar", '<mimic joint="j"/>'),
        "joint 'j' is planar and has a <mimic>, which only joints with one axis can have",
    ),
    "mimic of nobody": (one_joint("continuous", "<mimic/>"), "<mimic> of joint 'j' has no joint"),
    "zero multiplier": (
        two_joints("", '<mimic joint="i" multiplier="0"/>'),
        "joint 'j' mimics 'i' with multiplier 0.0, expected at least 1e-06 in size, or a fixed joint",
    ),
    "mimic of a stranger": (
        two_joints("", '<mimic joint="x"/>'),
        "joint 'j' mimics 'x', which is not in the URDF; it has 'i', 'j'",
    ),
    "mimic of a fixed joint": (
        robot(LINKS + joint("fixed") + joint("continuous", '<mimic joint="j"/>', "k", NEXT_ENDS)),
        "joint 'k' mimics 'j', which is fixed and has no position",
    ),
    "mimic circle": (
        two_joints('<mimic joint="j"/>', '<mimic joint="i"/>'),
        "joints 'i', 'j' mimic each other in a circle",
    ),
    "mimic of itself": (one_joint("continuous", '<mimic joint="j"/>'), "joint 'j' mimics itself"),
    "unknown child": (
        robot(LINKS + joint("fixed", ends='<parent link="a"/><child link="z"/>')),
        "child link 'z' of joint 'j' is not in the URDF; it has 'a', 'b', 'c'",
    ),
    "two parents": (
        robot(LINKS + joint("fixed") + joint("fixed", "", "k", '<parent link="c"/><child link="b"/>')),
        "link 'b' is the child of two joints, 'j' and 'k'",
    ),
    "two roots": (
        robot(LINKS + joint("fixed")),
        "links 'a', 'c' are all without a parent joint, expected exactly one root",
    ),
    "many roots": (
        robot("".join(f'<link name="l{i}"/>' for i in range(11))),
        "links 'l0', 'l1', 'l2', 'l3', 'l4', 'l5', 'l6', 'l7' and 3 more are all without a parent joint, expected",
    ),
    "circle": (
        robot(
            LINKS + joint("fixed", "", "j", NEXT_ENDS) + joint("fixed", "", "k", '<parent link="c"/><child link="b"/>')
        ),
        "joints lead in a circle through links 'b', 'c'",
    ),
    "circle of all": (
        robot('<link name="a"/>' + joint("fixed", ends='<parent link="a"/><child link="a"/>')),
        "joints lead in a circle through links 'a'",
    ),
}


@pytest.mark.parametrize(("data", "sentence"), SENTENCES.values(), ids=SENTENCES)
def test_the_sentence_says_what_came_and_what_was_expected(data: bytes, sentence: str) -> None:
    with pytest.raises(ModelError, match="^" + re.escape(sentence)) as caught:
        check_urdf(data)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
def test_text_is_read_in_its_own_encoding(encoding: str) -> None:
    declared = encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{declared}"?><robot name="Öfchen"><link name="Tür"/></robot>'
    checked = check_urdf(text.encode(encoding))
    assert (checked.name, checked.text) == ("Öfchen", text)
    assert [element.get("name") for element in checked.tree] == ["Tür"]


def test_only_what_was_checked_is_let_through() -> None:
    extras = (
        '<inertial><mass value="heavy"/></inertial><visual><geometry><box size="1,2,3"/></geometry><material/></visual>'
    )
    data = robot(
        f'<material name="m"/><link name="a">{extras}</link><link name="b"/><gazebo><a/></gazebo>'
        + joint("fixed", '<axis xyz="0 0 0"/><limit lower="nan"/><mimic joint="x"/>')
        + "<transmission/>"
    )
    tree = check_urdf(data).tree
    assert [element.tag for element in tree.iter()] == [
        *("robot", "link", "visual", "geometry", "box", "link", "joint", "parent", "child")
    ]
    assert tree.find("link/visual/geometry/box").get("size") == "1.0 2.0 3.0"  # type: ignore[union-attr]


def test_axes_are_made_unit_vectors() -> None:
    axis = check_urdf(one_joint("continuous", '<axis xyz="0 3 4"/>')).tree.find("joint/axis")
    assert axis is not None and axis.get("xyz") == "0.0 0.6 0.8"


def test_xmlns_of_xacro_alone_is_no_template() -> None:
    check_urdf(b'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/></robot>')
