"""From where is a view looked at, by the place's name? From where all of it fits, from the sensor, from above."""

from __future__ import annotations

import numpy as np

from app.viewer.gizmos import box_corners
from app.viewer.stage import Shape, Stage, triple
from app.viewer.view_state import Eye, Look, ViewState
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array

# Vertical field of view of a browser's camera, radians, where nothing else is asked for.
FIELD_OF_VIEW = float(np.radians(36))
# Width over height of a picture that nobody has told of.
ASPECT = 1.5
# How much farther than where it just fits.
ROOM = 1.12
# Radians from straight above: what is up in the picture is still known there.
TILT = 0.01


def place(look: Look, part_poses: Array, state: ViewState, stage: Stage, aspect: float | None) -> Eye:
    """The eye of that name. part_poses : (N, 7), where the estimate has the parts; aspect : of the picture, width over
    height, None where that is not known"""
    aspect = ASPECT if aspect is None else aspect
    if look == "sensor":
        return _sensor(stage, aspect)
    up, points = stage.up, _to_be_seen(part_poses, state, stage)
    if look == "top":
        ahead = poses.rotate(stage.scans[0].camera.pose_world_camera[3:], np.array([0.0, 0.0, 1.0]))
        level = ahead - (ahead @ up) * up
        if np.linalg.norm(level) < 1e-3:  # the sensor looks down, too: what is up in its picture is up in this one
            level = poses.rotate(stage.scans[0].camera.pose_world_camera[3:], np.array([0.0, -1.0, 0.0]))
            level -= (level @ up) * up
        return framed(points, TILT * level / np.linalg.norm(level) - up, up, aspect)
    eye = state.camera or stage.eye
    return framed(points, np.array(eye.look_at) - np.array(eye.position), up, aspect)


def framed(points: Array, towards: Array, up: Array, aspect: float) -> Eye:
    """The eye that looks in a direction `towards` (3,) and has all of `points` (P, 3) in the picture."""
    forward = towards / np.linalg.norm(towards)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # straight up or down: any side may be right
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    seen = points @ axes.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    offset = seen - middle
    half = np.tan(FIELD_OF_VIEW / 2)
    needed = np.abs(offset[:, :2]) / np.array([half * aspect, half])
    distance = ROOM * max(float((needed - offset[:, 2:]).max()), 1e-2)
    centre = middle @ axes
    return Eye(position=triple(centre - distance * forward), look_at=triple(centre), up=triple(up))


def _to_be_seen(part_poses: Array, state: ViewState, stage: Stage) -> Array:
    """(P, 3): the corners of the region where it is shown, else of the parts' boxes, with the ruler."""
    if state.show.region and state.region is not None:
        return box_corners(np.array(state.region))
    shapes = zip(stage.shapes, part_poses, strict=True)
    found = [poses.transform_points(pose, _corners(shape)) for shape, pose in shapes if shape is not None]
    if state.show.ruler and stage.ruler is not None:
        found.append(stage.ruler.segments.reshape(-1, 3).astype(np.float64))
    return np.concatenate(found)


def _corners(shape: Shape) -> Array:
    """(8, 3) of the box around a part, in its own frame."""
    triangles = shape.corners.astype(np.float64)
    return box_corners(np.concatenate([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))]))


def _sensor(stage: Stage, aspect: float) -> Eye:
    """From the first scan's camera: its whole image is in the picture. A principal point beside the middle is not
    followed."""
    camera = stage.scans[0].camera
    position, turn = camera.pose_world_camera[:3], camera.pose_world_camera[3:]
    ahead, up = (poses.rotate(turn, np.array(axis)) for axis in ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)))
    # about the point ahead that is nearest to the object it is turned
    distance = max(float((np.array(stage.eye.look_at) - position) @ ahead), 0.1)
    half = max(camera.height / camera.fy, camera.width / camera.fx / aspect) / 2
    return Eye(
        position=triple(position),
        look_at=triple(position + distance * ahead),
        up=triple(up),
        field_of_view=float(np.clip(2 * np.arctan(half), 0.02, 2.8)),
    )
