"""What else stands in a house, a workshop, an office? Thirteen objects, written as URDF text, that no part of the
inference was made with: each has its root's base at z = 0, z up, and faces +x; but a dog has its body's middle there,
and a stepladder its hinge.

Some look the same when they are turned: an office chair's foot, a carton, a pipe, an excavator's tracks. Which way
these stand no scan tells.
"""

from __future__ import annotations

import numpy as np

from sample_data.urdf_text import box, cylinder, joint, link, robot, slide, sphere

# Sheet metal and boards, metres.
WALL = 0.02
# Along y, and along x.
ALONG_Y, ALONG_X = (np.pi / 2, 0.0, 0.0), (0.0, np.pi / 2, 0.0)


def fridge(width: float, depth: float, height: float) -> str:
    """Two doors that open away from each other, over a drawer."""
    split, wall = 0.4 * height, 0.05
    body = _housing(width, depth, height, wall) + [box((depth, width, wall), (-depth / 2, 0, split))]
    elements = [link("body", body)]
    for name, side in (("left", 1), ("right", -1)):
        middle = (height + split) / 2
        leaf = box((wall, width / 2 - 0.004, height - split - 0.01), (wall / 2, -side * width / 4, middle))
        grip = cylinder(0.012, 0.5, (wall + 0.04, -side * (width / 2 - 0.05), middle))
        elements.append(link(name, [leaf, grip]))
        hinged = (0, side * width / 2, 0)
        elements.append(joint(f"{name}_hinge", "revolute", "body", name, hinged, axis=(0, 0, side), limits=(0, 2.0)))
    inside = 0.7 * depth
    sides = [box((inside, WALL, 0.25), (-inside / 2, side * 0.4 * width, 0.2)) for side in (-1, 1)]
    front = box((wall, width - 0.004, split - 0.01), (wall / 2, 0, split / 2))
    grip = cylinder(0.012, 0.5, (wall + 0.04, 0, split - 0.1), ALONG_Y)
    elements.append(link("freezer", [front, grip, box((inside, 0.8 * width, WALL), (-inside / 2, 0, 0.1)), *sides]))
    elements.append(slide("freezer_slide", "body", "freezer", (0, 0, 0), (1, 0, 0), inside))
    return robot("fridge", elements)


def washing_machine(width: float, depth: float, height: float, radius: float) -> str:
    """A round door with a latch, and a drawer for the powder."""
    door = [cylinder(radius, 0.04, (0.02, -radius, 0), ALONG_X), cylinder(0.7 * radius, 0.05, (0, -radius, 0), ALONG_X)]
    tray = [box((0.02, 0.18, 0.08), (0.01, 0, 0)), box((0.25, 0.15, 0.06), (-0.125, 0, 0))]
    elements = [
        link("body", [box((depth, width, height), (-depth / 2, 0, height / 2))]),
        link("door", [*door, box((0.03, 0.03, 0.1), (0.05, 0.02 - 2 * radius, 0))]),
        link("tray", tray),
        joint("hinge", "revolute", "body", "door", (0, radius, 0.45 * height), axis=(0, 0, 1), limits=(0, 2.6)),
        slide("slide", "body", "tray", (0, width / 2 - 0.11, height - 0.06), (1, 0, 0), 0.22),
    ]
    return robot("washing_machine", elements)


def office_chair() -> str:
    """A foot of five arms, a seat that is lifted and swivels on it, a back that reclines."""
    arms = [
        box((0.3, 0.04, 0.04), (0.15 * np.cos(turn), 0.15 * np.sin(turn), 0.06), (0, 0, turn))
        for turn in 2 * np.pi * np.arange(5) / 5
    ]
    seat = [cylinder(0.018, 0.25, (0, 0, -0.12)), box((0.45, 0.48, 0.07), (0, 0, 0.03))]
    for side in (-1, 1):
        seat += [box((0.25, 0.04, 0.03), (0, side * 0.27, 0.22)), box((0.04, 0.03, 0.2), (0, side * 0.27, 0.11))]
    elements = [
        link("foot", [*arms, cylinder(0.025, 0.3, (0, 0, 0.2))]),
        link("column", []),
        link("seat", seat),
        link("back", [box((0.04, 0.42, 0.5), (-0.02, 0, 0.4)), box((0.04, 0.06, 0.2), (-0.02, 0, 0.1))]),
        joint("lift", "prismatic", "foot", "column", (0, 0, 0.36), axis=(0, 0, 1), limits=(0, 0.14)),
        joint("swivel", "continuous", "column", "seat", (0, 0, 0), axis=(0, 0, 1)),
        joint("recline", "revolute", "seat", "back", (-0.22, 0, 0.05), axis=(0, -1, 0), limits=(-0.1, 0.5)),
    ]
    return robot("office_chair", elements)


def carton(width: float, depth: float, height: float) -> str:
    """Four flaps; front and back are as long as each other, and the sides."""
    wall = 0.006
    elements = [link("carton", _open_box(width, depth, height, wall))]
    for number, name in enumerate(("front", "left", "back", "right")):
        turn, across = number * np.pi / 2, number % 2
        out, long = (width, depth) if across else (depth, width)
        hinged = (np.cos(turn) * out / 2, np.sin(turn) * out / 2, height)
        elements.append(link(name, [box((depth / 2, long - 0.01, wall), (-depth / 4, 0, 0))]))
        folds = joint(f"{name}_fold", "revolute", "carton", name, hinged, (0, 0, turn), (0, 1, 0), (0, 4.2))
        elements.append(folds)
    return robot("carton", elements)


def toolbox(width: float, depth: float, height: float) -> str:
    """A lid with a grip that folds down on it."""
    lid = [box((depth, width, 0.01), (depth / 2, 0, 0.02)), box((0.04, 0.08, 0.02), (depth + 0.01, 0, 0))]
    grip = [cylinder(0.012, 0.18, (0.06, 0, 0), ALONG_Y)]
    grip += [box((0.06, 0.015, 0.01), (0.03, side * 0.09, 0)) for side in (-1, 1)]
    elements = [
        link("tub", _open_box(width, depth, height, 0.01)),
        link("lid", lid),
        link("grip", grip),
        joint("hinge", "revolute", "tub", "lid", (-depth / 2, 0, height), axis=(0, -1, 0), limits=(0, 2.2)),
        joint("grip_hinge", "revolute", "lid", "grip", (depth / 2, 0, 0.03), axis=(0, -1, 0), limits=(0, np.pi)),
    ]
    return robot("toolbox", elements)


def toilet() -> str:
    """A seat and a lid on one hinge."""
    bowl = [cylinder(0.12, 0.38, (0, 0, 0.19)), cylinder(0.19, 0.06, (0.02, 0, 0.37))]
    bowl += [box((0.16, 0.38, 0.35), (-0.3, 0, 0.55)), box((0.2, 0.2, 0.38), (-0.2, 0, 0.19))]
    seat = [box((0.42, 0.05, 0.02), (0.21, side * 0.15, 0.01)) for side in (-1, 1)]
    seat += [box((0.06, 0.34, 0.02), (x, 0, 0.01)) for x in (0.4, 0.03)]
    elements = [
        link("bowl", bowl),
        link("seat", seat),
        link("lid", [box((0.44, 0.37, 0.02), (0.22, 0, 0.035))]),
        joint("seat_hinge", "revolute", "bowl", "seat", (-0.2, 0, 0.405), axis=(0, -1, 0), limits=(0, 1.75)),
        joint("lid_hinge", "revolute", "bowl", "lid", (-0.2, 0, 0.41), axis=(0, -1, 0), limits=(0, 1.75)),
    ]
    return robot("toilet", elements)


def valve(spokes: int, radius: float) -> str:
    """A wheel with a handle on a pipe on two feet."""
    around = 2 * np.pi * np.arange(12) / 12
    piece = (0.02, 2 * radius * np.tan(np.pi / 12) + 0.005, 0.02)
    rim = [box(piece, (radius * np.cos(turn), radius * np.sin(turn), 0.12), (0, 0, turn)) for turn in around]
    for turn in 2 * np.pi * np.arange(spokes) / spokes:
        middle = (radius / 2 * np.cos(turn), radius / 2 * np.sin(turn), 0.12)
        rim.append(box((radius, 0.018, 0.015), middle, (0, 0, turn)))
    pipe = [cylinder(0.05, 0.7, (0, 0, 0.35), ALONG_Y), cylinder(0.035, 0.12, (0, 0, 0.43))]
    for side in (-1, 1):
        pipe += [cylinder(0.09, 0.03, (0, side * 0.2, 0.35), ALONG_Y), box((0.08, 0.08, 0.3), (0, side * 0.3, 0.15))]
    elements = [
        link("pipe", pipe),
        link("wheel", [*rim, cylinder(0.012, 0.08, (radius, 0, 0.16))]),
        joint("spin", "continuous", "pipe", "wheel", (0, 0, 0.37), axis=(0, 0, 1)),
    ]
    return robot("valve", elements)


def microwave(width: float, depth: float, height: float) -> str:
    """A door, and a turntable with something small near its edge."""
    opening = 0.72 * width
    panel = box((depth, width - opening, height), (-depth / 2, -opening / 2, height / 2))
    grip = [cylinder(0.008, 0.7 * height, (0.055, 0.03 - opening, height / 2))]
    grip += [box((0.03, 0.015, 0.015), (0.035, 0.03 - opening, share * height)) for share in (0.2, 0.8)]
    elements = [
        link("body", [*_housing(width, depth, height, 0.012), panel]),
        link("door", [box((0.03, opening, height), (0.015, -opening / 2, height / 2)), *grip]),
        link("plate", [cylinder(0.13, 0.01, (0, 0, 0)), box((0.02, 0.05, 0.02), (0.1, 0, 0.01))]),
        joint("hinge", "revolute", "body", "door", (0, width / 2, 0), axis=(0, 0, 1), limits=(0, 2.0)),
        joint("turn", "continuous", "body", "plate", (-depth / 2, (width - opening) / 2, 0.04), axis=(0, 0, 1)),
    ]
    return robot("microwave", elements)


def dishwasher(width: float, depth: float, height: float) -> str:
    """A door that folds down, and two racks behind it."""
    tall = height - 0.1
    grip = [cylinder(0.01, 0.4, (0.07, 0, tall - 0.08), ALONG_Y)]
    grip += [box((0.03, 0.02, 0.02), (0.05, side * 0.18, tall - 0.08)) for side in (-1, 1)]
    rack = [box((0.45, 0.46, 0.01), (-0.225, 0, 0)), box((0.012, 0.46, 0.1), (-0.006, 0, 0.05))]
    rack += [box((0.45, 0.012, 0.1), (-0.225, side * 0.23, 0.05)) for side in (-1, 1)]
    elements = [
        link("body", [*_housing(width, depth, height, WALL), box((depth, width, 0.08), (-depth / 2, 0, 0.04))]),
        link("door", [box((0.04, width, tall), (0.02, 0, tall / 2)), *grip]),
        link("lower", rack),
        link("upper", rack),
        joint("hinge", "revolute", "body", "door", (0, 0, 0.1), axis=(0, 1, 0), limits=(0, 1.57)),
        slide("lower_slide", "body", "lower", (-0.03, 0, 0.16), (1, 0, 0), 0.45),
        slide("upper_slide", "body", "upper", (-0.03, 0, 0.5), (1, 0, 0), 0.45),
    ]
    return robot("dishwasher", elements)


def excavator() -> str:
    """A cab that turns on its tracks, with a boom, a stick and a bucket."""
    tracks = [box((0.5, 0.1, 0.1), (0, side * 0.15, 0.05)) for side in (-1, 1)]
    cab = [box((0.36, 0.28, 0.08), (-0.03, 0, 0.05)), box((0.16, 0.12, 0.16), (0.04, 0.08, 0.15))]
    bucket = [box((0.1, 0.12, 0.02), (0.05, 0, 0)), box((0.02, 0.12, 0.1), (0.1, 0, -0.05))]
    elements = [
        link("tracks", [*tracks, box((0.2, 0.2, 0.06), (0, 0, 0.1))]),
        link("cab", cab),
        link("boom", [box((0.4, 0.05, 0.06), (0.2, 0, 0))]),
        link("stick", [box((0.3, 0.04, 0.05), (0.13, 0, 0))]),
        link("bucket", bucket),
        joint("yaw", "continuous", "tracks", "cab", (0, 0, 0.13), axis=(0, 0, 1)),
        joint("lift", "revolute", "cab", "boom", (0.12, -0.04, 0.1), axis=(0, -1, 0), limits=(-0.2, 1.2)),
        joint("reach", "revolute", "boom", "stick", (0.4, 0, 0), axis=(0, -1, 0), limits=(-2.4, -0.3)),
        joint("curl", "revolute", "stick", "bucket", (0.28, 0, 0), axis=(0, -1, 0), limits=(-1.5, 0.6)),
    ]
    return robot("excavator", elements)


def bin_with_lid(radius: float, height: float) -> str:
    """A round bin with a round lid, and a pedal."""
    elements = [
        link("bin", [cylinder(radius, height, (0, 0, height / 2)), box((0.1, 0.08, 0.02), (radius + 0.03, 0, 0.03))]),
        link("lid", [cylinder(radius, 0.03, (radius, 0, 0.015)), box((0.03, 0.06, 0.02), (2 * radius, 0, 0.035))]),
        joint("hinge", "revolute", "bin", "lid", (-radius, 0, height), axis=(0, -1, 0), limits=(0, 1.5)),
    ]
    return robot("bin_with_lid", elements)


def robot_dog() -> str:
    """A body with a head on four legs of two links."""
    elements = [link("body", [box((0.5, 0.2, 0.12), (0, 0, 0)), box((0.1, 0.14, 0.1), (0.3, 0, 0.05))])]
    for end, x in (("front", 0.2), ("rear", -0.2)):
        for name, y in ((f"{end}_left", 0.13), (f"{end}_right", -0.13)):
            elements += [
                link(f"{name}_thigh", [box((0.05, 0.04, 0.22), (0, 0, -0.1))]),
                link(f"{name}_shank", [box((0.035, 0.03, 0.22), (0, 0, -0.11)), sphere(0.025, (0, 0, -0.22))]),
                joint(
                    f"{name}_hip", "revolute", "body", f"{name}_thigh", (x, y, 0), axis=(0, 1, 0), limits=(-1.2, 1.6)
                ),
                joint(
                    f"{name}_knee",
                    "revolute",
                    f"{name}_thigh",
                    f"{name}_shank",
                    (0, 0, -0.21),
                    axis=(0, 1, 0),
                    limits=(-2.4, -0.2),
                ),
            ]
    return robot("robot_dog", elements)


def stepladder(height: float, width: float = 0.45) -> str:
    """Steps in front, rungs behind, hinged at the top."""
    rails = [box((0.03, 0.05, height), (0, side * width / 2, -height / 2)) for side in (-1, 1)]
    rungs = np.arange(0.02, height, 0.27).tolist()
    elements = [
        link("front", [*rails, *(box((0.1, width, 0.025), (0, 0, -down)) for down in rungs)]),
        link("rear", [*rails, *(box((0.03, width, 0.025), (0, 0, -down)) for down in rungs)]),
        joint("hinge", "revolute", "front", "rear", (-0.04, 0, 0), axis=(0, 1, 0), limits=(0, 0.9)),
    ]
    return robot("stepladder", elements)


def _housing(width: float, depth: float, height: float, wall: float) -> list[str]:
    """Visuals of a box of boards that is open in front, at x = 0."""
    sides = [box((depth, wall, height), (-depth / 2, side * (width - wall) / 2, height / 2)) for side in (-1, 1)]
    across = [box((depth, width, wall), (-depth / 2, 0, z)) for z in (wall / 2, height - wall / 2)]
    return [*sides, *across, box((wall, width, height), (wall / 2 - depth, 0, height / 2))]


def _open_box(width: float, depth: float, height: float, wall: float) -> list[str]:
    """Visuals of a box of boards that is open above."""
    sides = [box((depth, wall, height), (0, side * width / 2, height / 2)) for side in (-1, 1)]
    ends = [box((wall, width, height), (side * depth / 2, 0, height / 2)) for side in (-1, 1)]
    return [*sides, *ends, box((depth, width, wall), (0, 0, wall / 2))]
