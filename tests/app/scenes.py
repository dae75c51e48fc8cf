"""Iterations of the sample cabinet for tests of what is drawn, made without a server."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

from app.viewer.frames import frame
from app.viewer.particles import WEIGHTLESS
from app.viewer.scan_points import scan_points
from app.viewer.scene_frame import Points, SceneFrame
from app.viewer.stage import Stage, stage
from app.viewer.view_state import LAYERS, Layers, ViewState
from pmpnbp.geometry import poses
from pmpnbp.inference import run as engine
from pmpnbp.readout.snapshot import Criteria, Snapshot, snapshot
from pmpnbp.readout.view_planning import PlannedView
from pmpnbp.recording import prepare
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.truth_file import load_truth
from pmpnbp.settings import changed, preset
from tests.app.small_sessions import CABINET, QUICK, ROI

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Scene:
    """snapshots : iterations 0, 1, …, the last one with its posterior; stage : of all of them"""

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
    # so strict that no part is certain, and where else they may be is drawn
    criteria = Criteria(max_std=1e-4, truth=load_truth(folder / "truth.json"))
    snapshots = tuple(
        snapshot(problem, step.report, criteria, converged=step.converged, elapsed=0.0, event=step.iteration)
        for step in engine.steps(problem, iterations)
    )
    snapshots = (*snapshots[:-1], snapshots[-1].read_out())
    return Scene(scan, snapshots, stage(problem, (scan_points(scan),)))


def shown(kind: type[Kind], found: SceneFrame, name: str) -> Kind:
    """The node of that name."""
    (node,) = [node for node in found.nodes if node.name == name]
    assert isinstance(node, kind)
    return node


def estimated(made: Snapshot) -> np.ndarray:
    """(N, 7): where the result has the parts, each at its first link."""
    links = [made.result["links"][part.links[0]]["pose"] for part in made.problem.mrf.model.parts]
    return np.array(
        [[*(pose["position"][a] for a in "xyz"), *(pose["orientation"][a] for a in "wxyz")] for pose in links]
    )


def as_told(pose: np.ndarray) -> np.ndarray:
    """A pose (7,) as a result has it: of the two quaternions of a rotation the one whose w is not negative."""
    return pose if pose[3] >= 0 else np.concatenate([pose[:3], -pose[3:]])


def only(*layers: str, **change: Any) -> ViewState:
    """A state that shows these layers and no others."""
    return ViewState(show=Layers(**{layer: layer in layers for layer in LAYERS}), **change)


def drawn(state: ViewState, iteration: int = -1) -> SceneFrame:
    """The frame of an iteration of `scene`."""
    whole = scene()
    return frame(whole.snapshots[iteration], state, whole.stage)


def views() -> list[PlannedView]:
    """Three places beside the scan's camera."""
    pose = scene().stage.scans[0].camera.pose_world_camera
    return [PlannedView(poses.multiply(pose, np.array([x, 0, 0, 1, 0, 0, 0]))) for x in (0.0, 0.1, 0.2)]


def of_a_part(found: SceneFrame, number: int) -> list[Points]:
    """The clouds of a part's particles, that of the heaviest first."""
    return [node for node in found.nodes if isinstance(node, Points) and node.name.startswith(f"/particles/{number}/")]


def heavy(number: int) -> np.ndarray:
    """Numbers of a part's particles that weigh more than a particle of weight zero."""
    log_weights = scene().snapshots[-1].report.belief.log_weights[number]
    return np.flatnonzero(log_weights >= log_weights.max() - WEIGHTLESS)
