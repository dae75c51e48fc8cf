"""Iterations of the sample cabinet for tests of what is drawn, made without a server."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache

from app import estimation
from app.sessions.snapshot import Snapshot, snapshot
from app.truth_file import load_truth
from app.viewer.scan_points import scan_points
from app.viewer.stage import Stage, stage
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.app.small_sessions import CABINET, QUICK, ROI


@dataclass(frozen=True)
class Scene:
    """snapshots : iterations 0, 1, …; stage : of all of them"""

    scan: Scan
    snapshots: tuple[Snapshot, ...]
    stage: Stage


@cache
def scene(seed: int = 11, iterations: int = 5) -> Scene:
    """The open cabinet with settings so small that an iteration takes milliseconds; the last ones send messages."""
    folder = CABINET / "open"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    settings = changed(preset("robust"), json.loads(json.dumps(QUICK)))
    problem, _ = estimation.prepare(CABINET / "cabinet.urdf", [scan], ROI, None, settings, particles=40, seed=seed)
    truth = load_truth(folder / "truth.json")
    step = estimation.first(problem)
    made = []
    for number in range(iterations + 1):
        step = step if number == 0 else estimation.following(step, problem)
        made.append(
            snapshot(
                problem,
                step.report,
                converged=step.converged,
                elapsed=0.0,
                event=number,
                max_std=0.0025,
                truth=truth,
            )
        )
    return Scene(scan, tuple(made), stage(problem, (scan_points(scan),)))
