"""How far is an estimate from the truth? ADD of every part and the joints' errors, where the truth is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.estimate import Estimate
from pmpnbp.readout.metrics import add, add_s, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject


def errors(
    model: ArticulatedObject, found: Estimate, true_links: Mapping[str, Array], true_joints: Mapping[str, float]
) -> dict[str, Any]:
    """How far the estimate is from the truth: ADD and ADD-S (metres) of each visible part whose link poses (7,) are in
    `true_links`, and for the joints in `true_joints` estimate minus truth, metres or radians."""
    parts: dict[str, dict[str, float]] = {}
    for index, truth in _true_parts(model, true_links):
        points, at = model_points(model.parts[index].mesh), found.part_poses[index]
        parts[model.parts[index].name] = {"add": add(points, at, truth), "add_s": add_s(points, at, truth)}
    return {"parts": parts, "joints": _joint_errors(found, true_joints)}


def part_adds(model: ArticulatedObject, part_poses: Array, true_links: Mapping[str, Array]) -> dict[str, float]:
    """ADD (metres) of part poses (N, 7): of those parts that `errors` judges, by name."""
    return {
        model.parts[index].name: add(model_points(model.parts[index].mesh), part_poses[index], truth)
        for index, truth in _true_parts(model, true_links)
    }


def _true_parts(model: ArticulatedObject, true_links: Mapping[str, Array]) -> Iterator[tuple[int, Array]]:
    """Each visible part of which the truth names a link, by index, and its pose (7,) in world."""
    for index, part in enumerate(model.parts):
        known = next((link for link in part.links if link in true_links), None)
        if known is not None and part.visible:
            pose_part_link = part.poses_part_link[part.links.index(known)]
            yield index, poses.multiply(true_links[known], poses.inverse(pose_part_link))


def _joint_errors(found: Estimate, true_joints: Mapping[str, float]) -> dict[str, float]:
    differences = {}
    for entry in found.joints:
        if len(entry.position) == 1 and entry.joint.name in true_joints:
            difference = float(entry.position[0]) - true_joints[entry.joint.name]
            if entry.joint.kind == "continuous":
                difference -= 2 * np.pi * round(difference / (2 * np.pi))
            differences[entry.joint.name] = difference
    return differences
