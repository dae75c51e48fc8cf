"""Write the sample data again: `python sample_data/generate.py [FOLDER]`, by default beside this file."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))  # run as a script, from anywhere

from pmpnbp.geometry import poses  # noqa: E402
from sample_data import mobile_manipulator, models, surroundings  # noqa: E402
from sample_data.rendering import posed  # noqa: E402
from sample_data.scan_folders import write_prior  # noqa: E402
from sample_data.scenes import Scene, camera_before, write_scene  # noqa: E402

Array = NDArray[np.float64]
CABINET_SCENES = ("open", "self_occluded", "arm", "blanket", "closed", "from_above")
ROBOT_SCANS = ("scan_0", "scan_1", "partial")

# Per scene: drawers (metres), where the cabinet stands (x, y, yaw in degrees), camera (degrees off the cabinet's
# front, metres from its middle on the floor plan, metres above the floor).
_CABINET = {
    "open": ((0.24, 0.10, 0.17), (0.30, 0.20, 28.0), (24.0, 1.45, 1.30)),
    "self_occluded": ((0.30, 0.05, 0.16), (-0.40, 0.60, -33.0), (-14.0, 1.35, 1.60)),
    "arm": ((0.05, 0.20, 0.12), (0.10, -0.50, 38.0), (-22.0, 1.55, 1.10)),
    "blanket": ((0.14, 0.06, 0.02), (0.70, 0.10, 204.0), (18.0, 1.50, 1.20)),
    "closed": ((0.0, 0.0, 0.0), (-0.20, -0.30, -24.0), (28.0, 1.40, 1.00)),
    "from_above": ((0.30, 0.0, 0.0), (-0.10, 0.50, 15.0), (6.0, 1.10, 1.75)),
}
# A further scan of the same scene: its folder, and its camera.
_SECOND_VIEWS = {"self_occluded": ("second_view", (38.0, 1.6, 0.9)), "from_above": ("lowered", (6.0, 1.10, 1.30))}

# Joint positions in the order of the robot's joints, base and camera as above.
_ROBOT = {
    "scan_0": ((0.10, -0.4, 0.3, -0.7, 0.4, 0.5, 1.3, 0.4, 0.9, 0.6, 0.06), (0.20, -0.30, 35.0), (28.0, 2.05, 1.35)),
    "scan_1": (
        (0.22, 0.5, 0.1, -0.8, -0.3, -0.6, 1.5, 0.8, -0.7, -0.4, 0.03),
        (-0.50, 0.40, -62.0),
        (-30.0, 2.1, 1.50),
    ),
    "partial": ((0.16, 0.35, -0.2, 0.8, 0.1, -0.9, 1.1, -0.5, 1.0, 0.3, 0.05), (0.35, 0.20, 118.0), (24.0, 2.1, 1.40)),
}
# Links whose covers swallow most of the sensor's pattern, by scan.
_DARK = {"partial": ("base", "torso", "head_pan", "head_tilt")}
_DOOR = ((1.05,), (0.15, 0.35, 31.0), (16.0, 1.55, 1.25))


def _blanket_profile(out: float) -> Array:
    """(K, 2), x and z in the cabinet's frame: over the top drawer's front, its outer face at x = `out`, and down."""
    return np.array(
        [
            [out - 0.10, 0.62],
            [out - 0.05, 0.735],
            [out, 0.755],
            [out + 0.03, 0.735],
            [out + 0.06, 0.66],
            [out + 0.065, 0.45],
            [out + 0.055, 0.28],
        ]
    )


def _in_front(scene: str, pose_world_base: Array) -> list[trimesh.Trimesh]:
    """What stands between the cabinet and the camera."""
    if scene == "arm":
        base_points = np.array(
            [[0.55, -0.62, 0.0], [0.55, -0.62, 0.55], [0.62, -0.22, 0.72], [0.48, 0.02, 0.42], [0.40, 0.06, 0.36]]
        )
        joints = poses.transform_points(pose_world_base, base_points)
        return surroundings.arm(joints, np.array([0.06, 0.045, 0.04, 0.03]))
    if scene == "blanket":
        profile = _blanket_profile(0.20 + _CABINET["blanket"][0][0])
        return [surroundings.cloth(profile, -0.02, 0.25, pose_world_base)]
    return []


def _scene(
    urdf: str,
    joints: dict[str, float],
    place: tuple[float, float, float],
    view: tuple[float, float, float],
    aim: float,
    rng: np.random.Generator,
    folder: Path | None = None,
) -> Scene:
    """The object at `place`, seen by the camera `view`, with floor, wall and clutter."""
    x, y, yaw = place
    pose = surroundings.standing_at(x, y, np.deg2rad(yaw))
    surfaces = posed(urdf, joints, pose, folder)
    camera = camera_before(pose, *view, aim=aim)
    if not surroundings.in_view(surfaces, camera):
        raise ValueError(f"the object at {place} is not wholly in view of the camera {view}")
    around = [
        surroundings.floor(),
        surroundings.wall(surfaces, np.deg2rad(yaw + rng.uniform(-6, 6)), rng.uniform(0.08, 0.25)),
        *surroundings.clutter(surfaces, pose, 3, rng),
    ]
    return Scene(urdf, joints, pose, camera, tuple(around), folder)


def _cabinet_scene(folder: Path, name: str, urdf: str) -> None:
    slides, place, view = _CABINET[name]
    rng = np.random.default_rng([1, CABINET_SCENES.index(name)])
    joints = {f"slide{number}": slide for number, slide in enumerate(slides, start=1)}
    scene = _scene(urdf, joints, place, view, 0.36, rng)
    around = (*scene.clutter, *_in_front(name, scene.pose_world_base))
    scene = Scene(urdf, joints, scene.pose_world_base, scene.camera, around)
    write_scene(folder / name, scene, rng)
    if name in _SECOND_VIEWS:
        second_name, view = _SECOND_VIEWS[name]
        second = camera_before(scene.pose_world_base, *view, aim=0.36)
        write_scene(folder / second_name, Scene(urdf, joints, scene.pose_world_base, second, around), rng)
    write_prior(folder / name / "prior.json", "frame", scene.pose_world_base, rng)
    if name == "open":
        (folder / "prior.json").write_text((folder / name / "prior.json").read_text())


def write_cabinet(folder: Path, scenes: tuple[str, ...] = CABINET_SCENES) -> None:
    """The cabinet's URDF, prior and `scenes` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    urdf = models.cabinet()
    (folder / "cabinet.urdf").write_text(urdf)
    for name in scenes:
        _cabinet_scene(folder, name, urdf)


def write_robot(folder: Path) -> None:
    """The robot's URDF, its head's mesh and its scans into `folder`."""
    mesh = folder / mobile_manipulator.HEAD_FILE
    mesh.parent.mkdir(parents=True, exist_ok=True)
    mesh.write_text(mobile_manipulator.head_obj())
    urdf = mobile_manipulator.urdf()
    (folder / "robot.urdf").write_text(urdf)
    for index, name in enumerate(ROBOT_SCANS):
        positions, place, view = _ROBOT[name]
        rng = np.random.default_rng([2, index])
        joints = dict(zip(mobile_manipulator.joint_names(), positions, strict=True))
        scene = replace(_scene(urdf, joints, place, view, 0.60, rng, folder), dark=_DARK.get(name, ()))
        write_scene(folder / name, scene, rng)
        write_prior(folder / name / "prior.json", "base", scene.pose_world_base, rng, metres=0.10, degrees=10.0)


def write_door(folder: Path) -> None:
    """The cupboard's URDF and one scene into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    urdf = models.cupboard()
    (folder / "door.urdf").write_text(urdf)
    (angle,), place, view = _DOOR
    rng = np.random.default_rng(3)
    scene = _scene(urdf, {"hinge1": angle}, place, view, 0.36, rng)
    write_scene(folder / "ajar", scene, rng)
    write_prior(folder / "ajar" / "prior.json", "body", scene.pose_world_base, rng)


def main() -> None:
    """Write everything."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    write_cabinet(folder / "cabinet")
    write_robot(folder / "robot")
    write_door(folder / "door")


if __name__ == "__main__":
    main()
