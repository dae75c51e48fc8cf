"""The particle filter as slow, obvious loops: what `test_particle_filter.py` holds the fast one to."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import State
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.kernels import reference


def slow_object_score(made: Problem, part_poses: Array, tolerance: float) -> float:
    """All parts at poses (N, 7) drawn into one image, pixel by pixel, by the kernels' specification."""
    surfaces, score = made.surfaces, made.score(tolerance)
    total = 0.0
    for view in made.observation.views:
        eye = view.camera
        clouds, meshes = [], []
        for node, pose in enumerate(part_poses):
            begin, end = surfaces.vertex_offsets[node : node + 2]
            first, last = surfaces.face_offsets[node : node + 2]
            to_camera = poses.to_matrix(poses.inverse(eye.pose_world_camera)) @ poses.to_matrix(pose)
            points = surfaces.vertices[:, begin:end].T.astype(np.float64)
            clouds.append(points @ to_camera[:3, :3].T + to_camera[:3, 3])
            meshes.append(surfaces.faces[:, first:last].T)
        lens = np.array([eye.fx, eye.fy, eye.cx, eye.cy])
        terms, robust = score.terms.astype(np.float64), score.form == "robust"
        total += reference.object_score(view.depth, view.category, lens, clouds, meshes, terms, robust, view.firm)
    return total


def slow_objects(rng: np.random.Generator, made: Problem, state: State) -> list[tuple[int, Array, Array]]:
    """Ancestor, part poses (N, 7) and joints (D,) of every particle: one after the other, from the same draws."""
    plan, model, belief = made.schedule(state.iteration + 1), made.mrf.model, state.belief
    assert belief.joint_positions is not None
    offset = rng.random((1, 1)).item()
    noise = rng.standard_normal((made.particles, 6 + model.dof))
    centre = made.mrf.centres[0]
    weights = np.exp(belief.log_weights[0])
    found = []
    for k in range(made.particles):
        # the comb's k-th tooth falls into the particle in whose stretch of the cumulative weights it lies
        tooth, ancestor, passed = (k + offset) / made.particles, 0, weights[0]
        while passed < tooth:
            ancestor += 1
            passed += weights[ancestor]
        before = poses.to_matrix(belief.poses[0, ancestor])
        turn = Rotation.from_rotvec(plan.diffusion_rotation * noise[k, 3:6]).as_matrix()
        middle = before[:3, :3] @ centre + before[:3, 3] + plan.diffusion_position * noise[k, :3]
        root = np.eye(4)
        root[:3, :3] = turn @ before[:3, :3]
        root[:3, 3] = middle - root[:3, :3] @ centre
        joints = belief.joint_positions[ancestor].copy()
        for d in range(model.dof):
            levers = [
                abs(edge.multiplier[a]) * (made.mrf.radii[edge.child] if edge.revolute[a] else 1.0)
                for edge in model.edges
                for a in range(len(edge.axes))
                if edge.coordinates[a] == d
            ]
            joints[d] += plan.diffusion_position / max(levers) * noise[k, 6 + d]
            span = model.upper[d] - model.lower[d]
            if model.wraps[d]:
                joints[d] = model.lower[d] + (joints[d] - model.lower[d]) % span
            joints[d] = min(max(joints[d], model.lower[d]), model.upper[d])
        found.append((ancestor, model.part_poses(poses.from_matrix(root), joints), joints))
    return found


def slow_temperature(scores: Array, share: float) -> float:
    """The largest factor up to 1 that leaves an effective sample size of `share` of all."""

    def effective(factor: float) -> float:
        weights = np.exp(factor * (scores - scores.max()))
        return float(weights.sum() ** 2 / (weights**2).sum())

    low, high = 0.0, 1.0
    if effective(high) >= share * len(scores):
        return high
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if effective(middle) >= share * len(scores) else (low, middle)
    return low
