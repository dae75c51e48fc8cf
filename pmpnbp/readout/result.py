"""What are the members of `result.json`? An estimate as JSON has it; REST answers with the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.readout.estimate import Estimate, ModeEstimate
from pmpnbp.readout.members import OF_POSTERIOR, OF_RUN

SCHEMA = "pmpnbp/estimate-2"


def to_result(found: Estimate, truth: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The members of `result.json`, in its order; `truth`, what `errors` gives, comes last under that name."""
    links = {
        link.name: {
            "pose": pose_members(link.pose),
            "covariance": None if link.covariance is None else link.covariance.reshape(-1).tolist(),
            "std_xyz": None if link.std_xyz is None else link.std_xyz.tolist(),
            "expected_add": link.expected_add,
            "certain": link.certain,
            "doubts": None if link.doubts is None else list(link.doubts),
            "visible_fraction": link.visible_fraction,
            "log_likelihood": link.log_likelihood,
            "modes": [_mode_members(mode) for mode in link.modes],
            "particle_std_xyz": link.particle_std_xyz.tolist(),
            "particle_modes": [_mode_members(mode) for mode in link.particle_modes],
        }
        for link in found.links
    }
    joints = {
        entry.joint.name: {
            "type": entry.joint.kind,
            "position": number_or_list(entry.position),
            "std": None if entry.std is None else number_or_list(entry.std),
            "interval": None if entry.interval is None else number_or_list(entry.interval),
            "lower": number_or_list(entry.lower),
            "upper": number_or_list(entry.upper),
            "parent": entry.joint.parent,
            "child": entry.joint.child,
        }
        for entry in found.joints
    }
    alternatives = [
        {
            "weight": other.weight,
            "links": {
                link.name: {"pose": pose_members(pose)}
                for link, pose in zip(found.links, other.link_poses, strict=True)
            },
            "joints": {
                entry.joint.name: number_or_list(entry.joint.positions(other.joint_positions)) for entry in found.joints
            },
        }
        for other in found.alternatives
    ]
    result: dict[str, Any] = {
        "schema": SCHEMA,
        **{name: getattr(found, name) for name in (*OF_RUN, *OF_POSTERIOR)},
        "links": links,
        "joints": joints,
        "alternatives": alternatives,
        "unknown": list(found.unknown),
        "depth_noise": list(found.depth_noise),
        "depth_noise_area": list(found.depth_noise_area),
        "depth_distortion": list(found.depth_distortion),
        "nuisances": {
            entry.name: {"value": entry.value, "std": entry.std, "prior_std": entry.prior_std}
            for entry in found.nuisances
        },
    }
    return result if truth is None else result | {"truth": dict(truth)}


def pose_members(pose: Array) -> dict[str, dict[str, float]]:
    """A pose (7,) as JSON has it; the scalar part of its quaternion is not negative, so that equal poses look equal."""
    x, y, z, qw, qx, qy, qz = (pose if pose[3] >= 0 else np.concatenate([pose[:3], -pose[3:]])).tolist()
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def number_or_list(values: Array) -> Any:
    """What there is of a joint's K axes, (K, ...), as REST and result.json have it: where it has one axis, of that."""
    numbers = values.tolist()
    return numbers[0] if len(numbers) == 1 else numbers


def _mode_members(mode: ModeEstimate) -> dict[str, Any]:
    return {"weight": mode.weight, "pose": pose_members(mode.pose), "covariance": mode.covariance.reshape(-1).tolist()}
