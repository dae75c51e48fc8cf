"""Objects and scenes small enough that the answer is known: what the tests of the inference are played on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.belief import SURFACE
from pmpnbp.inference.hypotheses import Hypotheses
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge, Joint, Mesh
from pmpnbp.scene.meshes import box, transformed
from pmpnbp.scene.observation import Observation, Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.parts import LinkSurface, assemble
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.sizes import axes_at_zero, resized
from pmpnbp.settings import Settings, changed, preset

UP = np.array([0.0, 0.0, 1.0])
X, Y, Z = np.eye(3)
# No object at all: for nodes whose unary potential a test gives itself.
NOTHING_SEEN = Observation((), np.zeros((1, 3)), UP[None], np.zeros((0, 4)), UP, None)


def at(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0
) -> Array:
    """A pose (7,)."""
    return poses.from_xyz_rpy([x, y, z], [roll, pitch, yaw])


def block(size: Sequence[float], centre: Array | None = None) -> LinkSurface:
    """A box of `size` (3,), metres, with its middle at the pose `centre` (7,) of its link."""
    mesh = box(size)
    return LinkSurface(exact=(mesh if centre is None else transformed(mesh, centre),))


def articulated(
    joints: Sequence[Joint], surfaces: dict[str, LinkSurface], root: str = "link0", budget: int = 500
) -> ArticulatedObject:
    """An object of joints whose coordinates are already counted; links not in `surfaces` have no geometry."""
    links = [root, *(joint.child for joint in joints)]
    return assemble("small", root, tuple(joints), {k: surfaces.get(k, LinkSurface()) for k in links}, budget, 1.0)


def sliding_chain(count: int, offset: float = 0.3, half_range: float = 0.05) -> ArticulatedObject:
    """`count` blocks in a row along x, each sliding along x by ±half_range about `offset` metres off the one before."""
    joints = [
        Joint(f"slide{k}", "prismatic", f"link{k - 1}", f"link{k}", at(offset), X, -half_range, half_range, (k - 1,))
        for k in range(1, count)
    ]
    return articulated(joints, {f"link{k}": block([0.1, 0.1, 0.1]) for k in range(count)})


def hinged_chain(count: int, length: float = 0.2, *, limit: float = 1.2, flat: bool = False) -> ArticulatedObject:
    """`count` bars along z, each hinged at the far end of the one before, about y and x in turn, or `flat` about y."""
    joints = [
        Joint(
            f"hinge{k}",
            "revolute",
            f"link{k - 1}",
            f"link{k}",
            at(z=length),
            Y if flat or k % 2 else X,
            -limit,
            limit,
            (k - 1,),
        )
        for k in range(1, count)
    ]
    bar = block([0.06, 0.05, length], at(z=length / 2))
    return articulated(joints, {f"link{k}": bar for k in range(count)})


def star(arms: int) -> ArticulatedObject:
    """A block from which `arms` others go out: slides and hinges in turn."""
    joints = []
    for k in range(1, arms + 1):
        kind, lower, upper = ("prismatic", 0.0, 0.2) if k % 2 else ("revolute", -0.7, 0.9)
        turn = 2 * np.pi * k / arms
        joints.append(Joint(f"arm{k}", kind, "link0", f"link{k}", at(0.1 * k, yaw=turn), X, lower, upper, (k - 1,)))
    return articulated(joints, {f"link{k}": block([0.1, 0.08, 0.06]) for k in range(arms + 1)})


def cupboard() -> ArticulatedObject:
    """A box with a plinth, a drawer (slides along x by 0 to 0.25 m) and a flap (hinged, 0 to 1.5 rad): no symmetry."""
    joints = [
        Joint("slide", "prismatic", "link0", "link1", at(0.16, 0.0, 0.09), X, 0.0, 0.25, (0,)),
        Joint("hinge", "revolute", "link0", "link2", at(0.16, -0.19, 0.28), -Z, 0.0, 1.5, (1,)),
    ]
    return articulated(
        joints,
        {
            "link0": block([0.3, 0.4, 0.4], at(z=0.2)),
            "link1": block([0.02, 0.36, 0.16], at(0.01)),
            "link2": block([0.02, 0.36, 0.18], at(0.01, 0.18)),
        },
    )


def cupboard_truth() -> tuple[Array, Array]:
    """Root pose (7,) and joints (2,) of the cupboard in the scene that the tests look at."""
    return at(1.4, 0.1, 0.0, yaw=np.pi - 0.35), np.array([0.18, 0.6])


def larger(model: ArticulatedObject, sizes: Array) -> ArticulatedObject:
    """A model made anew with all its lengths, surfaces too, larger by shares `sizes` (3,) along the root's axes."""
    made = resized(model, sizes)
    stretches = [axes.T @ np.diag(1 + sizes) @ axes for axes in axes_at_zero(model)]
    return replace(
        made,
        parts=tuple(
            replace(part, mesh=mesh, inference_mesh=mesh)
            for part, stretch in zip(made.parts, stretches, strict=True)
            for mesh in [Mesh(part.inference_mesh.vertices @ stretch, part.inference_mesh.faces)]
        ),
    )


def four_bar(width: float = 0.35, height: float = 0.25) -> ArticulatedObject:
    """A parallelogram of four bars hinged about x: a tree of three hinges, and a fourth that closes the loop.

    Bars: link0 the lower one, along y; link1 and link3 stand on its ends; link2 joins their upper ends. The joint
    vector is that of the tree link0 → link1 → link2 and link0 → link3; a closed loop has (q, -q, q).
    """
    upright, lying = block([0.06, 0.04, height], at(z=height / 2)), block([0.05, width, 0.05], at(y=width / 2))
    joints = [
        Joint("left", "revolute", "link0", "link1", at(), X, -0.9, 0.9, (0,)),
        Joint("top", "revolute", "link1", "link2", at(z=height), X, -0.9, 0.9, (1,)),
        Joint("right", "revolute", "link0", "link3", at(y=width), X, -0.9, 0.9, (2,)),
    ]
    tree = articulated(joints, {"link0": lying, "link1": upright, "link2": lying, "link3": upright})
    number = {part.name: k for k, part in enumerate(tree.parts)}
    closing = Edge(
        parent=number["link3"],
        child=number["link2"],
        poses_before=at(z=height)[None],
        pose_after=at(y=-width),
        revolute=np.array([True]),
        axes=X[None],
        lower=np.array([-0.9]),
        upper=np.array([0.9]),
        wraps=np.array([False]),
        coordinates=np.array([1]),
        multiplier=np.ones(1),
        offset=np.zeros(1),
    )
    return replace(tree, edges=(*tree.edges, closing))


def camera_at(eye: Sequence[float], target: Sequence[float], width: int = 160, height: int = 120) -> Camera:
    """A camera of 60° that looks from `eye` (3,) to `target` (3,), world z up in its picture."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = eye
    focal = width / (2 * np.tan(np.deg2rad(30)))
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, poses.from_matrix(matrix))


def scan(model: ArticulatedObject, part_poses: Array, camera: Camera, background: float = 4.0) -> Scan:
    """A noiseless depth image of parts at poses (N, 7) before a background `background` metres off."""
    depth, _ = render(camera, prepare_surfaces(model, points=64), part_poses)
    return Scan(camera, np.where(np.isfinite(depth) & (depth > 0), depth, background).astype(np.float32))


def seen(
    model: ArticulatedObject, root: Array, joints: Array, camera: Camera | None = None, margin: float = 0.1
) -> Observation:
    """What is observed of an object alone in the air, its box and `margin` metres around being the region."""
    part_poses = model.part_poses(root, joints)
    vertices = np.concatenate(
        [poses.transform_points(pose, part.mesh.vertices) for pose, part in zip(part_poses, model.parts, strict=True)]
    )
    roi = np.concatenate([vertices.min(axis=0) - margin, vertices.max(axis=0) + margin])
    view = camera or camera_at((0.0, 0.0, 0.7), vertices.mean(axis=0))
    return observe([scan(model, part_poses, view)], roi, up=UP)


def settings(name: str = "robust", **changes: object) -> Settings:
    """A preset with changes."""
    return changed(preset(name), changes)


def rough_prior(rng: np.random.Generator, root: Array, link: str = "link0") -> GaussianPrior:
    """A prior that is 8 cm and 8.6 degrees per axis about right, drawn so that its own truth is `root`."""
    spread = np.full(3, 0.08), np.full(3, 0.15)
    pose = poses.perturb(root, spread[0] * rng.standard_normal(3), spread[1] * rng.standard_normal(3))
    return GaussianPrior(link, pose, *spread, {})


# log unary potential (B,) of parts (B,) at poses (B, 7)
Unary = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True)
class GivenUnary(Problem):
    """A problem whose unary potential is a formula, not a picture."""

    formula: Unary

    def unary(self, node: Array, part_poses: Array, tolerance: float, renderer: str, points: int = 0) -> Array:
        """As `Problem.unary`; whatever the tolerance and the renderer."""
        return self.formula(np.asarray(node), part_poses)


def given_unary(
    model: ArticulatedObject,
    formula: Unary,
    settings: Settings,
    *,
    prior: UniformPrior | GaussianPrior | None = None,
    particles: int = 6,
    seed: int = 0,
) -> GivenUnary:
    """A problem of `model` whose log unary potential is `formula`."""
    built = problems.build(
        model, NOTHING_SEEN, prior or UniformPrior("upright"), settings, particles=particles, seed=seed
    )
    return GivenUnary(**vars(built), formula=formula)


def hypotheses(scene: Problem, roots: Array, joints: Array) -> Hypotheses:
    """Whole objects at roots (H, 7) and joints (H, D), each an island of its own, of whose parts nothing is known."""
    return Hypotheses(
        roots=roots,
        joints=joints,
        source=np.full(len(roots), SURFACE, dtype=np.uint8),
        ancestor=np.arange(len(roots), dtype=np.int32),
        held=np.zeros(len(roots), dtype=np.int64),
        unary=np.zeros((len(roots), scene.mrf.nodes)),
        part_poses=scene.mrf.part_poses(roots, joints),
    )
