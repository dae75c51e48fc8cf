"""How often is an object found where it is hard, and why not? Random scenes of the families of `hard_scenes`.

Each is run without a prior, its region of interest the object's box and a margin. A run is right where every visible
part is within 2 cm. A wrong run has a name by the whole-object scores of the estimate and of the polished truth: a
failure of the search where the truth scores better, of the model where the estimate does, a tie where neither by 2 %.
Run it: `python -m benchmarks.hard [--seeds 3] [--first 0] [--tuning] [--families tent lamp]
[--margin 0.15] [--sensor stereo]`.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks import options
from benchmarks.hard_scenes import EVERY_FAMILY, FAMILIES, HardScene, hard_scene
from benchmarks.tables import centimetres, markdown, progress, rate
from benchmarks.trials import FURTHER, Case, Trial, load_case, load_roi, run_trial, warm_kernels
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.tree_estimate import polish
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings
from sample_data.scan_folders import ROI_MARGIN
from sample_data.scenes import Scene, write_scene

TOLERANCE = 0.02
TIE = 0.02
MARGIN = 0.15
POLISH_ROUNDS = 12
# Metres below the floor: out of any camera's sight.
AWAY = 50.0


@dataclass(frozen=True)
class HardRun:
    """One run. cause : "" where it is right, else "search", "model" or "tie"; scores : whole-object, of the estimate
    and of the truth, polished both."""

    family: str
    seed: int
    case: Case
    trial: Trial
    cause: str
    scores: tuple[float, float]


def load_hard(
    family: str, seed: int, parent: Path, settings: Settings, margin: float | None = MARGIN, sensor: str = Scene.sensor
) -> tuple[Case, UniformPrior]:
    """The scene made ready, and its prior. margin : metres about the object's box; None looks everywhere; sensor : the
    camera's kind."""
    made, folder = hard_scene(family, seed, sensor), parent / f"{family}_{seed}"
    rng = np.random.default_rng([21, list(EVERY_FAMILY).index(family), seed])
    write_hard(folder, made, rng)
    grown = None if margin is None else load_roi(folder) + np.repeat([-1.0, 1.0], 3) * (margin - ROI_MARGIN)
    model = load_model(folder / "model.urdf", triangle_budget=settings.triangles)
    return load_case(folder.name, model, folder, grown, settings), UniformPrior(made.orientation)


def load_absent(
    family: str, seed: int, parent: Path, settings: Settings, roi: Array | None, sensor: str = Scene.sensor
) -> Case:
    """The scene without its object, looked for in `roi` (6,), metres, world, all the same. Raises ScanError where
    nothing is left to look at."""
    made = hard_scene(family, seed, sensor)
    below = made.scene.pose_world_base + np.array([0.0, 0.0, -AWAY, 0.0, 0.0, 0.0, 0.0])
    folder = parent / f"{family}_{seed}_absent"
    rng = np.random.default_rng([22, list(EVERY_FAMILY).index(family), seed])
    write_hard(folder, replace(made, scene=replace(made.scene, pose_world_base=below)), rng)
    model = load_model(folder / "model.urdf", triangle_budget=settings.triangles)
    return load_case(folder.name, model, folder, roi, settings)


def write_hard(folder: Path, made: HardScene, rng: np.random.Generator) -> None:
    """Scans, truth and region of a scene, and the URDF that the inference is given."""
    if made.further is not None:
        camera, off = made.further
        seen_from = replace(made.scene, camera=camera)
        write_hard(folder / FURTHER, replace(made, scene=seen_from, further=None), rng)
        distance = np.linalg.norm(np.asarray(camera.pose_world_camera)[:3] - made.scene.pose_world_base[:3])
        turn = poses.from_rotation_vector(off / distance * rng.standard_normal(3))
        said = poses.multiply(camera.pose_world_camera, np.concatenate([off * rng.standard_normal(3), turn]))
        path = folder / FURTHER / "camera.json"
        written = json.loads(path.read_text(encoding="utf-8"))
        written["T_world_camera"] = poses.to_matrix(said).ravel().tolist()
        path.write_text(json.dumps(written), encoding="utf-8")
    write_scene(folder, made.scene, rng)
    depth = np.asarray(Image.open(folder / "depth.png")).astype(np.float64) / 1000
    noisy = made.depth_scale * depth + made.noise * depth**2 * rng.standard_normal(depth.shape)
    Image.fromarray(np.where(depth > 0, np.rint(1000 * noisy), 0).astype(np.uint16)).save(folder / "depth.png")
    (folder / "model.urdf").write_text(made.urdf, encoding="utf-8")


def study(
    families: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    *,
    particles: int,
    iterations: int,
    margin: float | None,
    sensor: str = Scene.sensor,
    method: str = SessionOptions.method,
) -> Iterator[HardRun]:
    """All runs, family by family."""
    warm = False
    with tempfile.TemporaryDirectory() as parent:
        for family in families:
            for seed in seeds:
                case, prior = load_hard(family, seed, Path(parent), settings, margin, sensor)
                if not warm:
                    warm_kernels(case, settings, method)
                    warm = True
                trial = run_trial(
                    case, prior, settings, seed=seed, iterations=iterations, particles=particles, method=method
                )
                right = bool(np.all(trial.errors[case.judged] < TOLERANCE))
                scores = _polished_scores(case, prior, settings, trial)
                run = HardRun(family, seed, case, trial, "" if right else _cause(*scores), scores)
                progress(
                    f"{family} {seed}: {centimetres(case, trial)} cm, {trial.seconds:.1f} s, "
                    f"score {scores[0]:.0f} against {scores[1]:.0f} {run.cause}"
                )
                yield run


def _polished_scores(case: Case, prior: UniformPrior, settings: Settings, trial: Trial) -> tuple[float, float]:
    """Of the estimate and of the truth."""
    problem = problems.build(case.model, case.observation, prior, settings, particles=16, seed=0)
    plan = problem.schedule(10_000)
    found = []
    for root, joints in ((trial.part_poses[0], trial.joint_positions), (case.true_poses[0], case.joint_vector)):
        rng = np.random.default_rng(0)
        _, _, score = polish(rng, problem, root[None], joints[None], plan, plan.tolerance, POLISH_ROUNDS)
        found.append(float(score[0]))
    return found[0], found[1]


def _cause(estimate: float, truth: float) -> str:
    if abs(truth - estimate) < TIE * abs(truth):
        return "tie"
    return "search" if truth > estimate else "model"


def report(runs: Sequence[HardRun]) -> str:
    """A row for each family, and one for all."""
    rows = []
    for family in [*dict.fromkeys(run.family for run in runs), "all"]:
        of_family = [run for run in runs if family in (run.family, "all")]
        errors: Array = np.concatenate([run.trial.errors[run.case.judged] for run in of_family])
        causes = [run.cause for run in of_family]
        rows.append(
            [
                family,
                rate(causes.count(""), len(causes)),
                rate(int(np.sum(errors < TOLERANCE)), len(errors)),
                *(str(causes.count(cause)) for cause in ("search", "model", "tie")),
                f"{100 * np.median(errors):.2f}",
                f"{np.median([run.trial.seconds for run in of_family]):.2f}",
            ]
        )
    header = ["family", "right", "parts under 2 cm", "search", "model", "tie", "median ADD (cm)", "seconds"]
    return markdown(header, rows)


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options.parser("success on hard scenes", seeds=3, iterations=100)
    parser.add_argument("--families", nargs="*", choices=list(EVERY_FAMILY), default=list(FAMILIES))
    options.add_halves(parser)
    options.add_sensor(parser)
    parser.add_argument("--margin", type=float, default=MARGIN, help="metres about the object; below 0: no region")
    arguments = parser.parse_args(words)
    runs = study(
        arguments.families,
        options.halved(arguments),
        options.settings(arguments),
        particles=arguments.particles,
        iterations=arguments.iterations,
        margin=None if arguments.margin < 0 else arguments.margin,
        sensor=arguments.sensor,
        method=arguments.method,
    )
    print(report(list(runs)))


if __name__ == "__main__":
    main()
