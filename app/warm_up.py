"""Are the kernels compiled? Runs a tiny estimate through every stage, so that no user's estimate waits for a compiler.

What is compiled stays on disk (`NUMBA_CACHE_DIR`, or beside the source): the first run takes about a minute, one after
it seconds. `python -m app.warm_up` does it when an image is built; the server does it as it starts.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run as engine
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.readout.estimate import estimate
from pmpnbp.scene import lzf
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Settings, changed, preset

# Few, and as many as make kernels use several threads, which is another kernel.
FEW, MANY = 16, 400
# One of each: a slide, a turn, a turn without limits, two axes between one pair of parts, and a part with two children.
_URDF = """
<robot name="warm_up">
  <link name="body"><visual><geometry><box size="0.4 0.3 0.5"/></geometry></visual></link>
  <link name="tray"><visual><geometry><box size="0.3 0.2 0.05"/></geometry></visual></link>
  <link name="flap"><visual><geometry><box size="0.02 0.25 0.2"/></geometry></visual></link>
  <link name="between"/>
  <link name="hand"><visual><geometry><cylinder radius="0.04" length="0.1"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="tray"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="flap"/><origin xyz="0.22 0 -0.1"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="tray"/><child link="between"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <joint name="swivel" type="continuous"><parent link="between"/><child link="hand"/><axis xyz="0 0 1"/></joint>
</robot>
"""
# A run as short as goes through search, belief propagation with splats, and refinement with the rasteriser.
_SHORT = {
    "search_iterations": 1,
    "search_iterations_per_joint": 0,
    "search_proposals": 60,
    "search_islands": 4,
    "anneal_iterations": 1,
    "refine_iterations": 1,
}


def run() -> float:
    """Compile what is not compiled, load what is; return the seconds it took."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="warm-up-") as folder:
        path = Path(folder) / "warm_up.urdf"
        path.write_text(_URDF, encoding="utf-8")
        model = load_model(path)
    pose = np.array([0.0, 0.0, 1.5, 0.5, 0.5, 0.5, -0.5])
    joints = np.clip(0.2, model.lower, model.upper)
    scan = _scan(model, pose, joints)
    robust = changed(preset("robust"), _SHORT)
    known = GaussianPrior("body", pose, np.full(3, 0.05), np.full(3, 0.1), {"slide": (0.2, 0.05)})
    _estimate(model, scan, UniformPrior("upright"), robust, FEW)
    _estimate(model, scan, known, robust, MANY)
    _estimate(model, scan, known, preset("paper"), FEW)
    lzf.lzf_decode(b"\0a", 1)  # compressed point clouds
    return time.perf_counter() - began


def _scan(model: ArticulatedObject, pose: poses.Array, joints: poses.Array) -> Scan:
    """What a camera at the origin sees of the model in front of a wall."""
    camera = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)
    depth, _ = render(camera, prepare_surfaces(model, directions=4, points=8), model.part_poses(pose, joints))
    return Scan(camera, np.where(depth > 0, depth, np.float32(2.5)))


def _estimate(
    model: ArticulatedObject, scan: Scan, prior: UniformPrior | GaussianPrior, settings: Settings, particles: int
) -> None:
    roi = np.array([-1.0, -1.0, 0.5, 1.0, 1.0, 2.2])
    problem = problems.build(model, observe([scan], roi), prior, settings, particles=particles, seed=0)
    *_, report = engine.iterate(problem, 4)
    estimate(problem, report)


if __name__ == "__main__":
    sys.stdout.write(f"kernels ready after {run():.1f} s\n")
