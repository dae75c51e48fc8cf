"""The sample robot: a wheeled base, a lifting torso, a head and a seven-axis arm, 12 links, 1.1 m high.

Its head is a mesh, so that mesh files and their scale are in the sample; all else is primitives.
"""

from __future__ import annotations

import math

from sample_data.urdf_text import box, cylinder, joint, link, mesh, robot

HEAD_FILE = "meshes/head.obj"
_QUARTER = math.pi / 2

# name, type, parent, child, xyz, axis, limits
_JOINTS = (
    ("torso_lift", "prismatic", "base", "torso", (-0.10, 0, 0.30), (0, 0, 1), (0.0, 0.35)),
    ("head_pan_joint", "revolute", "torso", "head_pan", (0.03, 0, 0.56), (0, 0, 1), (-1.57, 1.57)),
    ("head_tilt_joint", "revolute", "head_pan", "head_tilt", (0.04, 0, 0.09), (0, 1, 0), (-0.76, 1.45)),
    ("shoulder_pan_joint", "revolute", "torso", "shoulder_pan", (0.22, 0, 0.42), (0, 0, 1), (-1.6, 1.6)),
    ("shoulder_lift_joint", "revolute", "shoulder_pan", "shoulder_lift", (0.13, 0, 0.05), (0, 1, 0), (-1.2, 1.5)),
    ("upperarm_roll_joint", "continuous", "shoulder_lift", "upperarm_roll", (0.20, 0, 0), (1, 0, 0), None),
    ("elbow_joint", "revolute", "upperarm_roll", "elbow", (0.14, 0, 0), (0, 1, 0), (-2.2, 2.2)),
    ("forearm_roll_joint", "continuous", "elbow", "forearm_roll", (0.19, 0, 0), (1, 0, 0), None),
    ("wrist_flex_joint", "revolute", "forearm_roll", "wrist_flex", (0.13, 0, 0), (0, 1, 0), (-2.1, 2.1)),
    ("wrist_roll_joint", "continuous", "wrist_flex", "wrist_roll", (0.14, 0, 0), (1, 0, 0), None),
    ("gripper_joint", "prismatic", "wrist_roll", "gripper", (0.10, -0.035, 0), (0, 1, 0), (0.0, 0.09)),
)

_VISUALS = {
    "base": [
        box((0.46, 0.42, 0.22), (0, 0, 0.15)),
        box((0.12, 0.30, 0.10), (0.19, 0, 0.31)),
        box((0.10, 0.10, 0.16), (-0.17, 0.13, 0.34)),
        cylinder(0.06, 0.04, (0, 0.22, 0.06), (_QUARTER, 0, 0)),
        cylinder(0.06, 0.04, (0, -0.22, 0.06), (_QUARTER, 0, 0)),
    ],
    "torso": [
        box((0.18, 0.22, 0.45), (0, 0, 0.275)),
        box((0.14, 0.16, 0.12), (0.14, 0, 0.38)),
        box((0.12, 0.12, 0.06), (0.02, 0, 0.53)),
    ],
    "head_pan": [cylinder(0.045, 0.06, (0, 0, 0.03)), box((0.07, 0.06, 0.05), (-0.04, 0.03, 0.035))],
    "head_tilt": [mesh(HEAD_FILE, (0.001, 0.001, 0.001), (0, 0, 0))],
    "shoulder_pan": [cylinder(0.06, 0.12, (0, 0, 0.02)), box((0.12, 0.08, 0.08), (0.07, 0.01, 0.05))],
    "shoulder_lift": [cylinder(0.05, 0.13, (0, 0, 0), (_QUARTER, 0, 0)), box((0.16, 0.10, 0.09), (0.09, 0.01, 0))],
    "upperarm_roll": [cylinder(0.045, 0.14, (0.05, 0, 0), (0, _QUARTER, 0)), box((0.10, 0.03, 0.06), (0.05, 0, 0.06))],
    "elbow": [cylinder(0.045, 0.12, (0, 0, 0), (_QUARTER, 0, 0)), box((0.17, 0.09, 0.085), (0.085, -0.01, 0))],
    "forearm_roll": [cylinder(0.038, 0.13, (0.05, 0, 0), (0, _QUARTER, 0)), box((0.08, 0.05, 0.03), (0.05, 0.05, 0))],
    "wrist_flex": [cylinder(0.038, 0.10, (0, 0, 0), (_QUARTER, 0, 0)), box((0.12, 0.075, 0.07), (0.065, 0.008, 0))],
    "wrist_roll": [
        cylinder(0.035, 0.05, (0.02, 0, 0), (0, _QUARTER, 0)),
        box((0.06, 0.14, 0.06), (0.07, 0, 0)),
        box((0.07, 0.016, 0.03), (0.135, -0.062, 0)),
        box((0.04, 0.05, 0.03), (0.065, 0.03, 0.045)),
    ],
    "gripper": [box((0.07, 0.016, 0.04), (0.035, 0, 0))],
}


def urdf() -> str:
    """The robot as URDF text; `HEAD_FILE` is named relative to it."""
    elements = [link(name, visuals) for name, visuals in _VISUALS.items()]
    for name, kind, parent, child, xyz, axis, limits in _JOINTS:
        elements.append(joint(name, kind, parent, child, xyz, axis=axis, limits=limits))
    return robot("mobile_manipulator", elements)


def head_obj() -> str:
    """The head as OBJ text, in millimetres: a wide face tapering to the back, and a sensor on one side of its top."""
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []

    def block(back: tuple[float, ...], front: tuple[float, ...]) -> None:
        """A box-like body between two rectangles x, y0, y1, z0, z1."""
        first = len(vertices) + 1
        for x, y0, y1, z0, z1 in (back, front):
            vertices.extend([(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)])
        quads = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (0, 4, 7, 3))
        for a, b, c, d in quads:
            faces.append((first + a, first + b, first + c))
            faces.append((first + a, first + c, first + d))

    block((-80, -70, 70, 10, 90), (100, -140, 140, 0, 120))
    block((20, 40, 100, 108, 150), (80, 40, 100, 108, 150))
    lines = ["# head of the sample robot, millimetres"]
    lines += [f"v {x:g} {y:g} {z:g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces]
    return "\n".join(lines) + "\n"


def joint_names() -> list[str]:
    """The joints' names, from the base outwards."""
    return [name for name, *_ in _JOINTS]
