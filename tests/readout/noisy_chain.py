"""A chain that a noisy scan shows in part: its joints are each hardly known, and tell of one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmpnbp.inference import problem as problems
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

COUNT, ROOT = 16, worlds.at(2.5, 0.0, -0.3, 0.3)
JOINTS = 0.25 * np.cos(np.arange(COUNT - 1))
# Metres, and the share of the chain's rows in the image that something else hides.
NOISE, HIDDEN = 0.008, (0.3, 0.6)


def noisy_chain() -> tuple[Problem, IterationReport]:
    """Sixteen bars that bend towards the camera, three tenths of them hidden, and a report of the truth."""
    model = worlds.hinged_chain(COUNT, 0.06, flat=True)
    parts = model.part_poses(ROOT, JOINTS)
    scan = worlds.scan(model, parts, worlds.camera_at((0.0, 0.0, 0.3), (2.5, 0.0, 0.1)))
    depth = scan.depth + np.random.default_rng(1).normal(0.0, NOISE, scan.depth.shape).astype(np.float32)
    rows = np.flatnonzero((scan.depth < scan.depth.max()).any(axis=1))
    first, last = rows[0] + (rows[-1] - rows[0]) * np.array(HIDDEN)
    depth[int(first) : int(last)] = 1.0
    roi = np.concatenate([parts[:, :3].min(axis=0) - 0.15, parts[:, :3].max(axis=0) + 0.15])
    seen = observe([replace(scan, depth=depth)], roi, up=worlds.UP)
    made = problems.build(model, seen, UniformPrior("any"), worlds.settings(), particles=20, seed=3)
    _, begun = run.begin(made)
    return made, replace(begun, iteration=12, stage="belief propagation", map_poses=parts, map_joints=JOINTS)
