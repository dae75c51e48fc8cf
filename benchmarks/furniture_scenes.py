"""What belongs to a room, seen from 2.5 to 3.5 metres: a door in its wall, a wardrobe's sliding doors, a kitchen's row.

One step of a structured-light camera's depth is 2 to 4 cm there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.scene_rooms import HardScene, floor_scene
from pmpnbp.geometry import poses
from sample_data import models, surroundings
from sample_data.models import BOARD
from sample_data.rendering import posed
from sample_data.urdf_text import box, cylinder, joint, link, robot, slide

# Of a door's frame: how wide it is, how deep, and how far its wall's middle lies behind its own; metres.
FRAME, FRAME_DEPTH, RECESS = 0.07, 0.1, 0.02
WALL, CEILING, BESIDE = 0.06, 2.6, 2.0


def door(width: float, height: float) -> str:
    """A door of a room with its frame, its outer faces flush while it is shut, and a lever."""
    post = (FRAME_DEPTH, FRAME, height + FRAME)
    frame = [box(post, (0, side * (width + FRAME) / 2, post[2] / 2)) for side in (-1, 1)]
    frame.append(box((FRAME_DEPTH, width + 2 * FRAME, FRAME), (0, 0, height + FRAME / 2)))
    lever = [cylinder(0.012, 0.06, (0.03, 0, 0), (0, np.pi / 2, 0)), box((0.02, 0.13, 0.02), (0.06, 0.055, 0))]
    hinged = (FRAME_DEPTH / 2, width / 2, height / 2)
    elements = [
        link("frame", frame),
        link("leaf", [box((0.04, width, height - 0.01), (-0.02, -width / 2, 0))]),
        link("lever", lever),
        joint("hinge", "revolute", "frame", "leaf", hinged, axis=(0, 0, 1), limits=(0, 2.4)),
        joint("turn", "revolute", "leaf", "lever", (0, 0.07 - width, 0), axis=(1, 0, 0), limits=(-0.9, 0.1)),
    ]
    return robot("door", elements)


def wardrobe(width: float, depth: float, height: float) -> str:
    """A wardrobe with two doors that slide one before the other."""
    sides = [box((depth, BOARD, height), (0, side * width / 2, height / 2)) for side in (-1, 1)]
    across = [box((depth, width, BOARD), (0, 0, z)) for z in (BOARD / 2, height)]
    back, middle = box((0.008, width, height), (-depth / 2, 0, height / 2)), (depth - 0.1, BOARD, height)
    elements = [link("carcass", [*sides, *across, back, box(middle, (-0.05, 0, height / 2))])]
    leaf = (0.02, width / 2 + 0.03, height - 0.06)
    for number, side, before in ((1, 1, depth / 2 - 0.02), (2, -1, depth / 2 - 0.05)):
        grip = box((0.012, 0.03, 0.3), (0.012, side * (leaf[1] / 2 - 0.06), 0))
        at = (before, side * (width / 4 - 0.01), height / 2)
        elements.append(link(f"door{number}", [box(leaf, (0, 0, 0)), grip]))
        elements.append(slide(f"slide{number}", "carcass", f"door{number}", at, (0, -side, 0), width / 2 - 0.05))
    return robot("wardrobe", elements)


def kitchen(width: float, depth: float, height: float) -> str:
    """A row of four units under one top: two drawers, a door, two drawers, a door."""
    unit, plinth = width / 4, 0.1
    room, middle = height - plinth - 0.02, (height + plinth) / 2
    carcass = [box((depth, width, 0.03), (0, 0, height)), box((depth, width, BOARD), (0, 0, plinth))]
    carcass.append(box((0.01, width, height - plinth), (-depth / 2, 0, middle)))
    carcass += [box((depth, BOARD, height - plinth), (0, k * unit - width / 2, middle)) for k in range(5)]
    elements, front = [link("carcass", carcass)], depth / 2 + BOARD
    for k in range(4):
        y = (k + 0.5) * unit - width / 2
        if k % 2:
            at = (front, y + unit / 2 - 0.003, middle)
            elements.append(link(f"door{k}", models.door(unit - 0.006, room, 1)))
            elements.append(joint(f"hinge{k}", "revolute", "carcass", f"door{k}", at, axis=(0, 0, 1), limits=(0, 1.9)))
            continue
        for row in range(2):
            name, at = f"drawer{k}{row}", (front, y, plinth + room / 2 * (row + 0.5))
            elements.append(link(name, models.drawer(unit - 0.006, depth - 0.05, room / 2 - 0.006)))
            elements.append(slide(f"slide{k}{row}", "carcass", name, at, (1, 0, 0), 0.4))
    return robot("kitchen", elements)


def _shut_or(rng: np.random.Generator, low: float, high: float) -> float:
    return 0.0 if rng.random() < 0.5 else float(rng.uniform(low, high))


def room_door(rng: np.random.Generator) -> HardScene:
    """A door in a wall, whose frame stands 4 cm before it; where it is open one looks into the next room."""
    width, height = rng.uniform([0.75, 1.95], [0.95, 2.1])
    urdf = door(width, height)
    joints = {"hinge": _shut_or(rng, 0.2, 1.8), "turn": rng.uniform(-0.8, 0.0)}
    scene = floor_scene(rng, urdf, joints, 2.6, 1.0, things=0)
    base = scene.pose_world_base
    whole, above = width + 2 * FRAME, CEILING - height - FRAME
    pieces = [((WALL, BESIDE, CEILING), (-RECESS, side * (whole + BESIDE) / 2, CEILING / 2)) for side in (-1, 1)]
    pieces.append(((WALL, whole, above), (-RECESS, 0.0, CEILING - above / 2)))
    around = [
        surroundings.block(np.array(size), poses.multiply(base, poses.from_xyz_rpy(list(at), [0.0, 0.0, 0.0])))
        for size, at in pieces
    ]
    beyond = surroundings.wall(posed(urdf, joints, base), poses.to_rpy(base[3:])[2], rng.uniform(1.5, 3.0))
    return HardScene(replace(scene, clutter=(surroundings.floor(), beyond, *around)), urdf)


def wardrobe_before_a_wall(rng: np.random.Generator) -> HardScene:
    """Each door shut, or open by up to its half of the width."""
    width, depth, height = rng.uniform([1.2, 0.5, 1.7], [1.8, 0.62, 2.1])
    urdf = wardrobe(width, depth, height)
    joints = {name: _shut_or(rng, 0.1, width / 2 - 0.1) for name in ("slide1", "slide2")}
    return HardScene(floor_scene(rng, urdf, joints, 2.6, 0.45 * height, things=2), urdf)


def kitchen_row(rng: np.random.Generator) -> HardScene:
    """Six fronts, about half of them shut."""
    urdf = kitchen(*rng.uniform([1.8, 0.5, 0.8], [2.4, 0.6, 0.9]))
    joints = {f"slide{k}{row}": _shut_or(rng, 0.05, 0.35) for k in (0, 2) for row in (0, 1)}
    joints |= {f"hinge{k}": _shut_or(rng, 0.1, 1.6) for k in (1, 3)}
    return HardScene(floor_scene(rng, urdf, joints, 2.5, 0.4, things=2), urdf)
