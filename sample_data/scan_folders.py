"""How is a scene kept? A folder with depth.png, camera.json, truth.json and roi.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from sample_data.rendering import Truth

ROI_MARGIN = 0.10
PRIOR_STD_METRES = 0.08
PRIOR_STD_DEGREES = 8.6


def _numbers(values: Any, digits: int = 9) -> Any:
    return np.round(np.asarray(values, dtype=np.float64), digits).tolist()


def write_json(path: Path, value: dict[str, Any]) -> None:
    """`value` as JSON, one entry of the outermost level a line."""
    entries = (f" {json.dumps(key)}: {json.dumps(entry)}" for key, entry in value.items())
    path.write_text("{\n" + ",\n".join(entries) + "\n}\n")


def write_scan(folder: Path, depth: NDArray[np.uint16], camera: Camera, truth: Truth) -> None:
    """Write the four files of a scene into `folder`, which is made. depth : (height, width), millimetres."""
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(depth).save(folder / "depth.png")
    write_json(
        folder / "camera.json",
        {
            "width": camera.width,
            "height": camera.height,
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "T_world_camera": _numbers(poses.to_matrix(camera.pose_world_camera).ravel()),
            "frame_id": "world",
        },
    )
    write_json(
        folder / "truth.json",
        {
            "joints": {name: round(position, 9) for name, position in truth.joints.items()},
            "links": {name: _numbers(matrix) for name, matrix in truth.links.items()},
            "visible_fraction": {name: round(share, 4) for name, share in truth.visible_fraction.items()},
            "pixels_alone": truth.pixels_alone,
        },
    )
    margin = np.repeat([-ROI_MARGIN, ROI_MARGIN], 3)
    write_json(folder / "roi.json", {"roi": _numbers(truth.bounds + margin, 4)})


def write_prior(
    path: Path,
    link: str,
    pose_world_link: NDArray[np.float64],
    rng: np.random.Generator,
    metres: float = PRIOR_STD_METRES,
    degrees: float = PRIOR_STD_DEGREES,
) -> None:
    """A gaussian prior on `link` with these standard deviations per axis, whose mean is one draw of itself about the
    true pose (7,)."""
    turn = poses.from_rotation_vector(rng.normal(0.0, np.deg2rad(degrees), 3))
    position = pose_world_link[:3] + rng.normal(0.0, metres, 3)
    w, x, y, z = _numbers(poses.quaternion_multiply(turn, pose_world_link[3:]))
    px, py, pz = _numbers(position)
    write_json(
        path,
        {
            "kind": "gaussian",
            "link": link,
            "pose": {"position": {"x": px, "y": py, "z": pz}, "orientation": {"x": x, "y": y, "z": z, "w": w}},
            "std_xyz": [metres] * 3,
            "std_rpy": _numbers([np.deg2rad(degrees)] * 3, 6),
        },
    )
