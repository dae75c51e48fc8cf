"""`pmpnbp reproduce robot`: does the belief converge for an object of many parts, a mobile manipulator?

The paper: a robot of 12 nodes and 11 edges, of whose base, torso and head the sensor shows parts only; belief samples
at iterations 1 and 1000, and the most likely estimate, from two sides. Here its base is known to 10 cm and 10 degrees
per axis, its joints not at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reproduce import figures, outcomes, reports, robot_scan
from benchmarks.reproduce.experiment import Experiment, Options
from benchmarks.reproduce.outcomes import Outcomes
from benchmarks.reproduce.reports import Claim, Table
from benchmarks.reproduce.scene_runs import asked_of, case_of, perform, scene_scan
from benchmarks.tables import rate
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.palette import INK, part_colours
from pmpnbp.runs.run_log import Asked, Result, RunLog

SCENE = "robot/partial"
ITERATIONS, PARTICLES = 1000, 400
# Standard deviations per axis of what is known of the base.
METRES, DEGREES = 0.10, 10.0
# Metres: the error of a part up to which it is found, and up to which it is found well.
FOUND, WELL = 0.05, 0.02


def render(options: Options, _: RunLog) -> list[Asked]:
    """A scan of another robot, where one is named; then all runs."""
    if options.urdf is not None:
        robot_scan.write(_rendered(options), options.urdf)
    return asked(options)


def asked(options: Options) -> list[Asked]:
    """All runs. The first goes on though it is at rest, to show that the belief stays."""
    known: dict[str, Any] = {"prior": True, "metres": METRES, "degrees": DEGREES}
    if options.urdf is not None:
        digest = robot_scan.digest(_rendered(options), options.urdf)
        known |= {"urdf": str(options.urdf.resolve()), "digest": digest}
    return [
        asked_of(
            SCENE if options.urdf is None else str(_rendered(options)),
            "robust",
            seed,
            particles=options.particles or PARTICLES,
            iterations=iterations(options),
            stop_at_rest=seed != options.seed,
            keep=[1, iterations(options)] if seed == options.seed else [],
            **known,
        )
        for seed in options.seeds
    ]


def iterations(options: Options) -> int:
    """At most."""
    return options.iterations or ITERATIONS


def _rendered(options: Options) -> Path:
    return (options.out / "scan").resolve()


def write(options: Options, run_log: RunLog) -> None:
    """Figures, tables and the report."""
    runs = asked(options)
    results = run_log.results(runs)
    name = SCENE if options.urdf is None else options.urdf.name
    some = outcomes.of_runs(runs, run_log)
    edges = len(case_of(runs[0]).model.edges)
    errors = outcomes.over_iterations(results, "add")
    draw_errors(options, some.parts, errors)
    draw_beliefs(options, runs[0], results[0])
    last = iterations(options)
    captions = {
        "error.png": f"{name}: ADD of each part, median over {options.runs} runs; one that has ended stays as it was.",
        "belief.png": (
            f"{name}: particles after iteration 1 and iteration {last}, and the estimate, from the camera and from "
            f"beside (run of seed {options.seed})."
        ),
    }
    for table in (outcomes.part_table({name: some}), error_table(some.parts, errors), run_table(some)):
        reports.write_table(options.out, table)
    claim = converges(some, edges)
    worst = float(np.array(results[0]["add"][-1])[some.judged].max(initial=0.0))
    sections = [figures_section(some, worst), outcomes.part_section({name: some}), outcomes.time_section({name: some})]
    reports.write_report(options.out, "Robot", options.command, options.named_seeds, [claim], sections, captions)


def draw_errors(options: Options, parts: tuple[str, ...], errors: Array) -> None:
    """A line per part, over iterations. errors : (R, I + 1, N) metres"""
    figure, axes = figures.panels(1, 1, 3.4)
    median = 100 * np.median(errors, axis=0)
    at = np.arange(1, len(median))
    marked = np.unique(np.round(np.geomspace(1, len(at), 12)).astype(int)) - 1
    for part, (title, colour) in enumerate(zip(parts, part_colours(len(parts)), strict=True)):
        axes[0, 0].plot(
            at,
            median[1:, part],
            color=np.array(colour) / 255,
            marker=figures.MARKERS[part % len(figures.MARKERS)],
            markevery=marked.tolist(),
            markersize=4,
            markeredgecolor=INK,
            markeredgewidth=0.3,
            label=title,
        )
    axes[0, 0].set(xlabel="iteration", ylabel="ADD (cm), median over the runs", xscale="log")
    figures.plain(axes[0, 0].xaxis)
    figures.errors_in(axes[0, 0])
    figures.name_lines(figure, axes[0, 0], columns=3)
    figures.save(figure, options.out / "error.png")


def draw_beliefs(options: Options, run: Asked, result: Result) -> None:
    """Particles at the first and the last iteration and the estimate, from two sides."""
    last = iterations(options)
    scan, model = scene_scan(run["scene"]), case_of(run).model
    estimate = np.array(result["kept"][str(last)]["poses"])
    sides = (scan, figures.from_beside(scan, model, estimate))
    figure, axes = figures.panels(3, 2, 4.7)
    drawing = figures.Drawing()
    for column, (seen, side) in enumerate(zip(sides, ("", ", from beside"), strict=True)):
        for row, iteration in enumerate((1, last)):
            particles = result["kept"][str(iteration)]["particles"]
            drawing.particles(axes[row, column], seen, particles, f"iteration {iteration}{side}")
        figures.beside(axes[2, column], drawing.estimate(seen, model, estimate), f"estimate{side}")
    drawing.close()
    figures.closer(axes[:, 0], scan, model, estimate)
    figures.name_parts(figure, result["parts"], columns=3)
    figures.save(figure, options.out / "belief.png")


def error_table(parts: tuple[str, ...], errors: Array) -> Table:
    """ADD of every part by iteration over the runs: median, least, largest."""
    values = (np.median(errors, axis=0), errors.min(axis=0), errors.max(axis=0))
    rows = [
        [iteration, title, *(f"{value[iteration, part]:.6f}" for value in values)]
        for iteration in range(errors.shape[1])
        for part, title in enumerate(parts)
    ]
    return Table("errors", ["iteration", "part", "median_add_m", "least_add_m", "largest_add_m"], rows)


def run_table(some: Outcomes) -> Table:
    """How every run ended; the iteration at rest is empty where it did not come to rest."""
    rows = [
        [
            seed,
            f"{some.seconds[run]:.4f}",
            "" if some.at_rest[run] is None else some.at_rest[run],
            f"{some.add[run, some.judged].mean():.6f}",
            f"{some.add[run, some.judged].max():.6f}",
        ]
        for run, seed in enumerate(some.seeds)
    ]
    return Table("runs", ["seed", "seconds", "at_rest", "mean_add_m", "worst_part_m"], rows)


def measured(some: Outcomes) -> Mapping[str, str]:
    """The figures that are to be stated."""
    seen = some.add[:, some.judged]
    return {
        f"runs with every visible part under {100 * FOUND:.0f} cm": rate(some.found(FOUND), len(seen)),
        f"visible parts under {100 * WELL:.0f} cm, of all runs": rate(int(np.sum(seen < WELL)), seen.size),
        "time": outcomes.time_taken(some),
    }


def figures_section(some: Outcomes, worst: float) -> str:
    """What was measured, in a list. worst : metres, of the visible parts at the first run's last iteration"""
    counted = (
        f"{int(some.judged.sum())} of {len(some.parts)} parts are visible: at least a tenth of each is seen. Errors "
        "and seconds are those at rest; the first run is only then taken on to the last iteration, "
        f"where its visible parts are within {100 * worst:.2f} cm."
    )
    return "\n".join(["## In figures", "", counted, "", *(f"- {what}: {how}" for what, how in measured(some).items())])


def converges(some: Outcomes, edges: int) -> Claim:
    """What the paper says of its robot."""
    text = f"The belief converges for a robot of {len(some.parts)} nodes and {edges} edges"
    said = "; ".join(f"{what}: {how}" for what, how in measured(some).items())
    return Claim(text, reports.verdict_of_runs(some.found(FOUND), len(some.add)), said)


EXPERIMENT = Experiment(perform, (render,), write)
