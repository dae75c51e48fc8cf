"""`pmpnbp reproduce planning`: can a robot tell from the belief whether to act, or to look again first?

The paper: the bottom drawer is to be opened. A robot acts once the standard deviation of every part's position is
under 0.25 cm along x, y and z. In one scene that is so at once; in the other a drawer is hidden, the robot takes a look
from another side, and then it is so. Ellipsoids hold 75 % of the belief.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from app.palette import INK, part_colours
from benchmarks.reproduce import endings, figures, reports
from benchmarks.reproduce.endings import Endings
from benchmarks.reproduce.experiment import Experiment, Options
from benchmarks.reproduce.ledger import Asked, Ledger, Result
from benchmarks.reproduce.reports import Claim, Table
from benchmarks.reproduce.scene_runs import LAST, VARIANTS, asked_of, case_of, perform, scene_scan
from benchmarks.tables import markdown, rate
from pmpnbp.geometry.poses import Array


@dataclass(frozen=True)
class Stage:
    """A look at a scene. views : further scans, beside the first; acts : whether the paper's robot acts upon it"""

    title: str
    scene: str
    views: tuple[str, ...]
    acts: bool


STAGES = {
    "open": Stage("all drawers seen", "cabinet/open", (), True),
    "hidden": Stage("a drawer hidden", "cabinet/self_occluded", (), False),
    "second look": Stage("and a second view", "cabinet/self_occluded", ("cabinet/second_view",), True),
}
ITERATIONS, PARTICLES = 100, 400
# What is known of the frame beforehand, per axis. The paper's own preset has no search and stays at no pose from
# further off: it starts at the truth, or nearly so.
KNOWN: Mapping[str, dict[str, float]] = {"robust": {}, "paper": {"metres": 0.01, "degrees": 1.0}}
# Metres: up to this standard deviation along each axis a link is certain; and the error up to which that is right.
MAX_STD, RIGHT = 0.0025, 0.01
# Of the belief in an ellipsoid, and how many times its size it is drawn.
SHARE, ENLARGED = 0.75, {"robust": 10, "paper": 1}


def asked(options: Options, _: Ledger | None = None) -> list[Asked]:
    """All runs."""
    return [run for variant in KNOWN for stage in STAGES.values() for run in _asked(options, variant, stage)]


def _asked(options: Options, variant: str, stage: Stage) -> list[Asked]:
    return [
        asked_of(
            stage.scene, variant, seed, particles=options.particles or PARTICLES,
            iterations=options.iterations or ITERATIONS, prior=bool(KNOWN[variant]), **KNOWN[variant],
            views=list(stage.views), stop_at_rest=True, keep=[LAST] if seed == options.seed else [],
        )
        for seed in options.seeds
    ]  # fmt: skip


def write(options: Options, ledger: Ledger) -> None:
    """Figures, tables and the report."""
    found: dict[str, dict[str, Endings]] = {}
    captions: dict[str, str] = {}
    drawing = figures.Drawing()
    for variant in KNOWN:
        runs = {name: _asked(options, variant, stage) for name, stage in STAGES.items()}
        found[variant] = {name: endings.endings(some, ledger) for name, some in runs.items()}
        first = {name: ledger.results(some[:1])[0] for name, some in runs.items()}
        draw(options, drawing, variant, found[variant], first)
        larger = f", drawn {ENLARGED[variant]} times as large" if ENLARGED[variant] != 1 else ""
        captions[f"{variant}.png"] = (
            f"{VARIANTS[variant].title}: ellipsoids that hold {100 * SHARE:.0f} % of each part's position{larger} (run "
            f"of seed {options.seed}); and the standard deviation of each part's position along its widest axis, the "
            f"median of {options.runs} runs with a dot for each, beside the threshold of {100 * MAX_STD:.2f} cm; less "
            "than the axis shows stands at its left end."
        )
    drawing.close()
    for table in (part_table(found), stage_table(found)):
        reports.write_table(options.out, table)
    claims = [
        one for variant in KNOWN
        for one in (*(claim(variant, name, found[variant][name]) for name in STAGES), narrows(variant, found[variant]))
    ]  # fmt: skip
    by_stage = {f"{variant}, {name}": some for variant, by in found.items() for name, some in by.items()}
    sections = [decision_section(found), endings.part_section(by_stage)]
    reports.write_report(options.out, "Planning", options.command, options.named_seeds, claims, sections, captions)


def draw(
    options: Options, drawing: figures.Drawing, variant: str, found: Mapping[str, Endings], first: Mapping[str, Result]
) -> None:
    """A row for each stage: ellipsoids over the scan, and deviations beside the threshold."""
    figure, axes = figures.panels(len(STAGES), 2, 4.6, width_ratios=(1, 0.9))
    every = 1000 * np.concatenate([some.std.ravel() for some in found.values()])
    shown = (max(0.5 * min(every.min(), 1000 * MAX_STD), 0.1), 2 * max(every.max(), 1000 * MAX_STD))
    for row, (key, stage) in enumerate(STAGES.items()):
        scan = scene_scan((stage.scene, *stage.views)[-1])
        last = first[key]["kept"][LAST]
        poses, covariances = np.array(last["poses"]), np.array(last["covariances"])
        figures.beside(axes[row, 0], drawing.observed(scan), stage.title)
        figures.draw_ellipsoids(axes[row, 0], scan, poses, covariances, SHARE, ENLARGED[variant])
        case = case_of(_asked(options, variant, stage)[0])
        figures.closer([axes[row, 0]], scan, case.model, case.true_poses)
        draw_deviations(axes[row, 1], found[key], shown)
    axes[-1, 1].set_xlabel("std (mm)")
    figures.name_lines(figure, axes[0, 1], columns=3)
    figures.save(figure, options.out / f"{variant}.png")


def draw_deviations(axes: Axes, some: Endings, shown: tuple[float, float]) -> None:
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


def part_table(found: Mapping[str, Mapping[str, Endings]]) -> Table:
    """Deviation and error of every part in every run."""
    whole = endings.part_table(
        {f"{variant}/{name}": some for variant, by in found.items() for name, some in by.items()}
    )
    rows = [
        [*str(row[0]).split("/"), *row[1:], "yes" if float(str(row[-1])) <= MAX_STD else "no"] for row in whole.rows
    ]
    return Table("parts", ["method", "stage", *whole.header[1:], "certain"], rows)


def stage_table(found: Mapping[str, Mapping[str, Endings]]) -> Table:
    """What was decided in every run."""
    rows = [
        [variant, name, seed, f"{some.std[run].max():.6f}", "act" if some.certain(MAX_STD)[run].all() else "look again",
         int(some.certain(MAX_STD)[run].sum()), f"{some.add[run].max():.6f}", f"{some.seconds[run]:.4f}"]
        for variant, by in found.items() for name, some in by.items() for run, seed in enumerate(some.seeds)
    ]  # fmt: skip
    header = ["method", "stage", "seed", "largest_std_m", "decision", "certain_parts", "worst_part_m", "seconds"]
    return Table("decisions", header, rows)


def decision_section(found: Mapping[str, Mapping[str, Endings]]) -> str:
    """How often the robot would act, and whether it should."""
    rows = []
    for variant, by in found.items():
        for name, some in by.items():
            act = some.certain(MAX_STD).all(axis=1)
            errors = some.add[some.certain(MAX_STD)]
            rows.append([
                VARIANTS[variant].title, STAGES[name].title, "act" if STAGES[name].acts else "look again",
                rate(int(act.sum()), len(act)), f"{1000 * np.median(some.std.max(axis=1)):.1f}", errors_of(errors),
            ])  # fmt: skip
    header = [
        "method",
        "stage",
        "the paper's robot",
        "acts",
        "median largest std (mm)",
        "ADD of parts that are certain",
    ]
    return "\n".join([
        "## Decisions", "",
        f"It acts where the standard deviation of every link's position is at most {100 * MAX_STD:.2f} cm along each "
        "axis. The deviation is that of the particles, which follows the algorithm's own diffusion, and is no error "
        "bar.", "",
        markdown(header, rows), "",
        *(parting(variant, by) for variant, by in found.items()),
    ])  # fmt: skip


def errors_of(errors: Array) -> str:
    """Of parts that are called certain, as part of a sentence. errors : (K,) metres"""
    if len(errors) == 0:
        return "none is certain"
    right = rate(int(np.sum(errors < RIGHT)), len(errors))
    return f"{100 * np.median(errors):.2f} cm in the median, {100 * errors.max():.2f} cm at most; {right} under 1 cm"


def claim(variant: str, name: str, some: Endings) -> Claim:
    """Whether the belief leads to the paper's decision."""
    stage, act = STAGES[name], some.certain(MAX_STD).all(axis=1)
    held = int(np.sum(act == stage.acts))
    said = {True: "certain enough to act", False: "not certain enough to act"}[stage.acts]
    widest = int(np.median(some.std, axis=0).argmax())
    because = (
        f"{int(act.sum())} of {len(act)} runs would act; widest is {some.parts[widest]} with "
        f"{1000 * np.median(some.std[:, widest]):.1f} mm in the median; parts that are certain: "
        f"{errors_of(some.add[some.certain(MAX_STD)])}"
    )
    text = f"The belief is {said}: {stage.title} ({VARIANTS[variant].title})"
    return Claim(text, reports.verdict_of_runs(held, len(act)), because)


def narrows(variant: str, found: Mapping[str, Endings]) -> Claim:
    """Whether a second view takes from the spread of the part that was seen least."""
    before, after = found["hidden"], found["second look"]
    part = int(before.shares.argmin())
    held = int(np.sum(after.std[:, part] < before.std[:, part]))
    because = (
        f"{before.parts[part]}, {1000 * np.median(before.std[:, part]):.1f} mm with one view and "
        f"{1000 * np.median(after.std[:, part]):.1f} mm with two in the median, narrower in {held} of "
        f"{len(before.std)} runs"
    )
    text = f"A second view narrows the belief of the hidden part ({VARIANTS[variant].title})"
    return Claim(text, reports.verdict_of_runs(held, len(before.std)), because)


def parting(variant: str, found: Mapping[str, Endings]) -> str:
    """Whether any threshold would have led to the paper's decisions in all runs."""
    widest = {name: 1000 * some.std.max(axis=1) for name, some in found.items()}
    acts = max(float(widest[name].max()) for name, stage in STAGES.items() if stage.acts)
    waits = min(float(widest[name].min()) for name, stage in STAGES.items() if not stage.acts)
    said = (
        f"the widest part has at most {acts:.1f} mm where the paper's robot acts, and at least {waits:.1f} mm where it "
        "looks again"
    )
    told = f"any threshold in between parts them: {said}" if acts < waits else f"no threshold parts all runs: {said}"
    return f"- {VARIANTS[variant].title}: {told}."


EXPERIMENT = Experiment(perform, (asked,), write)
