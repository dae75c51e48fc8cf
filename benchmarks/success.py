"""How often is the sample cabinet found? Five scenes, with and without a region of interest, and from a rough prior.

A run succeeds where every part that is at least a tenth visible is within 1 cm (ADD). The scenes are also what the
settings were tuned on; `benchmarks.heldout` measures on others. Run it:
`python -m benchmarks.success [--seeds 10] [--method particle_filter]`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import options
from benchmarks.tables import centimetres, markdown, progress, rate
from benchmarks.trials import PROJECT, Case, Trial, load_case, load_roi, rough_prior, run_trial, warm_kernels
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings

SCENES = ("open", "self_occluded", "arm", "blanket", "closed")
TOLERANCE = 0.01
CABINET = PROJECT / "sample_data" / "cabinet"
ROUGH_ITERATIONS = 20
# The rough prior's standard deviations per axis.
ROUGH_METRES, ROUGH_DEGREES = 0.08, 8.6


@dataclass(frozen=True)
class Mode:
    """What is known beforehand. roi : whether a region of interest is; prior : by the run's seed."""

    name: str
    roi: bool
    prior: Callable[[Case, int], UniformPrior | GaussianPrior]
    iterations: int | None = None


def rough(case: Case, seed: int) -> GaussianPrior:
    """The rough prior on the root part of run `seed`."""
    link = case.model.parts[0].links[0]
    return rough_prior(np.random.default_rng([77, seed]), case, link, ROUGH_METRES, ROUGH_DEGREES)


MODES = {
    "roi": Mode("no prior, region given", True, lambda case, seed: UniformPrior("upright")),
    "everywhere": Mode("no prior, no region", False, lambda case, seed: UniformPrior("upright")),
    "rough": Mode("rough prior, region given", True, rough, ROUGH_ITERATIONS),
}


def load_cabinet(scene: str, roi: bool, settings: Settings) -> Case:
    """One scene of the sample cabinet."""
    model = load_model(CABINET / "cabinet.urdf", triangle_budget=settings.triangles)
    box = load_roi(CABINET / scene) if roi else None
    return load_case(scene, model, CABINET / scene, box, settings)


def study(
    mode: Mode,
    scenes: Sequence[str],
    seeds: int,
    iterations: int,
    particles: int,
    settings: Settings,
    method: str = SessionOptions.method,
) -> list[tuple[Case, int, Trial]]:
    """All runs of a mode: case, seed, trial."""
    found = []
    for scene in scenes:
        case = load_cabinet(scene, mode.roi, settings)
        if scene == scenes[0]:
            warm_kernels(case, settings, method)
        for seed in range(seeds):
            trial = run_trial(
                case,
                mode.prior(case, seed),
                settings,
                seed=seed,
                iterations=mode.iterations or iterations,
                particles=particles,
                method=method,
            )
            found.append((case, seed, trial))
            progress(f"{mode.name}: {scene} seed {seed}: {100 * trial.worst[-1]:.2f} cm in {trial.seconds:.2f} s")
    return found


def succeeds(case: Case, trial: Trial, tolerance: float = TOLERANCE) -> bool:
    """Whether every judged part is within `tolerance` metres."""
    return bool(np.all(trial.errors[case.judged] < tolerance))


def report(mode: Mode, runs: Sequence[tuple[Case, int, Trial]]) -> str:
    """The table of a mode by scene, and what failed."""
    rows = []
    for scene in [*dict.fromkeys(case.name for case, _, _ in runs), "all"]:
        of_scene = [(case, trial) for case, _, trial in runs if scene in (case.name, "all")]
        errors = np.concatenate([trial.errors[case.judged] for case, trial in of_scene])
        good = sum(succeeds(case, trial) for case, trial in of_scene)
        rows.append(
            [
                scene,
                rate(good, len(of_scene)),
                f"{100 * np.median(errors):.2f}",
                f"{np.median([trial.seconds for _, trial in of_scene]):.2f}",
                f"{np.median([trial.iterations for _, trial in of_scene]):.0f}",
            ]
        )
    lines = [f"### {mode.name}", "", markdown(["scene", "success", "median ADD (cm)", "seconds", "iterations"], rows)]
    failures = [
        f"- {case.name}, seed {seed}: {centimetres(case, trial, TOLERANCE)} cm"
        for case, seed, trial in runs
        if not succeeds(case, trial)
    ]
    return "\n".join([*lines, "", "Failures:" if failures else "No failures.", *failures, ""])


def main(words: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = options.parser("success on the sample cabinet", seeds=10, iterations=30)
    parser.add_argument("--modes", nargs="+", choices=tuple(MODES), default=list(MODES), help="which (default all)")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), help="which (default all)")
    arguments = parser.parse_args(words)
    chosen = options.settings(arguments)
    for name in arguments.modes:
        mode = MODES[name]
        runs = study(
            mode, arguments.scenes, arguments.seeds, arguments.iterations, arguments.particles, chosen, arguments.method
        )
        print(report(mode, runs), flush=True)


if __name__ == "__main__":
    main()
