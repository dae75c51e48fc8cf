"""Where do everyday objects stand, and how? Families of random scenes by seed, as those of `hard_scenes` are, of
objects that no part of the inference was made with (`everyday_objects`).

Of a foot, a carton, a pipe or tracks that look the same when they are turned, one turn is as good as another, and a run
that has found another than the true one is a tie.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks import everyday_objects as objects
from benchmarks.scene_rooms import HardScene, floor_scene, table_scene
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array


def _fridge(rng: np.random.Generator) -> HardScene:
    size = rng.uniform([0.7, 0.55, 1.5], [0.9, 0.7, 1.8])
    joints = {f"{side}_hinge": _shut_or(rng, 0.2, 1.5) for side in ("left", "right")}
    return _on_the_floor(rng, objects.fridge(*size), joints | {"freezer_slide": _shut_or(rng, 0.05, 0.35)}, 2.4)


def _washing_machine(rng: np.random.Generator) -> HardScene:
    urdf = objects.washing_machine(*rng.uniform([0.55, 0.5, 0.8, 0.15], [0.62, 0.62, 0.9, 0.19]))
    return _on_the_floor(rng, urdf, {"hinge": rng.uniform(0, 2.2), "slide": _shut_or(rng, 0.03, 0.2)}, 1.8)


def _office_chair(rng: np.random.Generator) -> HardScene:
    joints = {"lift": rng.uniform(0, 0.14), "swivel": rng.uniform(-np.pi, np.pi), "recline": rng.uniform(0, 0.4)}
    return _on_the_floor(rng, objects.office_chair(), joints, 1.8)


def _carton(rng: np.random.Generator) -> HardScene:
    urdf = objects.carton(*rng.uniform([0.3, 0.25, 0.2], [0.45, 0.35, 0.35]))
    joints = {f"{name}_fold": rng.uniform(0.3, 3.9) for name in ("front", "left", "back", "right")}
    return HardScene(table_scene(rng, urdf, joints, 0.0, 0.9), urdf)


def _toolbox(rng: np.random.Generator) -> HardScene:
    urdf = objects.toolbox(*rng.uniform([0.4, 0.18, 0.14], [0.5, 0.24, 0.2]))
    joints = {"hinge": rng.uniform(0, 1.8), "grip_hinge": rng.uniform(0.1, 3.0)}
    return HardScene(table_scene(rng, urdf, joints, 0.0, 0.9), urdf)


def _toilet(rng: np.random.Generator) -> HardScene:
    seat = rng.choice([0.0, 1.7]) if rng.random() < 0.6 else rng.uniform(0, 1.7)
    return _on_the_floor(rng, objects.toilet(), {"seat_hinge": seat, "lid_hinge": rng.uniform(seat, 1.72)}, 1.5)


def _valve(rng: np.random.Generator) -> HardScene:
    urdf = objects.valve(int(rng.integers(3, 6)), rng.uniform(0.1, 0.16))
    return _on_the_floor(rng, urdf, {"spin": rng.uniform(-np.pi, np.pi)}, 1.2)


def _microwave(rng: np.random.Generator) -> HardScene:
    urdf = objects.microwave(*rng.uniform([0.42, 0.3, 0.24], [0.52, 0.4, 0.3]))
    joints = {"hinge": _shut_or(rng, 0.2, 1.8), "turn": rng.uniform(-np.pi, np.pi)}
    return HardScene(table_scene(rng, urdf, joints, 0.0, 1.0), urdf)


def _dishwasher(rng: np.random.Generator) -> HardScene:
    """Racks come out where the door is down."""
    urdf = objects.dishwasher(*rng.uniform([0.55, 0.5, 0.78], [0.6, 0.58, 0.85]))
    joints = {"hinge": rng.uniform(0, 0.3), "lower_slide": 0.0, "upper_slide": 0.0}
    if rng.random() < 0.7:
        joints = {"hinge": 1.5, "lower_slide": rng.uniform(0, 0.4), "upper_slide": rng.uniform(0, 0.4)}
    return _on_the_floor(rng, urdf, joints, 1.9)


def _excavator(rng: np.random.Generator) -> HardScene:
    joints = {"yaw": rng.uniform(-np.pi, np.pi), "lift": rng.uniform(0.3, 1.1)}
    joints |= {"reach": rng.uniform(-1.6, -0.5), "curl": rng.uniform(-1.2, 0.5)}
    return _on_the_floor(rng, objects.excavator(), joints, 1.6)


def _bin_with_lid(rng: np.random.Generator) -> HardScene:
    urdf = objects.bin_with_lid(rng.uniform(0.12, 0.17), rng.uniform(0.35, 0.6))
    return _on_the_floor(rng, urdf, {"hinge": rng.uniform(0, 1.4)}, 1.4)


def _robot_dog(rng: np.random.Generator) -> HardScene:
    joints = {}
    for leg in ("front_left", "front_right", "rear_left", "rear_right"):
        hip = rng.uniform(0.3, 0.8)
        joints |= {f"{leg}_hip": hip, f"{leg}_knee": -2 * hip + rng.uniform(-0.15, 0.1)}
    return _raised(_on_the_floor(rng, objects.robot_dog(), joints, 1.5), np.array([0, 0, 0.42, 1.0, 0, 0, 0]))


def _stepladder(rng: np.random.Generator) -> HardScene:
    """Both its halves lean by as much; looked for in any orientation."""
    height, opening = rng.uniform(0.8, 1.3), rng.uniform(0.3, 0.8)
    lean = poses.from_rotation_vector(np.array([0, -opening / 2, 0]))
    stands = np.concatenate([[0, 0, height * np.cos(opening / 2)], lean])
    made = _on_the_floor(rng, objects.stepladder(height), {"hinge": opening}, 1.9)
    return replace(_raised(made, stands), orientation="any")


EVERYDAY: dict[str, Callable[[np.random.Generator], HardScene]] = {
    "fridge": _fridge,
    "washing_machine": _washing_machine,
    "office_chair": _office_chair,
    "carton": _carton,
    "toolbox": _toolbox,
    "toilet": _toilet,
    "valve": _valve,
    "microwave": _microwave,
    "dishwasher": _dishwasher,
    "excavator": _excavator,
    "bin_with_lid": _bin_with_lid,
    "robot_dog": _robot_dog,
    "stepladder": _stepladder,
}


def _shut_or(rng: np.random.Generator, least: float, most: float) -> float:
    """A joint's position: 0 in every second scene."""
    return float(rng.choice([0.0, 1.0]) * rng.uniform(least, most))


def _on_the_floor(rng: np.random.Generator, urdf: str, joints: dict[str, float], near: float) -> HardScene:
    return HardScene(floor_scene(rng, urdf, joints, near, 0.4, things=1), urdf)


def _raised(made: HardScene, pose_floor_base: Array) -> HardScene:
    """With its root's frame where it is above the place on the floor that it stands on."""
    there = poses.multiply(made.scene.pose_world_base, pose_floor_base)
    return replace(made, scene=replace(made.scene, pose_world_base=there))
