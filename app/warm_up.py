"""Are the kernels compiled? Runs a tiny estimate through every stage, so that no user's estimate waits for a compiler.

What is compiled stays on disk (`NUMBA_CACHE_DIR`, or beside the source): the first run takes about a minute, one after
it seconds. `python -m app.warm_up` does it when an image is built, for each of the targets that its kernels are meant
for; the server does it as it starts.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

from app import compiled_kernels
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
FEW, MANY = 16, 500
# Searched for: a slide, as every joint more makes the search longer and takes it through nothing new.
_CHEST = """
<robot name="chest">
  <link name="body"><visual><geometry><box size="0.4 0.3 0.5"/></geometry></visual></link>
  <link name="tray"><visual><geometry><box size="0.3 0.2 0.05"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="tray"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
</robot>
"""
# Of many particles messages count the neighbours here, as they do so slowly through two axes.
_CUPBOARD = _CHEST.replace(
    "</robot>",
    """
  <link name="flap"><visual><geometry><box size="0.02 0.25 0.2"/></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="flap"/><origin xyz="0.22 0 -0.1"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>
</robot>
""",
)
# One of each: a slide, a turn, a turn without limits, two axes between one pair of parts, and a part with two children.
_WORKSHOP = _CUPBOARD.replace(
    "</robot>",
    """
  <link name="between"/>
  <link name="hand"><visual><geometry><cylinder radius="0.04" length="0.1"/></geometry></visual></link>
  <joint name="lift" type="prismatic"><parent link="tray"/><child link="between"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <joint name="swivel" type="continuous"><parent link="between"/><child link="hand"/><axis xyz="0 0 1"/></joint>
</robot>
""",
)
# As short as goes through search, belief propagation with splats, and refinement with the rasteriser: every server
# that starts makes these runs, kernels compiled or not. Messages count a part's neighbours from the second iteration.
_SEARCHED = {
    "search_iterations": 1,
    "search_proposals": 10,
    "search_islands": 1,
    "search_restarts": 0,
    "anneal_iterations": 1,
    "refine_iterations": 1,
}
_TOLD_WHERE = _SEARCHED | {"search_iterations": 0, "search_iterations_per_joint": 0}


@cache
def run() -> float:
    """Compile what is not compiled, load what is, once in a process; return the seconds it took."""
    began = time.perf_counter()
    pose = np.array([0.0, 0.0, 1.5, 0.5, 0.5, 0.5, -0.5])
    known = GaussianPrior("body", pose, np.full(3, 0.05), np.full(3, 0.1), {"slide": (0.2, 0.05)})
    robust, paper = preset("robust"), preset("paper")
    chest, cupboard, workshop = _model(_CHEST), _model(_CUPBOARD), _model(_WORKSHOP)
    _estimate(chest, pose, UniformPrior("upright"), changed(robust, _SEARCHED), FEW, iterations=3)
    _estimate(workshop, pose, known, changed(robust, _TOLD_WHERE), MANY, iterations=1)
    _estimate(cupboard, pose, known, changed(robust, _TOLD_WHERE), MANY, iterations=2)
    _estimate(workshop, pose, known, paper, FEW, iterations=2)
    lzf.lzf_decode(b"\0a", 1)  # compressed point clouds
    return time.perf_counter() - began


def _model(urdf: str) -> ArticulatedObject:
    with tempfile.TemporaryDirectory(prefix="warm-up-") as folder:
        path = Path(folder) / "warm_up.urdf"
        path.write_text(urdf, encoding="utf-8")
        return load_model(path)


def _estimate(
    model: ArticulatedObject,
    pose: poses.Array,
    prior: UniformPrior | GaussianPrior,
    settings: Settings,
    particles: int,
    iterations: int,
) -> None:
    """An estimate of the model that stands at `pose` (7,) in the frame of the camera."""
    roi = np.array([-1.0, -1.0, 0.5, 1.0, 1.0, 2.2])
    seen = observe([_scan(model, pose)], roi)
    problem = problems.build(model, seen, prior, settings, particles=particles, seed=0)
    *_, report = engine.iterate(problem, iterations)
    estimate(problem, report)


def _scan(model: ArticulatedObject, pose: poses.Array) -> Scan:
    """What a camera at the origin sees of the model, every joint a little open, in front of a wall."""
    joints = np.clip(0.2, model.lower, model.upper)
    camera = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)
    depth, _ = render(camera, prepare_surfaces(model, directions=4, points=8), model.part_poses(pose, joints))
    return Scan(camera, np.where(depth > 0, depth, np.float32(2.5)))


def main() -> None:
    """Warm up for each target that is asked for, each in a process of its own; where none is, for this processor."""
    wanted = [] if "NUMBA_CPU_NAME" in os.environ else compiled_kernels.targets()
    for target in wanted:
        environment = os.environ | compiled_kernels.for_target(target)
        subprocess.run([sys.executable, "-m", "app.warm_up"], env=environment, check=True)
        # those who read uploads import less than this, and so look for what is compiled in another folder
        reader = [sys.executable, "-m", "app.uploads.parse_worker", str(2 << 30), "60"]
        ours, theirs = socket.socketpair()
        ours.close()
        with theirs:
            subprocess.run(reader, env=environment, stdin=theirs.fileno(), stdout=subprocess.DEVNULL, check=True)
    if not wanted:
        name = os.environ.get("NUMBA_CPU_NAME", "this processor")
        sys.stdout.write(f"kernels for {name} ready after {run():.1f} s\n")


if __name__ == "__main__":
    main()
