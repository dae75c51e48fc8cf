"""Are error bars as long as errors? Standard deviations of part positions against what the estimate is really off by.

On scenes of `sample_data.scenes.held_out_scene`, from the rough prior that lies with each: of every part, along each
axis of the world, error over standard deviation, of draws given the scan (`pmpnbp.readout.object_posterior`) and of the
belief's particles. Were both honest, the root mean square would be 1 and 68, 95 and 99.7 % within 1, 2 and 3.
`object_posterior.CONFIDENCE` was set on the scenes from seed 100 up; those from 200 up nothing was set on. Run it:
`python -m benchmarks.calibration [--first 200]`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import heldout, options
from benchmarks.tables import markdown, progress
from benchmarks.trials import Case, timed, warm_kernels
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.tree_estimate import agreeing
from pmpnbp.readout.estimate import place
from pmpnbp.readout.posterior import of_estimate
from pmpnbp.scene.prior import GaussianPrior
from pmpnbp.settings import Settings

FIRST_SEED = 200
WAYS = ("draws given the scan", "the belief's particles")


@dataclass(frozen=True)
class Run:
    """errors : (N, 3) metres, of part positions along the world's axes; stds : of each of WAYS, (N, 3) metres"""

    kind: str
    errors: Array
    stds: tuple[Array, Array]


def study(arguments: argparse.Namespace) -> Iterator[Run]:
    """All runs that the options ask for, each judged at rest."""
    chosen, warm = options.settings(arguments), False
    with tempfile.TemporaryDirectory() as parent:
        for kind in heldout.SCENES:
            for number in range(arguments.first, arguments.first + getattr(arguments, f"{kind}s")):
                case, prior = heldout.load_scene(kind, number, Path(parent), chosen)
                if not warm:
                    warm_kernels(case, chosen, arguments.method)
                    warm = True
                for seed in range(arguments.seeds):
                    yield _run(kind, case, prior, chosen, seed, arguments)
                    progress(f"{case.name}, seed {seed}")


def _run(
    kind: str, case: Case, prior: GaussianPrior, chosen: Settings, seed: int, arguments: argparse.Namespace
) -> Run:
    for made in timed(case, prior, chosen, seed=seed, particles=arguments.particles, method=arguments.method):
        if made.at_rest is not None or made.report.iteration >= arguments.iterations:
            break
    root, joints = agreeing(made.problem, made.report)
    placed = place(made.problem, made.report, of_estimate(made.problem, made.report))
    drawn, spread = placed.std_xyz, placed.particle_std_xyz
    assert drawn is not None  # the search is over
    errors = case.model.part_poses(root, joints)[:, :3] - case.true_poses[:, :3]
    return Run(kind, errors, (drawn[case.first_links], spread[case.first_links]))


def report(runs: Sequence[Run]) -> str:
    """A row for each way and kind of object."""
    rows = []
    for way, title in enumerate(WAYS):
        for kind in dict.fromkeys(run.kind for run in runs):
            some = [run for run in runs if run.kind == kind]
            std = np.concatenate([run.stds[way].ravel() for run in some])
            off = np.abs(np.concatenate([run.errors.ravel() for run in some])) / np.maximum(std, 1e-9)
            within = [f"{100 * np.mean(off < limit):.0f} %" for limit in (1, 2, 3)]
            rms = np.sqrt(np.mean(off**2))
            rows.append(
                [title, kind, len(some), f"{1000 * np.median(std):.2f}", f"{rms:.2f}", *within, f"{off.max():.1f}"]
            )
    header = [
        "std of",
        "kind",
        "runs",
        "median std (mm)",
        "rms of error / std",
        "within 1",
        "within 2",
        "within 3",
        "most",
    ]
    return markdown(header, rows)


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = options.parser("whether error bars are as long as errors", seeds=1, iterations=60)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="seed of the first scene (default %(default)s)")
    for kind, count in heldout.SCENES.items():
        parser.add_argument(f"--{kind}s", type=int, default=count, help=f"scenes with a {kind} (default {count})")
    print(report(list(study(parser.parse_args(words)))))


if __name__ == "__main__":
    main()
