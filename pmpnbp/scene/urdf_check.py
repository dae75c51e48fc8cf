"""Is this a URDF that describes one tree of links? What was checked of it, or one sentence that says why not.

The reader behind this check (yourdfpy) accepts cycles, several roots, NaN origins and unknown joint types in silence.
So everything that is used later is checked here first, and the reader is given only what was checked: links with their
visual and collision geometry, and joints. Inertia, materials, transmissions and extensions are left out of it.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

from pmpnbp.errors import ModelError
from pmpnbp.names import name_fault

JOINT_KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
SHAPES = ("box", "cylinder", "sphere", "mesh")
MESH_EXTENSIONS = (".stl", ".obj", ".dae", ".glb", ".ply")

# Deeper or longer files than any robot's are attacks on the parser, not models.
MAX_DEPTH, MAX_ELEMENTS, MAX_ATTRIBUTE = 64, 200_000, 4096
# Metres, radians or scale; keeps everything computed from a checked number finite. How far the object may reach in
# metres is asked where all of it is known (`urdf.load_model`).
MAX_MAGNITUDE = 1e6
# Sizes (metres) and scales: smaller ones have no surface left in double precision.
MIN_SIZE = 1e-6

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class CheckedUrdf:
    """name : the robot's, empty where it has none; tree : `<robot>` reduced to what was checked; text : as it came."""

    name: str
    tree: ElementTree.Element
    text: str


def check_urdf(data: bytes) -> CheckedUrdf:
    """Check the bytes of a URDF file. Raises ModelError naming the element at fault."""
    encoding = _scan(data)
    try:
        root = ElementTree.fromstring(data)
        text = data.decode(encoding)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ModelError(f"the URDF is not well-formed XML: {error}") from None
    if root.tag != "robot":
        where = " in a namespace" if "}" in root.tag else ""
        raise ModelError(f"the file's root element is <{_local(root.tag)}>{where}, expected a plain <robot> (a URDF)")
    name = _checked_name(root.get("name", "").strip(), "robot")
    tree = ElementTree.Element("robot", {"name": name})
    tree.extend([_link(element) for element in root.findall("link")])
    tree.extend([_joint(element) for element in root.findall("joint")])
    _check_tree(tree)
    _check_mimics(tree)
    return CheckedUrdf(name, tree, text)


def _scan(data: bytes) -> str:
    """The declared encoding, after a pass over the file that builds nothing: no entities, no bombs, no xacro."""
    depth = elements = 0
    encoding = "utf-8-sig"

    def declaration(version: str, declared: str | None, standalone: int) -> None:
        nonlocal encoding
        if declared and declared.lower() not in ("utf-8", "utf8"):
            encoding = declared

    def doctype(*_: object) -> None:
        raise ModelError("the URDF has a DOCTYPE, which is not accepted: no document type and no entities")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if tag.startswith("xacro:"):
            raise ModelError(
                f"the file is a xacro template (it has <{tag}>), expected a URDF: expand it with xacro first"
            )
        if depth > MAX_DEPTH:
            raise ModelError(f"the URDF nests elements more than {MAX_DEPTH} deep")
        if elements > MAX_ELEMENTS:
            raise ModelError(f"the URDF has more than {MAX_ELEMENTS} elements")
        if max(map(len, (tag, *attributes.values()))) > MAX_ATTRIBUTE:
            raise ModelError(f"<{tag:.60}> has an attribute, or a name, of more than {MAX_ATTRIBUTE} characters")

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.XmlDeclHandler = declaration
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise ModelError(f"the URDF is not well-formed XML: {error}") from None
    return encoding


def _link(element: ElementTree.Element) -> ElementTree.Element:
    name = _name(element, "link")
    link = ElementTree.Element("link", {"name": name})
    for kind in ("visual", "collision"):
        for shape in element.findall(kind):
            where = f"a <{kind}> of link '{name}'"
            checked = ElementTree.SubElement(link, kind)
            _copy_origin(shape, checked, where)
            geometry = _only(shape, "geometry", where)
            if geometry is None:
                raise ModelError(f"{where} has no <geometry>")
            ElementTree.SubElement(checked, "geometry").append(_shape(geometry, where))
    return link


def _shape(geometry: ElementTree.Element, where: str) -> ElementTree.Element:
    shapes = list(geometry)
    if len(shapes) != 1 or shapes[0].tag not in SHAPES:
        found = ", ".join(f"<{_local(shape.tag)}>" for shape in shapes) or "nothing"
        raise ModelError(f"the geometry of {where} holds {found}, expected one of {', '.join(SHAPES)}")
    shape = shapes[0]
    if shape.tag == "mesh":
        return _mesh(shape, where)
    wanted = {"box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}}[shape.tag]
    checked = ElementTree.Element(shape.tag)
    for attribute, count in wanted.items():
        text = _attribute(shape, attribute, where)
        numbers = _numbers(text, count, f"{attribute} of the {shape.tag} in {where}")
        if min(numbers) < MIN_SIZE:
            raise ModelError(
                f"{attribute} of the {shape.tag} in {where} is '{text}', expected positive metres, {MIN_SIZE:g} or more"
            )
        checked.set(attribute, _join(numbers))
    return checked


def _mesh(shape: ElementTree.Element, where: str) -> ElementTree.Element:
    filename = _attribute(shape, "filename", where).strip()
    if not filename.lower().endswith(MESH_EXTENSIONS):
        raise ModelError(f"mesh '{filename}' in {where} is of no known kind, expected {', '.join(MESH_EXTENSIONS)}")
    checked = ElementTree.Element("mesh", {"filename": filename})
    if (text := shape.get("scale")) is not None:
        count = 1 if len(_split(text)) == 1 else 3
        numbers = _numbers(text, count, f"scale of mesh '{filename}' in {where}")
        if min(abs(number) for number in numbers) < MIN_SIZE:
            raise ModelError(
                f"scale of mesh '{filename}' in {where} is '{text}', expected numbers of at least {MIN_SIZE:g} in size"
            )
        checked.set("scale", _join(numbers * (3 // count)))
    return checked


def _joint(element: ElementTree.Element) -> ElementTree.Element:
    name = _name(element, "joint")
    where = f"joint '{name}'"
    kind = element.get("type")
    if kind not in JOINT_KINDS:
        came = "has no type" if kind is None else f"has the unknown type '{kind}'"
        raise ModelError(f"{where} {came}, expected one of {', '.join(JOINT_KINDS)}")
    joint = ElementTree.Element("joint", {"name": name, "type": kind})
    for role in ("parent", "child"):
        end = _only(element, role, where)
        if end is None:
            raise ModelError(f"{where} has no <{role}>")
        ElementTree.SubElement(joint, role, {"link": _attribute(end, "link", where)})
    _copy_origin(element, joint, where)
    if kind == "fixed":  # axis, limits and mimic mean nothing there, and real robots' files carry all three
        return joint
    if kind != "floating":
        _copy_axis(element, joint, where)
    if kind in ("revolute", "prismatic"):
        _copy_limit(element, joint, where, kind)
    _copy_mimic(element, joint, where, kind)
    return joint


def _copy_origin(source: ElementTree.Element, target: ElementTree.Element, where: str) -> None:
    origin = _only(source, "origin", where)
    if origin is None:
        return
    checked = ElementTree.SubElement(target, "origin")
    for attribute in ("xyz", "rpy"):
        if (text := origin.get(attribute)) is not None:
            checked.set(attribute, _join(_numbers(text, 3, f"origin {attribute} of {where}")))


def _copy_axis(source: ElementTree.Element, target: ElementTree.Element, where: str) -> None:
    axis = _only(source, "axis", where)
    text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")  # URDF's default
    numbers = _numbers(text, 3, f"axis of {where}")
    length = math.hypot(*numbers)
    if length < 1e-9:
        raise ModelError(f"axis of {where} is '{text}', expected a direction")
    ElementTree.SubElement(target, "axis", {"xyz": _join([number / length for number in numbers])})


def _copy_limit(source: ElementTree.Element, target: ElementTree.Element, where: str, kind: str) -> None:
    limit = _only(source, "limit", where)
    if limit is None or (limit.get("lower") is None and limit.get("upper") is None):
        raise ModelError(f"{where} is {kind} but has no limits, expected <limit lower=… upper=…>")
    # URDF: a bound that is left out is 0.
    lower, upper = (_numbers(limit.get(end, "0"), 1, f"{end} limit of {where}")[0] for end in ("lower", "upper"))
    if lower > upper:
        raise ModelError(f"{where} has lower limit {lower:g} above its upper limit {upper:g}")
    ElementTree.SubElement(target, "limit", {"lower": repr(lower), "upper": repr(upper)})


def _copy_mimic(source: ElementTree.Element, target: ElementTree.Element, where: str, kind: str) -> None:
    mimic = _only(source, "mimic", where)
    if mimic is None:
        return
    if kind in ("planar", "floating"):
        raise ModelError(f"{where} is {kind} and has a <mimic>, which only joints with one axis can have")
    checked = {"joint": _attribute(mimic, "joint", where)}
    for attribute, default in (("multiplier", "1"), ("offset", "0")):
        number = _numbers(mimic.get(attribute, default), 1, f"mimic {attribute} of {where}")[0]
        checked[attribute] = repr(number)
    if abs(float(checked["multiplier"])) < MIN_SIZE:
        raise ModelError(
            f"{where} mimics '{checked['joint']}' with multiplier {checked['multiplier']}, expected at least "
            f"{MIN_SIZE:g} in size, or a fixed joint"
        )
    ElementTree.SubElement(target, "mimic", checked)


def _check_tree(tree: ElementTree.Element) -> None:
    """Exactly one tree over all links."""
    links = [link.get("name", "") for link in tree.iter("link")]
    joints = [(joint.get("name", ""), *_ends(joint)) for joint in tree.iter("joint")]
    if not links:
        raise ModelError("the URDF has no <link>")
    for kind, names in (("links", links), ("joints", [name for name, _, _ in joints])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise ModelError(f"two {kind} are named '{twice[0]}'")
    known, above = set(links), dict[str, tuple[str, str]]()
    for name, parent, child in joints:
        for role, link in (("parent", parent), ("child", child)):
            if link not in known:
                raise ModelError(f"{role} link '{link}' of joint '{name}' is not in the URDF; it has {_some(links)}")
        if child in above:
            raise ModelError(f"link '{child}' is the child of two joints, '{above[child][0]}' and '{name}'")
        above[child] = (name, parent)
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise ModelError(f"links {_some(roots)} are all without a parent joint, expected exactly one root")
    children: dict[str, list[str]] = {link: [] for link in links}
    for _, parent, child in joints:
        children[parent].append(child)
    reached, waiting = set(roots), list(roots)
    while waiting:
        below = children[waiting.pop()]
        reached.update(below)
        waiting.extend(below)
    if len(reached) < len(links):
        raise ModelError(
            f"joints lead in a circle through links {_some(link for link in links if link not in reached)}"
        )


def _check_mimics(tree: ElementTree.Element) -> None:
    """Every followed joint exists and moves along one axis, and nobody follows himself."""
    kinds = {joint.get("name", ""): joint.get("type", "") for joint in tree.iter("joint")}
    follows = {
        joint.get("name", ""): mimic.get("joint", "") for joint in tree.iter("joint") for mimic in joint.iter("mimic")
    }
    for joint, followed in follows.items():
        if followed not in kinds:
            raise ModelError(f"joint '{joint}' mimics '{followed}', which is not in the URDF; it has {_some(kinds)}")
        if kinds[followed] not in ("revolute", "continuous", "prismatic"):
            raise ModelError(f"joint '{joint}' mimics '{followed}', which is {kinds[followed]} and has no position")
        seen = [joint]
        while seen[-1] in follows:
            if follows[seen[-1]] == joint == seen[-1]:
                raise ModelError(f"joint '{joint}' mimics itself")
            if follows[seen[-1]] in seen:
                raise ModelError(f"joints {_some(seen)} mimic each other in a circle")
            seen.append(follows[seen[-1]])


def _ends(joint: ElementTree.Element) -> tuple[str, str]:
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None
    return parent.get("link", ""), child.get("link", "")


def _name(element: ElementTree.Element, kind: str) -> str:
    name = element.get("name")
    if not name:
        raise ModelError(f"a <{kind}> of the URDF has no name")
    return _checked_name(name, kind)


def _checked_name(name: str, kind: str) -> str:
    if fault := name_fault(name):
        raise ModelError(f"the name of a <{kind}> of the URDF, {name!r:.60}, {fault}")
    return name


def _attribute(element: ElementTree.Element, attribute: str, where: str) -> str:
    text = element.get(attribute)
    if not text:
        raise ModelError(f"<{_local(element.tag)}> of {where} has no {attribute}")
    return text


def _only(element: ElementTree.Element, tag: str, where: str) -> ElementTree.Element | None:
    found = element.findall(tag)
    if len(found) > 1:
        raise ModelError(f"{where} has {len(found)} <{tag}> elements, expected at most one")
    return found[0] if found else None


def _split(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _numbers(text: str, count: int, what: str) -> list[float]:
    words = _split(text)
    if len(words) == count and all(_NUMBER.fullmatch(word) for word in words):
        numbers = [float(word) for word in words]
        if all(abs(number) <= MAX_MAGNITUDE for number in numbers):
            return numbers
    wanted = "a number" if count == 1 else f"{count} numbers"
    raise ModelError(f"{what} is '{text}', expected {wanted}, finite and at most {MAX_MAGNITUDE:g} in size")


def _join(numbers: Iterable[float]) -> str:
    return " ".join(repr(number) for number in numbers)


def _some(names: Iterable[str]) -> str:
    """Up to eight names, quoted, for a sentence."""
    listed = [f"'{name}'" for name in names]
    return ", ".join(listed[:8]) + (f" and {len(listed) - 8} more" if len(listed) > 8 else "") if listed else "none"


def _local(tag: object) -> str:
    """An element's name without its namespace."""
    return str(tag).rsplit("}", 1)[-1]
