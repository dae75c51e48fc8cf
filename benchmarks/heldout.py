"""How often is an object found that nothing was tuned on? Random cabinets, doors and chains, each in a room of its own.

The scenes are those of `sample_data.scenes.held_out_scene` from seed 100 up; settings are the defaults. Each is run
without a prior, its region of interest given, and from the rough prior that lies with it. Run it:
`python -m benchmarks.heldout [--seeds 2]`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import options
from benchmarks.success import ROUGH_ITERATIONS, TOLERANCE, succeeds
from benchmarks.tables import centimetres, markdown, progress, rate
from benchmarks.trials import Case, Trial, load_case, load_roi, run_trial, warm_kernels
from pmpnbp.scene.prior import GaussianPrior, UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings
from sample_data.scenes import Scene, held_out_scene

FIRST_SEED = 100
SCENES = {"cabinet": 10, "door": 8, "chain": 8}
LOOSE_TOLERANCE = 0.02
NO_PRIOR, ROUGH = "no prior", "rough prior"


@dataclass(frozen=True)
class Run:
    """One run: the object's kind, what was known beforehand, the seed of the inference, and what came of it."""

    kind: str
    known: str
    case: Case
    seed: int
    trial: Trial


def load_scene(
    kind: str, number: int, parent: Path, settings: Settings, sensor: str = Scene.sensor
) -> tuple[Case, GaussianPrior]:
    """The random scene `number` of a kind before a kind of camera, written below `parent`, with its rough prior."""
    folder = held_out_scene(kind, number, parent, sensor)
    model = load_model(folder / "model.urdf", triangle_budget=settings.triangles)
    prior = load_prior(folder / "prior.json", model)
    assert isinstance(prior, GaussianPrior)
    return load_case(folder.name, model, folder, load_roi(folder), settings), prior


def study(
    scenes: dict[str, int],
    seeds: int,
    iterations: int,
    particles: int,
    settings: Settings,
    sensor: str = Scene.sensor,
    method: str = SessionOptions.method,
) -> Iterator[Run]:
    """All runs on as many scenes of each kind as `scenes` says."""
    warm = False
    with tempfile.TemporaryDirectory() as parent:
        for kind, count in scenes.items():
            for number in range(FIRST_SEED, FIRST_SEED + count):
                case, prior = load_scene(kind, number, Path(parent), settings, sensor)
                if not warm:
                    warm_kernels(case, settings, method)
                    warm = True
                for seed in range(seeds):
                    for known in (NO_PRIOR, ROUGH):
                        trial = run_trial(
                            case,
                            prior if known == ROUGH else UniformPrior("upright"),
                            settings,
                            seed=seed,
                            iterations=ROUGH_ITERATIONS if known == ROUGH else iterations,
                            particles=particles,
                            method=method,
                        )
                        progress(f"{case.name}, {known}, seed {seed}: {centimetres(case, trial)} cm")
                        yield Run(kind, known, case, seed, trial)


def report(runs: Sequence[Run]) -> str:
    """The table by what was known and by kind, and the list of failures."""
    rows = []
    for known in (NO_PRIOR, ROUGH):
        for kind in [*dict.fromkeys(run.kind for run in runs), "all"]:
            of_kind = [run for run in runs if run.known == known and kind in (run.kind, "all")]
            if of_kind:
                rows.append([known, kind, *_figures(of_kind)])
    header = ["known", "kind", "scenes", "under 1 cm", "under 2 cm", "parts under 1 cm", "median ADD (cm)", "seconds"]
    failures = [
        f"- {run.case.name}, {run.known}, seed {run.seed}: {centimetres(run.case, run.trial, TOLERANCE)} cm"
        for run in runs
        if not succeeds(run.case, run.trial)
    ]
    return "\n".join([markdown(header, rows), "", "Failures:" if failures else "No failures.", *failures, ""])


def _figures(runs: Sequence[Run]) -> list[str]:
    errors = np.concatenate([run.trial.errors[run.case.judged] for run in runs])
    return [
        str(len({run.case.name for run in runs})),
        rate(sum(succeeds(run.case, run.trial) for run in runs), len(runs)),
        rate(sum(succeeds(run.case, run.trial, LOOSE_TOLERANCE) for run in runs), len(runs)),
        rate(int(np.sum(errors < TOLERANCE)), len(errors)),
        f"{100 * np.median(errors):.2f}",
        f"{np.median([run.trial.seconds for run in runs]):.2f}",
    ]


def main(words: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = options.parser("success on random scenes", seeds=1, iterations=100)
    for kind, count in SCENES.items():
        parser.add_argument(f"--{kind}s", type=int, default=count, help=f"scenes with a {kind} (default {count})")
    options.add_sensor(parser)
    arguments = parser.parse_args(words)
    scenes = {kind: getattr(arguments, f"{kind}s") for kind in SCENES}
    chosen = options.settings(arguments)
    runs = study(
        scenes, arguments.seeds, arguments.iterations, arguments.particles, chosen, arguments.sensor, arguments.method
    )
    print(report(list(runs)))


if __name__ == "__main__":
    main()
