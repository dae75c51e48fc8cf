"""`pmpnbp reproduce planning`: can a robot tell from the belief whether to act, or to look again first?

The paper: the bottom drawer is to be opened. A robot acts once the standard deviation of its position is under 0.25 cm
along x, y and z. In one scene that is so at once; in the other the open top drawer hides the bottom one, the robot
lowers its camera, and then it is so. Ellipsoids hold 75 % of the belief.

The paper takes the deviation of the belief's particles. Beside it stands that of draws from the posterior of the whole
object, which does not depend on how far particles are diffused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmarks.reproduce import figures, outcomes, reports
from benchmarks.reproduce.experiment import Experiment, Options
from benchmarks.reproduce.outcomes import Outcomes
from benchmarks.reproduce.reports import Claim, Table
from benchmarks.reproduce.scene_runs import LAST, asked_of, case_of, perform, scene_scan
from benchmarks.tables import markdown, rate
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.palette import INK, part_colours
from pmpnbp.runs.run_log import Asked, Result, RunLog
from pmpnbp.settings import SessionOptions


@dataclass(frozen=True)
class Stage:
    """A look at a scene. views : further scans, beside the first; acts : whether the paper's robot acts upon it"""

    title: str
    scene: str
    views: tuple[str, ...]
    acts: bool


@dataclass(frozen=True)
class Way:
    """To tell how sure it is. variant : of the inference; posterior : whether by draws given the scan, else by the
    belief's particles; known : `metres` and `degrees` to which the frame is known beforehand, per axis, if at all"""

    title: str
    variant: str
    posterior: bool
    known: Mapping[str, float]


STAGES = {
    "open": Stage("all drawers seen", "cabinet/open", (), True),
    "hidden": Stage("the bottom drawer hidden", "cabinet/from_above", (), False),
    "lowered": Stage("and the camera lowered", "cabinet/from_above", ("cabinet/lowered",), True),
}
# The part that is to be moved.
TASK = "drawer3"
WAYS = {
    "posterior": Way("robust, draws given the scan", "robust", True, {}),
    "particles": Way("robust, particles", "robust", False, {}),
    # The paper's own preset has no search and stays at no pose from further off: it starts at the truth, or nearly so.
    "paper": Way("as in the paper, particles", "paper", False, {"metres": 0.01, "degrees": 1.0}),
}
ITERATIONS, PARTICLES = 100, 400
# Metres: up to this standard deviation along each axis a link is certain; and the error up to which that is right.
MAX_STD, RIGHT = SessionOptions.max_std, 0.01
# What deviations are, in a sentence.
OF_BOTH = "of draws given the scan, or of the belief's particles, which follow the algorithm's own diffusion"
# Of the belief in an ellipsoid.
SHARE = 0.75


def asked(options: Options, _: RunLog | None = None) -> list[Asked]:
    """All runs. Of the preset robust the same ones are judged both ways."""
    return [run for way in ("posterior", "paper") for stage in STAGES.values() for run in _asked(options, way, stage)]


def _asked(options: Options, way: str, stage: Stage) -> list[Asked]:
    variant, known = WAYS[way].variant, WAYS[way].known
    return [
        asked_of(
            stage.scene,
            variant,
            seed,
            particles=options.particles or PARTICLES,
            iterations=options.iterations or ITERATIONS,
            prior=bool(known),
            **known,
            views=list(stage.views),
            stop_at_rest=True,
            posterior=variant == "robust",
            keep=[LAST] if seed == options.seed else [],
        )
        for seed in options.seeds
    ]


def write(options: Options, run_log: RunLog) -> None:
    """Figures, tables and the report."""
    found: dict[str, dict[str, Outcomes]] = {}
    captions: dict[str, str] = {}
    drawing = figures.Drawing()
    for key, way in WAYS.items():
        runs = {name: _asked(options, key, stage) for name, stage in STAGES.items()}
        ended = outcomes.given_the_scan if way.posterior else outcomes.of_runs
        found[key] = {name: ended(some, run_log) for name, some in runs.items()}
        first = {name: run_log.results(some[:1])[0] for name, some in runs.items()}
        draw(options, drawing, key, found[key], first)
        captions[f"{key}.png"] = (
            f"{way.title.capitalize()}: ellipsoids that hold {100 * SHARE:.0f} % of each part's position (run of "
            f"seed {options.seed}); and the standard deviation of each part's position along its widest axis, the "
            f"median of {options.runs} runs with a dot for each, beside the threshold of {100 * MAX_STD:.2f} cm; less "
            "than the axis shows stands at its left end."
        )
    drawing.close()
    for table in (part_table(found), stage_table(found)):
        reports.write_table(options.out, table)
    claims = [
        one
        for key in WAYS
        for one in (*(claim(key, name, found[key][name]) for name in STAGES), narrows(key, found[key]))
    ]
    by_stage = {f"{key}, {name}": some for key, by in found.items() for name, some in by.items()}
    sections = [decision_section(found), outcomes.part_section(by_stage, OF_BOTH)]
    reports.write_report(options.out, "Planning", options.command, options.named_seeds, claims, sections, captions)


def draw(
    options: Options, drawing: figures.Drawing, key: str, found: Mapping[str, Outcomes], first: Mapping[str, Result]
) -> None:
    """A row for each stage: ellipsoids over the scan, and deviations beside the threshold."""
    figure, axes = figures.panels(len(STAGES), 2, 4.6, width_ratios=(1, 0.9))
    every = 1000 * np.concatenate([some.std.ravel() for some in found.values()])
    shown = (max(0.5 * min(every.min(), 1000 * MAX_STD), 0.1), 2 * max(every.max(), 1000 * MAX_STD))
    for row, (name, stage) in enumerate(STAGES.items()):
        scan = scene_scan((stage.scene, *stage.views)[-1])
        last = first[name]["kept"][LAST]
        spread = first[name]["posterior"] if WAYS[key].posterior else last
        poses, covariances = np.array(spread["poses"]), np.array(spread["covariances"])
        figures.beside(axes[row, 0], drawing.observed(scan), stage.title)
        figures.draw_ellipsoids(axes[row, 0], scan, poses, covariances, SHARE)
        case = case_of(_asked(options, key, stage)[0])
        figures.closer([axes[row, 0]], scan, case.model, case.true_poses)
        draw_deviations(axes[row, 1], found[name], shown)
    axes[-1, 1].set_xlabel("std (mm)")
    figures.name_lines(figure, axes[0, 1], columns=3)
    figures.save(figure, options.out / f"{key}.png")


def draw_deviations(axes: Axes, some: Outcomes, shown: tuple[float, float]) -> None:
    """The median of each part in its colour, and a dot for each run, on a logarithmic axis, millimetres from and to
    `shown`; less stands at its left end: a belief that is one particle has no spread at all."""
    at, std = np.arange(len(some.parts)), np.maximum(1000 * some.std, shown[0])
    colour, stroke = figures.STROKES["threshold"]
    axes.axvline(1000 * MAX_STD, color=colour, linestyle=stroke, label=f"threshold, {1000 * MAX_STD:.1f} mm")
    colours = np.array(part_colours(len(at))) / 255
    axes.scatter(
        np.median(std, axis=0), at, s=45, clip_on=False, marker="D", c=colours, edgecolors=INK, linewidths=0.4, zorder=3
    )
    axes.plot([], [], "D", color="white", markeredgecolor=INK, markeredgewidth=0.4, markersize=5, label="median")
    axes.plot(
        std.ravel(),
        np.broadcast_to(at, std.shape).ravel(),
        "o",
        color=INK,
        markersize=1.5,
        zorder=4,
        clip_on=False,
        label="run",
    )
    axes.set_xscale("log")
    figures.plain(axes.xaxis)
    axes.set_xlim(*shown)
    axes.set_yticks(at, some.parts)
    axes.set_ylim(len(at) - 0.4, -0.6)
    axes.grid(False, axis="y")


def part_table(found: Mapping[str, Mapping[str, Outcomes]]) -> Table:
    """Deviation and error of every part in every run."""
    by_stage = {f"{key}/{name}": some for key, by in found.items() for name, some in by.items()}
    whole = outcomes.part_table(by_stage)
    certain = np.concatenate([some.certain(MAX_STD).ravel() for some in by_stage.values()])
    rows = [
        [*str(row[0]).split("/"), *row[1:], "yes" if sure else "no"]
        for row, sure in zip(whole.rows, certain, strict=True)
    ]
    return Table("parts", ["method", "stage", *whole.header[1:], "certain"], rows)


def stage_table(found: Mapping[str, Mapping[str, Outcomes]]) -> Table:
    """What was decided in every run."""
    rows = [
        [
            key,
            name,
            seed,
            f"{std_of_task(some)[run]:.6f}",
            "act" if acts(some)[run] else "look again",
            f"{some.add[run, some.parts.index(TASK)]:.6f}",
            int(some.certain(MAX_STD)[run].sum()),
            f"{some.seconds[run]:.4f}",
        ]
        for key, by in found.items()
        for name, some in by.items()
        for run, seed in enumerate(some.seeds)
    ]
    header = ["method", "stage", "seed", "task_std_m", "decision", "task_add_m", "certain_parts", "seconds"]
    return Table("decisions", header, rows)


def std_of_task(some: Outcomes) -> Array:
    """(R,) metres, of the part that is to be moved."""
    return some.std[:, some.parts.index(TASK)]


def acts(some: Outcomes) -> NDArray[np.bool_]:
    """(R,): whether the robot would."""
    return some.certain(MAX_STD)[:, some.parts.index(TASK)]


def decision_section(found: Mapping[str, Mapping[str, Outcomes]]) -> str:
    """How often the robot would act, and whether it should."""
    rows = []
    for key, by in found.items():
        for name, some in by.items():
            std, off = std_of_task(some), some.add[:, some.parts.index(TASK)]
            rows.append(
                [
                    WAYS[key].title,
                    STAGES[name].title,
                    "act" if STAGES[name].acts else "look again",
                    rate(int(acts(some).sum()), len(std)),
                    f"{1000 * np.median(std):.1f}",
                    f"{1000 * np.median(off):.1f}",
                    errors_of(some.add[some.certain(MAX_STD)]),
                ]
            )
    header = [
        "way to tell",
        "stage",
        "the paper's robot",
        "acts",
        f"median std of {TASK} (mm)",
        "its median ADD (mm)",
        "ADD of all parts that are certain",
    ]
    return "\n".join(
        [
            "## Decisions",
            "",
            f"{TASK} is to be opened. The robot acts where the standard deviation of its position is at most "
            f"{100 * MAX_STD:.2f} cm along each axis. That of the belief's particles follows the algorithm's own "
            "diffusion; that of draws given the scan is of the posterior of the whole object, as a result tells it "
            '(docs/algorithm.md, "How sure one can be").',
            "",
            markdown(header, rows),
            "",
            *(parting(key, by) for key, by in found.items()),
        ]
    )


def errors_of(errors: Array) -> str:
    """Of parts that are called certain, as part of a sentence. errors : (K,) metres"""
    if len(errors) == 0:
        return "none is certain"
    right = rate(int(np.sum(errors < RIGHT)), len(errors))
    return f"{100 * np.median(errors):.2f} cm in the median, {100 * errors.max():.2f} cm at most; {right} under 1 cm"


def claim(key: str, name: str, some: Outcomes) -> Claim:
    """Whether the belief leads to the paper's decision."""
    stage, act = STAGES[name], acts(some)
    held = int(np.sum(act == stage.acts))
    off = some.add[:, some.parts.index(TASK)]
    said = {True: "certain enough to act", False: "not certain enough to act"}[stage.acts]
    because = (
        f"{int(act.sum())} of {len(act)} runs would act; {TASK} has {1000 * np.median(std_of_task(some)):.1f} mm in "
        f"the median and is {1000 * np.median(off):.1f} mm off; parts that are certain: "
        f"{errors_of(some.add[some.certain(MAX_STD)])}"
    )
    text = f"The belief is {said}: {stage.title} ({WAYS[key].title})"
    return Claim(text, reports.verdict_of_runs(held, len(act)), because)


def narrows(key: str, found: Mapping[str, Outcomes]) -> Claim:
    """Whether another view takes from the spread of the part that was hidden."""
    before, after = (1000 * std_of_task(found[name]) for name in ("hidden", "lowered"))
    held = int(np.sum(after < before))
    because = (
        f"{TASK}, {np.median(before):.1f} mm with one view and {np.median(after):.1f} mm with two in the median, "
        f"narrower in {held} of {len(before)} runs"
    )
    text = f"Another view narrows the belief of the hidden part ({WAYS[key].title})"
    return Claim(text, reports.verdict_of_runs(held, len(before)), because)


def parting(key: str, found: Mapping[str, Outcomes]) -> str:
    """Whether any threshold would have led to the paper's decisions in all runs."""
    std = {name: 1000 * std_of_task(some) for name, some in found.items()}
    most = max(float(std[name].max()) for name, stage in STAGES.items() if stage.acts)
    least = min(float(std[name].min()) for name, stage in STAGES.items() if not stage.acts)
    said = (
        f"{TASK} has at most {most:.1f} mm where the paper's robot acts, and at least {least:.1f} mm where it looks "
        "again"
    )
    told = f"any threshold in between parts them: {said}" if most < least else f"no threshold parts all runs: {said}"
    return f"- {WAYS[key].title}: {told}."


EXPERIMENT = Experiment(perform, (asked,), write)
