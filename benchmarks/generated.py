"""Which objects have just so many parts? Chests of drawers and chains of hinged links, seen without noise.

They are for measuring speed: a chest's parts all hang on one, a chain's each on the one before.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.trials import Case, surface_points
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.inference.problem import look
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Settings
from sample_data import models, urdf_text
from sample_data.scenes import camera_before

MARGIN = 0.10
# A drawer's cell in a chest: width and height, metres.
CELL = (0.30, 0.20)
DEPTH = 0.35


@dataclass(frozen=True)
class Generated:
    """An object's URDF, how far its joints are moved (D,), metres or radians, and its height, metres."""

    urdf: str
    joint_positions: Array
    height: float


def chest(parts: int) -> Generated:
    """A frame and `parts` - 1 drawers, in a grid that is about square; the last row may be short."""
    drawers = parts - 1
    columns = math.ceil(math.sqrt(drawers))
    rows = math.ceil(drawers / columns)
    width, height = columns * CELL[0], rows * CELL[1]
    elements = [urdf_text.link("frame", models.carcass(width, DEPTH, height, ()))]
    for number in range(drawers):
        row, column = divmod(number, columns)
        place = (DEPTH / 2, (column + 0.5) * CELL[0] - width / 2, height - (row + 0.5) * CELL[1])
        elements.append(urdf_text.link(f"drawer{number}", models.drawer(CELL[0], DEPTH, CELL[1])))
        elements.append(
            urdf_text.joint(
                f"slide{number}",
                "prismatic",
                "frame",
                f"drawer{number}",
                place,
                axis=(1, 0, 0),
                limits=(0, models.travel(DEPTH)),
            )
        )
    # neighbours stand out by different lengths, so that their fronts can be told apart
    out = 0.03 * (1.0 + np.arange(drawers, dtype=np.float64) % 5)
    return Generated(urdf_text.robot("chest", elements), out, height)


def chain(parts: int) -> Generated:
    """A foot and `parts` - 1 links that zigzag upward."""
    links = parts - 1
    lengths = [max(0.06, 0.9 / links)] * links
    bends = np.where(np.arange(links) % 2 == 0, 0.5, -0.5)
    bends[0] = 0.25
    return Generated(models.chain(lengths, [0.05] * links), bends, sum(lengths) + 0.13)


KINDS: dict[str, Callable[[int], Generated]] = {"chest": chest, "chain": chain}


def generated_case(kind: str, parts: int, settings: Settings) -> Case:
    """The chest or chain of that many parts on a floor, before a camera that sees all of it."""
    made = KINDS[kind](parts)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.urdf"
        path.write_text(made.urdf, encoding="utf-8")
        model = load_model(path, triangle_budget=settings.triangles)
    true_poses = model.part_poses(IDENTITY, made.joint_positions)
    surfaces = prepare_surfaces(model)
    camera = camera_before(IDENTITY, 25.0, 1.0 + 1.6 * made.height, 0.4 + 0.7 * made.height, made.height / 2)
    drawn, _ = render(camera, surfaces, true_poses)
    floor = _floor_depth(camera)
    depth = np.where(drawn > 0, np.where(floor > 0, np.minimum(drawn, floor), drawn), floor)
    corners = [
        poses.transform_points(pose, part.mesh.vertices) for pose, part in zip(true_poses, model.parts, strict=True)
    ]
    everything = np.concatenate(corners)
    roi = np.concatenate([everything.min(axis=0) - MARGIN, everything.max(axis=0) + MARGIN])
    observation = look(model, [Scan(camera, depth.astype(np.float32))], roi, settings)
    count = len(model.parts)
    return Case(
        f"{kind}_{parts}",
        model,
        observation,
        true_poses,
        {},
        {},
        np.ones(count),
        np.zeros(count, dtype=np.bool_),
        surface_points(model),
    )


def _floor_depth(camera: Camera) -> Array:
    """(h, w) metres along the optical axis to the plane z = 0, up to 8 m away; 0 beyond."""
    rays = poses.rotate(camera.pose_world_camera[3:], camera.rays().astype(np.float64))
    with np.errstate(divide="ignore"):
        depth = -camera.pose_world_camera[2] / rays[..., 2]
    return np.where((depth > 0) & (depth < 8.0), depth, 0.0)
