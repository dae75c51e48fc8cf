"""How well are two robots found that others made? A Fetch in simulated scans, an xArm 7 in a real room.

The data lies beside the checkout, in ../shared/data, and is no part of the project. What is known beforehand is the
base, roughly, and nothing of the joints; the region of interest is a box about where the prior puts the base. Run it:
`python -m benchmarks.real_data [--robots fetch xarm]`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import options
from benchmarks.alignment import offset
from benchmarks.tables import markdown, progress, rate
from benchmarks.trials import PROJECT, Case, Trial, load_case, rough_prior, run_trial, warm_kernels
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.inference.problem import look
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import GaussianPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings

DATA = PROJECT.parent / "shared" / "data"
# The rigid offset, which stands for the camera's calibration, is fitted to the parts of which the image shows this
# share: a wrist beyond the image's edge can lie anywhere, and would turn the whole robot.
HELD = 0.5


@dataclass(frozen=True)
class Robot:
    """A robot, its scans, and what is known of it.

    metres, degrees : standard deviations of the prior on link `base`, per axis
    reach : (6,) x0 y0 z0 x1 y1 z1, metres: the region of interest about the prior's base position, world's axes
    tolerance : metres, within which a part counts as found; aligned : whether one rigid offset is taken off before
    iterations, seeds : by default
    """

    title: str
    folder: str
    scans: tuple[str, ...]
    base: str
    metres: float
    degrees: float
    reach: tuple[float, ...]
    tolerance: float
    aligned: bool
    iterations: int
    seeds: int


ROBOTS = {
    "fetch": Robot(
        "Fetch, simulated scans",
        "fetch",
        ("scan_0", "scan_1"),
        "base_link",
        0.10,
        10.0,
        (-0.9, -0.9, -0.1, 0.9, 0.9, 1.5),
        0.05,
        False,
        100,
        5,
    ),
    "xarm": Robot(
        "xArm 7, real depth",
        "real_xarm7",
        ("frame_0", "frame_4", "frame_7"),
        "link_base",
        0.02,
        2.0,
        (-0.75, -0.75, -0.1, 0.75, 0.75, 1.0),
        0.025,
        True,
        100,
        3,
    ),
}


@dataclass(frozen=True)
class Run:
    """One run.

    errors : (N,) metres, after the rigid offset where one is taken off; moved : that offset (7,), else the identity
    as_it_is : how many of the parts that count are within the tolerance without taking an offset off
    joint_errors : estimate minus truth of each turning joint, degrees, by name
    seconds : of the inference; all_seconds : with reading the scan
    """

    scan: str
    seed: int
    case: Case
    trial: Trial
    errors: Array
    moved: Array
    as_it_is: int
    joint_errors: dict[str, float]
    seconds: float
    all_seconds: float


def measure(
    robot: Robot,
    seeds: int,
    iterations: int,
    particles: int,
    settings: Settings,
    data: Path,
    method: str = SessionOptions.method,
) -> list[Run]:
    """All runs of a robot."""
    folder = data / robot.folder
    model = load_model(folder / "model.urdf", triangle_budget=settings.triangles)
    runs: list[Run] = []
    for scan in robot.scans:
        whole = load_case(scan, model, folder / scan, None, settings)
        for seed in range(seeds):
            prior = rough_prior(np.random.default_rng([5, seed]), whole, robot.base, robot.metres, robot.degrees)
            start = time.perf_counter()
            case = _within_reach(whole, robot, prior, folder / scan, settings)
            reading = time.perf_counter() - start
            if not runs:
                warm_kernels(case, settings, method)
            trial = run_trial(
                case, prior, settings, seed=seed, iterations=iterations, particles=particles, method=method
            )
            runs.append(_judged(robot, scan, seed, case, trial, reading))
            progress(f"{robot.title}, {scan}, seed {seed}: {_found(robot, runs[-1])} in {trial.seconds:.1f} s")
    return runs


def report(robot: Robot, runs: Sequence[Run]) -> str:
    """The tables of a robot: runs, errors by link, errors by joint."""
    part_names = [part.name for part in runs[0].case.model.parts]
    joints = list(runs[0].joint_errors)
    summary = [
        [
            run.scan,
            run.seed,
            _found(robot, run),
            f"{100 * np.median(run.errors[_counted(robot, run.case)]):.1f}",
            *_offset_cells(robot, run),
            f"{run.trial.iterations}",
            f"{run.seconds:.1f}",
            f"{run.all_seconds:.1f}",
        ]
        for run in runs
    ]
    header = ["scan", "seed", f"within {100 * robot.tolerance:.1f} cm", "median (cm)"]
    header += ["offset taken off", "within without it"] if robot.aligned else []
    header += ["iterations", "seconds", "with reading"]
    within = [run.errors[_counted(robot, run.case)] < robot.tolerance for run in runs]
    total, good = sum(len(each) for each in within), sum(int(each.sum()) for each in within)
    by_link = [[run.scan, run.seed, *_link_cells(robot, run)] for run in runs]
    by_joint = [[run.scan, run.seed, *(f"{run.joint_errors[name]:+.1f}" for name in joints)] for run in runs]
    limit = f"{100 * robot.tolerance:.1f} cm"
    return "\n".join(
        [
            f"### {robot.title}",
            "",
            f"Within {limit}: {rate(good, total)} of the parts that count.",
            "",
            markdown(header, summary),
            "",
            "Errors by part (cm; ADD-S for symmetric ones; in brackets: less than a tenth visible)"
            + (", the offset taken off:" if robot.aligned else ":"),
            "",
            markdown(["scan", "seed", *part_names], by_link),
            "",
            "Errors by joint (degrees):",
            "",
            markdown(["scan", "seed", *joints], by_joint),
            "",
        ]
    )


def _within_reach(whole: Case, robot: Robot, prior: GaussianPrior, folder: Path, settings: Settings) -> Case:
    """The case with its observation cropped to the robot's reach about the prior's base; shares as in the whole."""
    roi = np.tile(prior.pose_world_link[:3], 2) + np.array(robot.reach)
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    return replace(whole, observation=look(whole.model, [scan], roi, settings))


def _judged(robot: Robot, scan: str, seed: int, case: Case, trial: Trial, reading: float) -> Run:
    held = np.flatnonzero(case.shares >= HELD)
    moved = (
        offset(trial.part_poses[held], case.true_poses[held], [case.points[node] for node in held])
        if robot.aligned
        else IDENTITY
    )
    errors = case.errors(poses.multiply(moved, trial.part_poses)) if robot.aligned else trial.errors
    as_it_is = int(np.sum(trial.errors[_counted(robot, case)] < robot.tolerance))
    joint_errors = _joint_errors(case.model, trial.joint_positions, case.true_joints)
    return Run(scan, seed, case, trial, errors, moved, as_it_is, joint_errors, trial.seconds, trial.seconds + reading)


def _joint_errors(model: ArticulatedObject, joint_positions: Array, truth: dict[str, float]) -> dict[str, float]:
    """Degrees, of turning joints between parts: less than half a turn either way, as whole turns look the same."""
    values = model.joint_values(joint_positions)
    # joints above the first part (a mobile base's) are not inferred: the base's own pose stands for them
    inferred = {int(coordinate) for edge in model.edges for coordinate in edge.coordinates}
    turning = [
        joint.name
        for joint in model.joints
        if joint.kind in ("revolute", "continuous") and joint.name in truth and inferred.issuperset(joint.coordinates)
    ]
    return {name: float((np.degrees(values[name][0] - truth[name]) + 180.0) % 360.0 - 180.0) for name in turning}


def _counted(robot: Robot, case: Case) -> NDArray[np.bool_]:
    """Which parts count: the visible ones, or all where the robot is judged link by link."""
    return np.ones(len(case.shares), dtype=np.bool_) if robot.aligned else case.judged


def _found(robot: Robot, run: Run) -> str:
    errors = run.errors[_counted(robot, run.case)]
    return f"{int(np.sum(errors < robot.tolerance))} of {len(errors)}"


def _offset_cells(robot: Robot, run: Run) -> list[str]:
    if not robot.aligned:
        return []
    degrees = np.degrees(poses.rotation_angle(IDENTITY[3:], run.moved[3:]))
    # how far the middle of the robot is moved: the offset's own translation is that of the world's origin
    middle = run.trial.part_poses[:, :3].mean(axis=0)
    metres = np.linalg.norm(poses.transform_points(run.moved, middle) - middle)
    return [f"{100 * metres:.1f} cm, {degrees:.1f}°", f"{run.as_it_is}"]


def _link_cells(robot: Robot, run: Run) -> list[str]:
    cells = []
    for error, visible in zip(run.errors, run.case.judged, strict=True):
        text = f"{100 * error:.1f}"
        cells.append(text if visible else f"({text})")
    return cells


def main(words: Sequence[str] | None = None, data: Path = DATA) -> None:
    """Print the tables, or one sentence where the data is not there."""
    parser = options.parser("errors on robots that others made", seeds=0, iterations=0)
    parser.add_argument("--robots", nargs="+", choices=tuple(ROBOTS), default=list(ROBOTS), help="which (default all)")
    arguments = parser.parse_args(words)
    chosen = options.settings(arguments)
    for name in arguments.robots:
        robot = ROBOTS[name]
        if not (data / robot.folder / "model.urdf").is_file():
            print(
                f"{robot.title}: skipped, because the data is not in '{data.name}/{robot.folder}' beside the checkout."
            )
            continue
        runs = measure(
            robot,
            arguments.seeds or robot.seeds,
            arguments.iterations or robot.iterations,
            arguments.particles,
            chosen,
            data,
            arguments.method,
        )
        print(report(robot, runs), flush=True)


if __name__ == "__main__":
    main()
