"""What does one inference on a scene of known truth find, and when? A case is a scene made ready; a trial is one run on
it, timed without the time that judging it takes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run as engine
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import visible_fractions
from pmpnbp.readout.metrics import add, add_s, model_points
from pmpnbp.readout.mixture import read_out
from pmpnbp.readout.placement import standing
from pmpnbp.scene.articulated_object import ArticulatedObject, Part
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.truth_file import load_truth
from pmpnbp.settings import SessionOptions, Settings, changed

# Of a scene's folder: where its scan by a second camera lies.
FURTHER = "further"
PROJECT = Path(__file__).resolve().parent.parent
# A part counts where at least this share of it is seen; what is hidden nearly whole can only be guessed.
VISIBLE = 0.1
# Metres in front of a part at the true pose from which on a measurement hides it, where the truth has no shares.
IN_FRONT = 0.03


@dataclass(frozen=True)
class Case:
    """A scene with its truth.

    true_poses : (N, 7) part in world; true_links : (7,) link in world, by name
    true_joints : by name, metres or radians
    shares : (N,) of each part, the share of the pixels it would cover alone in which it is seen
    symmetric : (N,) bool, parts judged by nearest points (ADD-S) because their turns cannot be told apart
    points : N of (m, 3), the surface points that errors average over
    """

    name: str
    model: ArticulatedObject
    observation: Observation
    true_poses: Array
    true_links: dict[str, Array]
    true_joints: dict[str, float]
    shares: Array
    symmetric: NDArray[np.bool_]
    points: tuple[Array, ...]

    @property
    def judged(self) -> NDArray[np.bool_]:
        """(N,): the parts that are seen well enough to count."""
        return self.shares >= VISIBLE

    @property
    def first_links(self) -> list[int]:
        """(N,): of each part its first link, by its place in the model's order."""
        return [self.model.links.index(part.links[0]) for part in self.model.parts]

    @property
    def joint_vector(self) -> Array:
        """(D,): the true joint positions in the model's order."""
        found = np.clip(0.0, self.model.lower, self.model.upper)
        for joint in self.model.joints:
            for coordinate in joint.coordinates:
                found[coordinate] = self.true_joints[joint.name]
        return found

    def errors(self, part_poses: Array) -> Array:
        """ADD (N,), metres, of part poses (N, 7); ADD-S for symmetric parts."""
        return np.array(
            [
                (add_s if self.symmetric[node] else add)(self.points[node], part_poses[node], self.true_poses[node])
                for node in range(len(self.points))
            ]
        )


@dataclass(frozen=True)
class Trial:
    """One run.

    errors : (N,) metres, of the estimate that a user is given, the middle of the posterior where there is one;
        part_poses : (N, 7); joint_positions : (D,)
    elapsed : (I + 1,) seconds from the start of its preparation (splat models, MRF) to the end of each iteration, the
        start being iteration 0; worst : (I + 1,) metres, the largest error of a judged part after each
    at_rest : the iteration in which it converged, or None
    """

    errors: Array
    part_poses: Array
    joint_positions: Array
    elapsed: Array
    worst: Array
    at_rest: int | None

    @property
    def iterations(self) -> int:
        """Iterations until it converged, else all that were run."""
        return len(self.elapsed) - 1 if self.at_rest is None else self.at_rest

    @property
    def seconds(self) -> float:
        """Until then, preparation included."""
        return float(self.elapsed[self.iterations])

    def seconds_to_result(self, tolerance: float) -> float:
        """From when on every judged part stays within `tolerance` metres; infinite where one is beyond at the end."""
        beyond = np.flatnonzero(self.worst > tolerance)
        if len(beyond) == 0:
            return float(self.elapsed[0])
        return float(self.elapsed[beyond[-1] + 1]) if beyond[-1] + 1 < len(self.elapsed) else float("inf")


@dataclass(frozen=True)
class Made:
    """An iteration. seconds : from the start of the preparation to its end; at_rest : the iteration in which the run
    converged, or None so far"""

    problem: Problem
    report: IterationReport
    seconds: float
    at_rest: int | None


def load_case(name: str, model: ArticulatedObject, folder: Path, roi: Array | None, settings: Settings) -> Case:
    """The scene in `folder` (depth.png, camera.json, truth.json) with `roi` (6,), world, metres, or the whole image;
    seen from a second place, too, where it has a folder FURTHER.

    Shares come from truth.json where it counts pixels, those of the view that shows more, else from rendering the model
    at its true pose.
    """
    views = [folder, *filter(Path.is_dir, [folder / FURTHER])]
    truth = load_truth(folder / "truth.json")
    counted = [json.loads((view / "truth.json").read_text(encoding="utf-8")) for view in views]
    more = counted[0]
    scans = [load_scan(view / "depth.png", view / "camera.json") for view in views]
    observation = problems.look(model, scans, roi, settings)
    true_poses = np.array([_true_pose(part, truth["links"]) for part in model.parts])
    if "pixels_alone" in more:
        shares = np.array(
            [
                max(_share(part, each["visible_fraction"], each["pixels_alone"]) for each in counted)
                for part in model.parts
            ]
        )
    else:
        shares = visible_fractions(observation, prepare_surfaces(model), true_poses, IN_FRONT)
    # by the link that the part is named after: a base with round wheels fixed to it is not round itself
    symmetric = np.array([part.name in more.get("symmetric", ()) for part in model.parts])
    return Case(
        name, model, observation, true_poses, truth["links"], truth["joints"], shares, symmetric, surface_points(model)
    )


def load_roi(folder: Path) -> Array:
    """The box (6,) in the folder's roi.json."""
    return np.array(json.loads((folder / "roi.json").read_text(encoding="utf-8"))["roi"], dtype=np.float64)


def surface_points(model: ArticulatedObject) -> tuple[Array, ...]:
    """The points that each part's errors average over; one point, its origin, for a part without a surface."""
    return tuple(model_points(part.mesh) if part.visible else np.zeros((1, 3)) for part in model.parts)


def rough_prior(rng: np.random.Generator, case: Case, link: str, metres: float, degrees: float) -> GaussianPrior:
    """A prior on `link` with these standard deviations per axis, whose mean is a draw of itself about the truth; the
    joints unknown."""
    turn = np.deg2rad(degrees)
    mean = poses.perturb(case.true_links[link], metres * rng.standard_normal(3), turn * rng.standard_normal(3))
    return GaussianPrior(link, mean, np.full(3, metres), np.full(3, turn))


def run_trial(
    case: Case,
    prior: UniformPrior | GaussianPrior,
    settings: Settings,
    *,
    seed: int,
    iterations: int,
    particles: int = SessionOptions.particles,
    method: str = SessionOptions.method,
    at_least: int = 0,
) -> Trial:
    """Run until converged, `iterations` at most; where `at_least` is given, on to that iteration though converged."""
    elapsed, worst = [], []
    for made in timed(case, prior, settings, seed=seed, particles=particles, method=method):
        elapsed.append(made.seconds)
        worst.append(_worst(case, made.report.map_poses))
        number = made.report.iteration
        if number >= iterations or (made.at_rest is not None and number >= at_least):
            break
    told = standing(made.problem, made.report, read_out(made.problem, made.report))
    return Trial(
        case.errors(told.part_poses),
        told.part_poses,
        told.joint_positions,
        np.array(elapsed),
        np.array(worst),
        made.at_rest,
    )


def timed(
    case: Case,
    prior: UniformPrior | GaussianPrior,
    settings: Settings,
    *,
    seed: int,
    particles: int,
    method: str = SessionOptions.method,
) -> Iterator[Made]:
    """Iterations from the start on, without an end. What is done with one, judging it, takes none of the seconds."""
    start = time.perf_counter()
    problem = problems.build(
        case.model, case.observation, prior, settings, particles=particles, seed=seed, method=method
    )
    step = engine.first(problem)
    spent, at_rest = time.perf_counter() - start, None
    while True:
        yield Made(problem, step.report, spent, at_rest)
        start = time.perf_counter()
        step = engine.following(step, problem)
        if at_rest is None and step.converged:
            at_rest = step.iteration
        spent += time.perf_counter() - start


def shortened(settings: Settings, *, search: int, anneal: int, refine: int) -> Settings:
    """`settings` with a shorter schedule: of each stage at most so many iterations, however many joints there are, and
    one search only."""
    most = {"search_iterations": search, "anneal_iterations": anneal, "refine_iterations": refine}
    counts = {name: min(count, getattr(settings, name)) for name, count in most.items()}
    return changed(settings, counts | {"search_iterations_per_joint": 0, "search_restarts": 0})


# A search of few hypotheses goes through the same kernels as one of many.
_HARDLY_SEARCHED = {"search_proposals": 60, "search_islands": 1}


def warm_kernels(case: Case, settings: Settings, method: str = SessionOptions.method) -> None:
    """Have every kernel compiled that `settings` use, by a short run that goes through all stages; what it finds is
    of no interest. Without it the first trial of a process would wait for the compiler, or for its cache."""
    short = changed(shortened(settings, search=1, anneal=1, refine=1), _HARDLY_SEARCHED)
    run_trial(case, UniformPrior("upright"), short, seed=0, iterations=4, particles=50, method=method)
    link = case.model.parts[0].links[0]
    pose = case.true_poses[0]
    prior = GaussianPrior(link, pose, np.full(3, 0.1), np.full(3, 0.1))
    run_trial(case, prior, short, seed=0, iterations=4, particles=50, method=method)


def _worst(case: Case, part_poses: Array) -> float:
    return float(np.max(case.errors(part_poses)[case.judged], initial=0.0))


def _true_pose(part: Part, links: dict[str, Array]) -> Array:
    link = next(link for link in part.links if link in links)
    return poses.multiply(links[link], poses.inverse(part.poses_part_link[part.links.index(link)]))


def _share(part: Part, seen: dict[str, float], alone: dict[str, int]) -> float:
    """Pixels in which the part's links are seen over those they would cover alone, one by one."""
    pixels = [alone.get(link, 0) for link in part.links]
    visible = [seen.get(link, 0.0) * count for link, count in zip(part.links, pixels, strict=True)]
    return sum(visible) / max(sum(pixels), 1)
