"""What is each deviation from the paper worth? Success with each setting put back to the paper's value, one by one.

Run it: `python -m benchmarks.ablation [--seeds 5] [--base search_iterations=0]`. Success: every part of the sample
cabinet that is at least a tenth visible is within 1 cm (ADD) at the end. From no prior up to 24 iterations, from a
rough prior (8 cm, 8.6 degrees per axis, joints unknown) up to 20. These scenes are also those of the tuning.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem, run
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings, changed, preset

CABINET = Path(__file__).resolve().parent.parent / "sample_data" / "cabinet"
SCENES = ("open", "self_occluded", "arm")
VISIBLE, SUCCESS = 0.1, 0.01
ITERATIONS = {"no prior": 24, "rough prior": 20}

# Each deviation put back to what the paper has, by a short name.
ABLATIONS: dict[str, Mapping[str, object]] = {
    "robust": {},
    "pixel_score distance": {"pixel_score": "distance"},
    "free_space_cost 0": {"free_space_cost": 0.0},
    "occlusion_cost 1": {"occlusion_cost": 1.0},
    "support_reward 1": {"support_reward": 1.0},
    "effective_share 0 (no tempering)": {"effective_share": 0.0},
    "pairwise_form limits": {"pairwise_form": "limits"},
    "joint_draws 1": {"joint_draws": 1},
    "joint_memory 0": {"joint_memory": 0.0},
    "neighbour_proposals 0": {"neighbour_proposals": 0.0},
    "belief_product pooled": {"belief_product": "pooled"},
    "messages_keep_unary, pooled": {"belief_product": "pooled", "messages_keep_unary": True},
    "prior_factor false": {"prior_factor": False},
    "object_estimate false": {"object_estimate": False},
    "neighbour_sum false": {"neighbour_sum": False},
    "anneal_iterations 0": {"anneal_iterations": 0},
    "search_iterations 0": {"search_iterations": 0},
    "paper": {"preset": "paper"},
}


@dataclass(frozen=True)
class Case:
    """A scene: what is observed, the true part poses (N, 7), which parts count (N,), points of each part's surface."""

    observation: Observation
    truth: Array
    counts: Array
    points: tuple[Array, ...]


def case(model: ArticulatedObject, folder: Path, settings: Settings) -> Case:
    """The scene in `folder`."""
    truth = json.loads((folder / "truth.json").read_text())
    roi = np.array(json.loads((folder / "roi.json").read_text())["roi"])
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    part_poses = np.stack([poses.from_matrix(np.array(truth["links"][p.links[0]]).reshape(4, 4)) for p in model.parts])
    visible = [max(truth["visible_fraction"].get(link, 0.0) for link in part.links) for part in model.parts]
    return Case(
        problem.look(model, [scan], roi, settings),
        part_poses,
        np.array(visible) >= VISIBLE,
        tuple(model_points(part.mesh) for part in model.parts),
    )


def error(model: ArticulatedObject, scene: Case, settings: Settings, start: str, particles: int, seed: int) -> float:
    """The largest ADD of the parts that count, metres, at the end of a run from `start`."""
    prior: UniformPrior | GaussianPrior = UniformPrior("upright")
    if start == "rough prior":
        rng = np.random.default_rng([21, seed])
        spread = np.full(3, 0.08), np.full(3, 0.15)
        noise = rng.standard_normal((2, 3))
        pose = poses.perturb(scene.truth[0], spread[0] * noise[0], spread[1] * noise[1])
        prior = GaussianPrior(model.parts[0].links[0], pose, *spread, {})
    made = problem.build(model, scene.observation, prior, settings, particles=particles, seed=seed)
    for report in run.iterate(made, ITERATIONS[start]):
        mle = report.map_poses
    found = [add(points, pose, true) for points, pose, true in zip(scene.points, mle, scene.truth, strict=True)]
    return float(np.max(np.array(found)[scene.counts]))


def main() -> None:
    """Print the table of docs/algorithm.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each scene")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--particles", type=int, default=SessionOptions.particles)
    parser.add_argument("--only", nargs="*", choices=list(ABLATIONS), help="some of the rows")
    parser.add_argument("--start", nargs="*", choices=list(ITERATIONS), default=list(ITERATIONS))
    parser.add_argument("--base", nargs="*", default=[], metavar="name=value", help="settings of all rows but the last")
    chosen = parser.parse_args()
    base = changed(preset("robust"), dict(entry.split("=", 1) for entry in chosen.base))
    model = load_model(CABINET / "cabinet.urdf", triangle_budget=preset("robust").triangles)
    scenes = [case(model, CABINET / name, preset("robust")) for name in SCENES]
    runs = len(scenes) * chosen.seeds
    print(
        f"{runs} runs a cell ({', '.join(SCENES)}; {chosen.seeds} seeds from {chosen.first_seed}), "
        f"{chosen.particles} particles"
    )
    print(f"| settings |{''.join(f' {start}: success | median ADD (cm) |' for start in chosen.start)}")
    print(f"| --- |{' --- | --- |' * len(chosen.start)}")
    for name in chosen.only or ABLATIONS:
        settings = changed(base, ABLATIONS[name])
        cells = [name]
        for start in chosen.start:
            errors = np.array(
                [
                    error(model, scene, settings, start, chosen.particles, seed)
                    for scene in scenes
                    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds)
                ]
            )
            cells += [f"{np.count_nonzero(errors < SUCCESS)} of {runs}", f"{100 * np.median(errors):.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
