"""Which scenes are hard? Table-tops, rows of look-alikes, two arms, distance and its noise, things in front, pictures
that cut the object off, wrong dimensions, biased depth, what hides its own foot: families of random scenes, by seed.

`hard_scene("tent", 3)` gives the scene, the URDF that the inference is given (which may be a little wrong, where that
is what makes the family hard) and the noise beyond the sensor's own. Even seeds are for tuning, odd ones for reports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.everyday_scenes import EVERYDAY
from benchmarks.furniture_scenes import kitchen_row, room_door, wardrobe_before_a_wall
from benchmarks.scene_rooms import HardScene, above_ground, floor_scene, table_scene
from pmpnbp.geometry import poses
from sample_data import models, surroundings
from sample_data.rendering import posed
from sample_data.scenes import Scene, camera_before
from sample_data.urdf_text import box, cylinder, joint, link, robot


def laptop(width: float, depth: float) -> str:
    """A flat base, 18 mm thick, and a lid hinged at its back edge: 0 shut, 1.9 rad open, pi lying flat."""
    base = [box((depth, width, 0.018), (0, 0, 0.009))]
    lid = [box((depth, width, 0.008), (depth / 2, 0, 0.004))]
    hinge = joint("hinge", "revolute", "base", "lid", (-depth / 2, 0, 0.019), axis=(0, -1, 0), limits=(0, 6.0))
    return robot("laptop", [link("base", base), link("lid", lid), hinge])


def organiser(width: float, depth: float) -> str:
    """A low box on a desk with two drawers side by side."""
    height = 0.12
    elements = [link("frame", models.carcass(width, depth, height, ()))]
    for number, side in ((1, 1), (2, -1)):
        elements.append(link(f"drawer{number}", models.drawer(width / 2, depth - 0.02, height)))
        elements.append(
            joint(
                f"slide{number}",
                "prismatic",
                "frame",
                f"drawer{number}",
                (depth / 2, side * width / 4, height / 2),
                axis=(1, 0, 0),
                limits=(0, 0.7 * depth),
            )
        )
    return robot("organiser", elements)


def two_arms(lengths: Sequence[float]) -> str:
    """A torso on a foot with two arms of hinged links, one on either side."""
    elements = [link("torso", [box((0.30, 0.34, 0.05), (0, 0, 0.025)), box((0.14, 0.22, 0.55), (0, 0, 0.32))])]
    for name, side in (("left", 1), ("right", -1)):
        parent, place, axis = "torso", (0.0, side * 0.16, 0.52), (0.0, 1.0, 0.0)
        for number, length in enumerate(lengths, start=1):
            part = f"{name}{number}"
            visuals = [
                box((0.05, 0.045, length - 0.02), (0, 0, -length / 2)),
                box((0.03, 0.03, 0.4 * length), (0.035, 0.01 * side, -0.4 * length)),
            ]
            if number == len(lengths):
                visuals.append(box((0.10, 0.07, 0.04), (0.03, 0, -length)))
            elements.append(link(part, visuals))
            elements.append(joint(f"{part}_joint", "revolute", parent, part, place, axis=axis, limits=(-2.4, 2.4)))
            parent, place = part, (0.0, 0.0, -length)
            axis = (1.0, 0.0, 0.0) if number % 2 else (0.0, 1.0, 0.0)
    return robot("two_arms", elements)


def pliers(length: float) -> str:
    """Two flat bars that cross in a joint, each bent to one side."""
    elements = []
    for name, side in (("first", 1), ("second", -1)):
        elements.append(
            link(
                name,
                [
                    box((0.6 * length, 0.022, 0.012), (-0.3 * length, side * 0.012, 0)),
                    box((0.4 * length, 0.016, 0.012), (0.2 * length, -side * 0.006, 0)),
                    cylinder(0.018, 0.014, (0, 0, 0)),
                ],
            )
        )
    elements.append(joint("pivot", "revolute", "first", "second", (0, 0, 0.012), axis=(0, 0, 1), limits=(-1.2, 0.2)))
    return robot("pliers", elements)


def monitor(upper: float, fore: float) -> str:
    """A screen that tilts on an arm of two links, lying one above the other, on a post on a foot."""
    elements = [
        link("post", [box((0.18, 0.14, 0.02), (0, 0, 0.01)), box((0.04, 0.04, 0.35), (0, 0, 0.175))]),
        link("upper", [box((upper, 0.05, 0.035), (upper / 2, 0, 0))]),
        link("fore", [box((fore, 0.045, 0.035), (fore / 2, 0, 0))]),
        link("screen", [box((0.03, 0.5, 0.3), (0.06, 0, 0)), box((0.06, 0.08, 0.08), (0.02, 0, 0))]),
        joint("shoulder", "revolute", "post", "upper", (0, 0, 0.32), axis=(0, 0, 1), limits=(-1.5, 1.5)),
        joint("elbow", "revolute", "upper", "fore", (upper, 0, 0.04), axis=(0, 0, 1), limits=(-2.3, 2.3)),
        joint("tilt", "revolute", "fore", "screen", (fore, 0, 0), axis=(0, 1, 0), limits=(-0.5, 0.5)),
    ]
    return robot("monitor", elements)


def hard_scene(family: str, seed: int, sensor: str = Scene.sensor) -> HardScene:
    """The scene of a family and a seed, before a kind of camera, one of `sensor.KINDS`. Raises KeyError for a family
    that is none of EVERY_FAMILY."""
    made = EVERY_FAMILY[family](np.random.default_rng([20, list(EVERY_FAMILY).index(family), seed]))
    return replace(made, scene=replace(made.scene, sensor=sensor))


def hidden_drawer(number: int) -> HardScene:
    """A chest seen from above, whose open top drawer hides the lower ones: those that where to look next is asked of.
    Others than the family's."""
    return _hidden(np.random.default_rng([41, number]))


def _hidden(rng: np.random.Generator) -> HardScene:
    width, depth, height = rng.uniform([0.4, 0.35, 0.6], [0.55, 0.45, 0.85])
    urdf = models.cabinet(width, depth, height, (1, 1.2, 1.4), 0.12)
    # a shallow chest's does not come out so far
    top = min(float(rng.uniform(0.2, 0.3)), models.travel(depth))
    joints = {"slide1": top, "slide2": rng.uniform(0, 0.15), "slide3": rng.uniform(0, 0.15)}
    scene = floor_scene(rng, urdf, joints, 1.2, 0.4 * height, things=1)
    camera = camera_before(scene.pose_world_base, rng.uniform(-20, 20), 0.75, height + 1.3, 0.5 * height)
    return HardScene(replace(scene, camera=camera), urdf)


def _laptop(rng: np.random.Generator, low: float, high: float) -> HardScene:
    urdf = laptop(rng.uniform(0.28, 0.38), rng.uniform(0.20, 0.26))
    return HardScene(table_scene(rng, urdf, {"hinge": rng.uniform(low, high)}, 0.0, 0.8), urdf)


def _open_laptop(rng: np.random.Generator) -> HardScene:
    return _laptop(rng, 1.2, 2.1)


def _shut_laptop(rng: np.random.Generator) -> HardScene:
    return _laptop(rng, 0.08, 0.4)


def _tent(rng: np.random.Generator) -> HardScene:
    """A laptop that stands on its two outer edges."""
    depth, half = rng.uniform(0.20, 0.26), rng.uniform(0.35, 0.6)
    urdf = laptop(rng.uniform(0.28, 0.38), depth)
    scene = table_scene(rng, urdf, {"hinge": 2 * np.pi - 2 * half}, 0.0, 0.8)
    # the base leans by its angle to the vertical, its front edge on the table
    up = np.array([0.0, 0.0, depth / 2 * np.cos(half)])
    lean = np.concatenate([up, poses.from_rotation_vector(np.array([0.0, np.pi / 2 - half, 0.0]))])
    return HardScene(replace(scene, pose_world_base=poses.multiply(scene.pose_world_base, lean)), urdf, "any")


def _lamp(rng: np.random.Generator) -> HardScene:
    count = int(rng.integers(2, 4))
    urdf = models.chain(rng.uniform(0.15, 0.25, count).tolist(), [0.04] * count, turning_base=True)
    limits = {f"hinge{n}": (-0.9, 0.9) for n in range(1, count + 1)}
    joints = above_ground(rng, urdf, limits, [f"link{n}" for n in range(2, count + 1)], 0.01)
    return HardScene(table_scene(rng, urdf, joints, 0.0, 0.9), urdf)


def _organiser(rng: np.random.Generator) -> HardScene:
    depth = rng.uniform(0.2, 0.28)
    urdf = organiser(rng.uniform(0.26, 0.36), depth)
    joints = {f"slide{n}": rng.uniform(0.0, 0.6 * depth) for n in (1, 2)}
    return HardScene(table_scene(rng, urdf, joints, 0.0, 0.8), urdf)


def _pliers(rng: np.random.Generator) -> HardScene:
    urdf = pliers(rng.uniform(0.2, 0.26))
    return HardScene(table_scene(rng, urdf, {"pivot": rng.uniform(-1.0, -0.2)}, 0.006, 0.5), urdf)


def _chest(rng: np.random.Generator, shut: float = 0.5) -> tuple[str, dict[str, float], tuple[float, float, float]]:
    width, depth, height = rng.uniform([0.4, 0.35, 0.6], [0.55, 0.45, 0.85])
    urdf = models.cabinet(width, depth, height, (1, 1.2, 1.4), 0.12)
    joints = {f"slide{n}": 0.0 if rng.random() < shut else rng.uniform(0.03, 0.26) for n in (1, 2, 3)}
    return urdf, joints, (width, depth, height)


def _look_alikes(rng: np.random.Generator) -> HardScene:
    """A nearly closed chest among closed ones of the same kind."""
    urdf, joints, (width, _, height) = _chest(rng, 0.6)
    scene = floor_scene(rng, urdf, joints, 1.7, 0.4 * height, things=0)
    beside = []
    for side in (-1, 1):
        place = poses.from_xyz_rpy([0.0, side * (width + rng.uniform(0.02, 0.06)), 0.0], [0.0, 0.0, 0.0])
        twin = posed(urdf, {}, poses.multiply(scene.pose_world_base, place))
        beside += list(twin.values())
    return HardScene(replace(scene, clutter=(*scene.clutter, *beside)), urdf)


def _two_arms(rng: np.random.Generator) -> HardScene:
    count = int(rng.integers(3, 5))
    urdf = two_arms(rng.uniform(0.16, 0.24, count).tolist())
    limits = {
        f"{name}{number}_joint": (-1.4, 0.6) if number % 2 else (-0.5, 0.5)
        for name in ("left", "right")
        for number in range(1, count + 1)
    }
    joints = above_ground(rng, urdf, limits, [name.removesuffix("_joint") for name in limits], 0.01)
    return HardScene(floor_scene(rng, urdf, joints, 1.3, 0.3, things=1), urdf)


def _long_chain(rng: np.random.Generator) -> HardScene:
    count = int(rng.integers(9, 13))
    urdf = models.chain([0.1] * count, [0.045] * count)
    joints = {f"hinge{n}": rng.uniform(-0.5, 0.5) for n in range(1, count + 1)}
    joints["hinge1"] = rng.uniform(-0.2, 0.2)
    return HardScene(floor_scene(rng, urdf, joints, 1.6, 0.5, things=1), urdf)


def _chain_of_24(rng: np.random.Generator) -> HardScene:
    count = 24
    urdf = models.chain([0.06] * count, [0.045] * count)
    limits = {f"hinge{n}": (-0.2, 0.2) if n == 1 else (-0.5, 0.5) for n in range(1, count + 1)}
    # what lies behind the first link keeps off the floor
    joints = above_ground(rng, urdf, limits, [f"link{n}" for n in range(2, count + 1)], 0.06)
    return HardScene(floor_scene(rng, urdf, joints, 1.6, 0.5, things=1), urdf)


def _far(rng: np.random.Generator) -> HardScene:
    urdf, joints, (_, _, height) = _chest(rng)
    scene = floor_scene(rng, urdf, joints, 2.9, 0.45 * height)
    return HardScene(scene, urdf, noise=rng.uniform(0.0018, 0.003))


def _in_front(rng: np.random.Generator) -> HardScene:
    """A chair in front: a seat on four legs, with a back."""
    urdf, joints, (width, depth, height) = _chest(rng)
    scene = floor_scene(rng, urdf, joints, 1.8, 0.45 * height)
    at = [depth / 2 + rng.uniform(0.4, 0.5), rng.uniform(-0.3, 0.3) * width, 0.0]
    chair = poses.multiply(scene.pose_world_base, poses.from_xyz_rpy(at, [0.0, 0.0, rng.uniform(-0.6, 0.6)]))
    pieces = [((0.36, 0.36, 0.03), (0, 0, 0.44)), ((0.03, 0.36, 0.35), (0.17, 0, 0.62))]
    pieces += [((0.035, 0.035, 0.43), (x, y, 0.215)) for x in (-0.16, 0.16) for y in (-0.16, 0.16)]
    blocks = [
        surroundings.block(np.array(size), poses.multiply(chair, poses.from_xyz_rpy(list(place), [0.0, 0.0, 0.0])))
        for size, place in pieces
    ]
    return HardScene(replace(scene, clutter=(*scene.clutter, *blocks)), urdf)


def _two_views(rng: np.random.Generator) -> HardScene:
    """Seen by two cameras, of which the second stands some millimetres from where it is said to."""
    urdf, joints, (_, _, height) = _chest(rng)
    scene = floor_scene(rng, urdf, joints, 1.5, 0.45 * height)
    aside = np.array([0.0, 0.0, rng.choice([-1, 1]) * rng.uniform(0.6, 1.0)])
    about_base = poses.multiply(
        scene.pose_world_base,
        poses.multiply(
            np.concatenate([np.zeros(3), poses.from_rotation_vector(aside)]), poses.inverse(scene.pose_world_base)
        ),
    )
    pose = poses.multiply(about_base, scene.camera.pose_world_camera)
    return HardScene(scene, urdf, further=(replace(scene.camera, pose_world_camera=pose), 0.005))


def _cut_off(rng: np.random.Generator) -> HardScene:
    """A quarter to a half of the object beyond the picture's side."""
    urdf, joints, (_, _, height) = _chest(rng)
    scene = floor_scene(rng, urdf, joints, 1.5, 0.45 * height)
    turn = poses.from_rotation_vector(np.array([0.0, rng.choice([-1, 1]) * rng.uniform(0.38, 0.46), 0.0]))
    pose = poses.multiply(scene.camera.pose_world_camera, np.concatenate([np.zeros(3), turn]))
    return HardScene(replace(scene, camera=replace(scene.camera, pose_world_camera=pose)), urdf)


def _dimensions(rng: np.random.Generator) -> HardScene:
    """The model is up to 3 % larger or smaller than what stands there, each way by another share."""
    width, depth, height = rng.uniform([0.4, 0.35, 0.6], [0.55, 0.45, 0.85])
    joints = {f"slide{n}": 0.0 if rng.random() < 0.4 else rng.uniform(0.03, 0.26) for n in (1, 2, 3)}
    there = models.cabinet(width, depth, height, (1, 1.2, 1.4), 0.12)
    scene = floor_scene(rng, there, joints, 1.6, 0.45 * height)
    wrong = np.array([width, depth, height]) * (1 + rng.uniform(-0.03, 0.03, 3))
    return HardScene(scene, models.cabinet(*wrong, (1, 1.2, 1.4), 0.12))


def _bias(rng: np.random.Generator) -> HardScene:
    urdf, joints, (_, _, height) = _chest(rng)
    scale = 1 + rng.choice([-1, 1]) * rng.uniform(0.005, 0.01)
    return HardScene(floor_scene(rng, urdf, joints, 1.6, 0.45 * height), urdf, depth_scale=scale)


def _board(rng: np.random.Generator) -> HardScene:
    """A board on the floor before the lowest drawer, which cannot be seen behind it, within reach of its slide."""
    urdf, joints, (width, depth, height) = _chest(rng)
    lowest = (height - models.BOARD) * 1.4 / 3.6
    near = rng.uniform(0.12, 0.24)
    joints["slide3"] = rng.uniform(0.0, near - 0.08)
    scene = floor_scene(rng, urdf, joints, 1.5, 0.45 * height, things=1)
    size = np.array([0.016, width * rng.uniform(0.9, 1.15), lowest * rng.uniform(0.95, 1.1)])
    place = poses.from_xyz_rpy([depth / 2 + near, rng.uniform(-0.03, 0.03), size[2] / 2], [0.0, 0.0, 0.0])
    board = surroundings.block(size, poses.multiply(scene.pose_world_base, place))
    return HardScene(replace(scene, clutter=(*scene.clutter, board)), urdf)


def _lying(rng: np.random.Generator) -> HardScene:
    """A cupboard on its back, its side or aslant, looked for in any orientation."""
    width, depth, height = rng.uniform([0.35, 0.28, 0.4], [0.45, 0.36, 0.55])
    urdf = models.cupboard(width, depth, height, shelves=(0.5,))
    scene = floor_scene(rng, urdf, {"hinge1": rng.uniform(0.3, 1.5)}, 1.6, 0.25)
    tilt = poses.from_xyz_rpy([0.0, 0.0, 0.5], [*rng.uniform(-0.6, 0.6, 2), 0.0])
    return HardScene(replace(scene, pose_world_base=poses.multiply(scene.pose_world_base, tilt)), urdf, "any")


def _monitor(rng: np.random.Generator) -> HardScene:
    """A screen that hides its arm and its post, or most of them."""
    urdf = monitor(*rng.uniform(0.2, 0.28, 2))
    joints = {"shoulder": rng.uniform(-0.8, 0.8), "elbow": rng.uniform(-1.2, 1.2), "tilt": rng.uniform(-0.3, 0.3)}
    return HardScene(table_scene(rng, urdf, joints, 0.0, 1.0), urdf)


FAMILIES: dict[str, Callable[[np.random.Generator], HardScene]] = {
    "open_laptop": _open_laptop,
    "shut_laptop": _shut_laptop,
    "tent": _tent,
    "lamp": _lamp,
    "organiser": _organiser,
    "pliers": _pliers,
    "look_alikes": _look_alikes,
    "two_arms": _two_arms,
    "long_chain": _long_chain,
    "far": _far,
    "in_front": _in_front,
    "cut_off": _cut_off,
    "dimensions": _dimensions,
    "bias": _bias,
    "lying": _lying,
    "chain_of_24": _chain_of_24,
    "hidden": _hidden,
    "board": _board,
    "room_door": room_door,
    "wardrobe": wardrobe_before_a_wall,
    "kitchen": kitchen_row,
    "monitor": _monitor,
    "two_views": _two_views,
}
# With those that are not hard, but of other objects than anything was made with.
EVERY_FAMILY = FAMILIES | EVERYDAY
