"""Which objects do the samples show? Cabinets, doors, chains and a mobile manipulator, written as URDF text.

Every object stands on z = 0 of its base link's frame, z up, and faces +x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from sample_data.urdf_text import box, cylinder, joint, link, robot

BOARD = 0.018
TRAVEL = 0.32


def carcass(width: float, depth: float, height: float, shelves: Sequence[float]) -> list[str]:
    """Visuals of an open-fronted box of boards between x = -depth / 2 and the fronts' back, with `shelves` (heights,
    metres) across it."""
    inner = depth - BOARD  # the fronts lie before the boards
    x = -BOARD / 2
    side = (width - BOARD) / 2
    visuals = [
        box((inner, BOARD, height), (x, side, height / 2)),
        box((inner, BOARD, height), (x, -side, height / 2)),
        box((BOARD, width - 2 * BOARD, height), (-depth / 2 + BOARD / 2, 0, height / 2)),
    ]
    for z in (BOARD / 2, *shelves, height - BOARD / 2):
        visuals.append(box((inner - BOARD, width - 2 * BOARD, BOARD), (0, 0, z)))
    return visuals


def drawer(width: float, depth: float, height: float) -> list[str]:
    """Visuals of a drawer whose front's outer face is x = 0 and whose front's centre is the origin: front, two sides,
    bottom and back, open at the top."""
    wall = 0.012
    length, inside = depth - 0.05, width - 2 * BOARD - 0.02
    rim = 0.75 * height
    lower = -height / 2 + 0.02
    middle = -BOARD - length / 2
    return [
        box((BOARD, width - 0.004, height - 0.004), (-BOARD / 2, 0, 0)),
        box((length, wall, rim), (middle, (inside - wall) / 2, lower + rim / 2)),
        box((length, wall, rim), (middle, -(inside - wall) / 2, lower + rim / 2)),
        box((length, inside - 2 * wall, wall), (middle, 0, lower + wall / 2)),
        box((wall, inside - 2 * wall, rim), (-BOARD - length + wall / 2, 0, lower + rim / 2)),
    ]


def handle(length: float, upright: bool = False) -> list[str]:
    """Visuals of a bar on two posts, mounted at x = 0 and standing 0.04 m out; along y, or along z if `upright`."""
    along = (0.0, 0.0, 1.0) if upright else (0.0, 1.0, 0.0)
    reach = length / 2 - 0.015
    lying = (0.0, 0.0, 0.0) if upright else (math.pi / 2, 0.0, 0.0)
    posts = [
        cylinder(0.006, 0.04, (0.02, sign * reach * along[1], sign * reach * along[2]), (0, math.pi / 2, 0))
        for sign in (-1, 1)
    ]
    return [cylinder(0.008, length, (0.04, 0, 0), lying), *posts]


def travel(depth: float) -> float:
    """How far a drawer of a cabinet `depth` metres deep comes out, metres."""
    return min(TRAVEL, depth - 0.08)


def cabinet(
    width: float = 0.45,
    depth: float = 0.40,
    height: float = 0.75,
    shares: Sequence[float] = (1, 1, 1),
    handle_length: float | None = 0.14,
) -> str:
    """URDF of a chest of drawers: `frame`, `drawer1` (the top one) … with joints `slide1` …, and links `handle1` …
    fixed to the drawers unless `handle_length` is None.

    width, depth, height : metres, outside; shares : relative heights of the drawers from the top down
    """
    free = height - BOARD
    edges = [height - BOARD / 2]
    for share in shares:
        edges.append(edges[-1] - free * share / sum(shares))
    elements = [link("frame", carcass(width, depth, height, edges[1:-1]))]
    for number, (top, bottom) in enumerate(pairwise(edges), start=1):
        name = f"drawer{number}"
        elements.append(link(name, drawer(width, depth - BOARD, top - bottom)))
        elements.append(
            joint(
                f"slide{number}",
                "prismatic",
                "frame",
                name,
                (depth / 2, 0, (top + bottom) / 2),
                axis=(1, 0, 0),
                limits=(0, travel(depth)),
            )
        )
        if handle_length is not None:
            elements.append(link(f"handle{number}", handle(handle_length)))
            elements.append(joint(f"grip{number}", "fixed", name, f"handle{number}", (0, 0, 0)))
    return robot("cabinet", elements)


def door(width: float, height: float, side: int, upright_handle: bool = True, with_handle: bool = True) -> list[str]:
    """Visuals of a door whose hinge is the z axis through the origin, at mid height; its outer face is x = 0 when
    shut. side : 1 where the hinge is at the door's +y edge, -1 at its -y edge."""
    visuals = [box((BOARD, width, height), (-BOARD / 2, -side * width / 2, 0))]
    if with_handle:
        y = -side * (width - 0.04)
        length = min(0.16, 0.6 * height)
        bar = cylinder(0.008, length, (0.04, y, 0), (0, 0, 0) if upright_handle else (math.pi / 2, 0, 0))
        reach = length / 2 - 0.015
        offsets = [(0.0, reach), (0.0, -reach)] if upright_handle else [(reach, 0.0), (-reach, 0.0)]
        posts = [cylinder(0.006, 0.04, (0.02, y + dy, dz), (0, math.pi / 2, 0)) for dy, dz in offsets]
        visuals += [bar, *posts]
    return visuals


def cupboard(
    width: float = 0.50,
    depth: float = 0.35,
    height: float = 0.70,
    doors: int = 1,
    side: int = 1,
    panel: float = 0.0,
    shelves: Sequence[float] = (0.5,),
    with_handle: bool = True,
) -> str:
    """URDF of a cupboard: `body` and one or two doors (`door1`, `door2`) on joints `hinge1`, `hinge2`, 0 to 1.9 rad.

    side : where the only door's hinge is, 1 at +y, -1 at -y; panel : width, metres, of a fixed strip beside the only
    door's free edge, as a microwave oven's controls; shelves : heights as shares of the whole
    """
    visuals = carcass(width, depth, height, [share * height for share in shelves])
    opening = width - panel
    if panel:
        y = -side * (width - panel) / 2
        visuals.append(box((BOARD, panel, height), (depth / 2 - BOARD / 2, y, 0.5 * height)))
        visuals.append(cylinder(0.02, 0.02, (depth / 2 + 0.01, y, 0.3 * height), (0, math.pi / 2, 0)))
    elements = [link("body", visuals)]
    sides = (side,) if doors == 1 else (1, -1)
    leaf = opening / doors - 0.004
    for number, hinge in enumerate(sides, start=1):
        name = f"door{number}"
        elements.append(link(name, door(leaf, height - 0.004, hinge, with_handle=with_handle)))
        elements.append(
            joint(
                f"hinge{number}",
                "revolute",
                "body",
                name,
                (depth / 2, hinge * (width / 2 - 0.002), height / 2),
                axis=(0, 0, hinge),
                limits=(0, 1.9),
            )
        )
    return robot("cupboard", elements)


def chain(lengths: Sequence[float], thickness: Sequence[float], turning_base: bool = False) -> str:
    """URDF of a desk lamp or a simple arm: `base` and links `link1` … of `lengths`, metres, hinged one to the next by
    joints `hinge1` …; the first about z if `turning_base`, the others about y. Straight up at zero.

    thickness : (len(lengths),) metres, across each link
    """
    foot = [
        box((0.24, 0.18, 0.04), (0.02, 0, 0.02)),
        box((0.07, 0.09, 0.07), (0, 0, 0.075)),
        box((0.05, 0.03, 0.03), (0.10, 0.05, 0.055)),
    ]
    elements = [link("base", foot)]
    parent, z = "base", 0.13
    for number, (length, across) in enumerate(zip(lengths, thickness, strict=True), start=1):
        name = f"link{number}"
        about_z = turning_base and number == 1
        visuals = [
            box((across, 0.7 * across, length - 0.02), (0, 0, length / 2)),
            # A rib off the middle, so that a half turn about the link's own length shows.
            box((0.5 * across, 0.6 * across, 0.3 * length), (0.6 * across, 0.2 * across, 0.35 * length)),
        ]
        if not about_z:
            visuals.append(cylinder(0.6 * across, 1.3 * across, (0, 0, 0), (math.pi / 2, 0, 0)))
        if number == len(lengths):
            visuals.append(box((0.16, 0.12, 0.05), (0.03, 0, length)))
        elements.append(link(name, visuals))
        axis = (0, 0, 1) if about_z else (0, 1, 0)
        elements.append(joint(f"hinge{number}", "revolute", parent, name, (0, 0, z), axis=axis, limits=(-2.0, 2.0)))
        parent, z = name, length
    return robot("chain", elements)
