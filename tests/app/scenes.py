"""Iterations of the sample cabinet for tests of what is drawn, made without a server."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache

from app.viewer.scan_points import scan_points
from app.viewer.stage import Stage, stage
from pmpnbp.inference import run as engine
from pmpnbp.readout.snapshot import Criteria, Snapshot, snapshot
from pmpnbp.recording import prepare
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.truth_file import load_truth
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
    problem, _ = prepare(CABINET / "cabinet.urdf", [scan], ROI, None, settings, particles=40, seed=seed)
    criteria = Criteria(max_std=0.0025, truth=load_truth(folder / "truth.json"))
    snapshots = tuple(
        snapshot(problem, step.report, criteria, converged=step.converged, elapsed=0.0, event=step.iteration)
        for step in engine.steps(problem, iterations)
    )
    return Scene(scan, snapshots, stage(problem, (scan_points(scan),)))
