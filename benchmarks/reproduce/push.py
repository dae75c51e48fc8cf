"""`pmpnbp reproduce push`: the paper's pull form against the push form it replaces, on a planar figure in clutter.

The companion comparison (Desingh, Opipari and Jenkins 2018): a circle with four two-link arms, nine nodes, among shapes
of the same sizes. Push is nonparametric belief propagation with Gibbs-sampled products (Sudderth et al. 2003).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.reproduce import figures, reports
from benchmarks.reproduce.experiment import Experiment, Options
from benchmarks.reproduce.planar import run as planar
from benchmarks.reproduce.planar.pattern import four_arms, outlines
from benchmarks.reproduce.push_runs import CLUTTER, FOUND, Found, Runs, components_of, every_run, gathered, perform
from benchmarks.reproduce.reports import Claim, Table
from benchmarks.statistics import difference_interval, mean_interval
from benchmarks.tables import markdown, rate
from pmpnbp.runs.run_log import RunLog

# From here on the pairs of components outweigh what grows with their number alone.
LARGE = 100
TITLES = {"pull": "pull (PMPNBP)", "push": "push (Gibbs-sampled products)"}


def write(options: Options, run_log: RunLog) -> None:
    """Figures, tables and the report."""
    found = gathered(options, run_log)
    draw_scene(options, run_log, "figure.png")
    draw_time(options, found, "error_over_time.png")
    draw_components(options, found, "components.png")
    reports.write_table(options.out, component_table(found))
    reports.write_table(options.out, iteration_table(found))
    captions = {
        "figure.png": "The first picture, a figure among twenty distractors, and where each method finds it.",
        "error_over_time.png": "Mean error of the nodes over computing time, mean over the runs.",
        "components.png": "Final error with its 0.95 interval, and seconds of an iteration, over the components.",
    }
    reports.write_report(
        options.out,
        "Pull against push",
        options.command,
        options.named_seeds,
        claims(found),
        [table_section(found), growth_section(found)],
        captions,
    )


def draw_scene(options: Options, run_log: RunLog, name: str) -> None:
    """The picture of the first seed, and over it both estimates with the most components."""
    seen = planar.scene(options.seed, CLUTTER)
    figure, axes = figures.panels(1, 3, 1.55)
    figures.beside(axes[0, 0], 1.0 - 0.75 * np.repeat(seen.picture[..., None], 3, axis=2), "picture")
    most = max(components_of(options))
    asked = {
        one["method"]: one
        for one in every_run(options, run_log)
        if one["seed"] == options.seed and one["components"] == most
    }
    for place, method in enumerate(planar.METHODS, start=1):
        (result,) = run_log.results([asked[method]])
        faint = 1.0 - 0.25 * np.repeat(seen.picture[..., None], 3, axis=2)
        figures.beside(axes[0, place], faint, f"{method}, M = {most}")
        for line in outlines(four_arms(), np.array(result["estimate"])):
            axes[0, place].plot(line[:, 0], line[:, 1], color=figures.STROKES[method][0], linewidth=0.9)
    figures.save(figure, options.out / name)


def draw_time(options: Options, found: Found, name: str) -> None:
    """Error over the seconds spent, a line for each number of components."""
    figure, axes = figures.panels(1, 1, 2.9)
    for method, by_components in found.items():
        colour, stroke = figures.STROKES[method]
        for components, marker in zip(by_components, figures.MARKERS, strict=False):
            runs = by_components[components]
            axes[0, 0].plot(
                runs.spent,
                runs.mean_error.mean(axis=0),
                stroke,
                color=colour,
                marker=marker,
                markersize=3,
                markevery=6,
                label=f"{method}, M = {components}",
            )
    axes[0, 0].set(xlabel="computing time (s)", ylabel="mean error (pixels)", xscale="log")
    figures.errors_in(axes[0, 0], 4.0)
    axes[0, 0].set_yticks([5, 10, 20, 50, 100])
    figures.plain(axes[0, 0].xaxis)
    figures.name_lines(figure, axes[0, 0])
    figures.save(figure, options.out / name)


def draw_components(options: Options, found: Found, name: str) -> None:
    """Final error and seconds an iteration over M."""
    figure, axes = figures.panels(2, 1, 3.9)
    for method, by_components in found.items():
        colour, stroke = figures.STROKES[method]
        sizes = np.array(list(by_components))
        ends = np.array([mean_interval(runs.final) for runs in by_components.values()]).T
        figures.band(axes[0, 0], sizes, ends, method, TITLES[method])
        axes[1, 0].plot(
            sizes,
            [1000 * runs.iteration_seconds for runs in by_components.values()],
            stroke,
            color=colour,
            marker="o",
            markersize=3,
        )
    axes[0, 0].set(xlabel="components M", ylabel="mean error (pixels)", xscale="log", ylim=(0, None))
    axes[1, 0].set(xlabel="components M", ylabel="an iteration (ms)", xscale="log", yscale="log")
    figures.plain(axes[1, 0].yaxis)
    for one in axes[:, 0]:
        one.set_xticks(sizes, [str(size) for size in sizes])
        one.minorticks_off()
    figures.name_lines(figure, axes[0, 0], columns=1)
    figures.save(figure, options.out / name)


def component_table(found: Found) -> Table:
    """A row for each method and number of components."""
    rows = []
    for method, by_components in found.items():
        for components, runs in by_components.items():
            mean, low, high = mean_interval(runs.final)
            rows.append(
                [
                    method,
                    components,
                    len(runs.errors),
                    f"{mean:.3f}",
                    f"{low:.3f}",
                    f"{high:.3f}",
                    f"{runs.nodes_found.mean():.4f}",
                    runs.successes,
                    f"{1000 * runs.iteration_seconds:.4f}",
                    runs.unary,
                    runs.pairs,
                ]
            )
    header = [
        "method",
        "components",
        "runs",
        "error_px",
        "low_px",
        "high_px",
        "nodes_found",
        "successes",
        "iteration_ms",
        "unary_evaluations",
        "pair_evaluations",
    ]
    return Table("components", header, rows)


def iteration_table(found: Found) -> Table:
    """Mean error and median seconds spent, iteration by iteration."""
    rows = [
        [method, components, k + 1, f"{spent:.5f}", f"{error:.3f}"]
        for method, by_components in found.items()
        for components, runs in by_components.items()
        for k, (spent, error) in enumerate(zip(runs.spent, runs.mean_error.mean(axis=0), strict=True))
    ]
    return Table("iterations", ["method", "components", "iteration", "seconds", "error_px"], rows)


def table_section(found: Found) -> str:
    """Errors, successes and seconds, as Markdown."""
    rows = []
    for method, by_components in found.items():
        for components, runs in by_components.items():
            mean, low, high = mean_interval(runs.final)
            rows.append(
                [
                    TITLES[method],
                    components,
                    f"{mean:.1f} ({low:.1f} to {high:.1f})",
                    f"{100 * runs.nodes_found.mean():.0f} %",
                    rate(runs.successes, len(runs.errors)),
                    f"{1000 * runs.iteration_seconds:.1f}",
                    f"{runs.run_seconds:.2f}",
                ]
            )
    header = [
        "method",
        "M",
        "mean error (pixels, 95 %)",
        f"nodes within {FOUND:.0f} pixels",
        "runs with seven of nine",
        "ms an iteration",
        "s a run",
    ]
    return "\n".join(["## By number of components", "", markdown(header, rows)])


def exponent(by_components: Mapping[int, Runs]) -> float:
    """The power of M that seconds an iteration grow with, from LARGE on (least squares of logarithms)."""
    sizes = [size for size in by_components if size >= LARGE] or list(by_components)
    if len(sizes) < 2:
        return float("nan")
    seconds = [by_components[size].iteration_seconds for size in sizes]
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def growth_section(found: Found) -> str:
    """How time grows, as Markdown."""
    lines = [
        "## Growth of time",
        "",
        f"From M = {LARGE} on an iteration takes seconds that grow as M to the power of:",
        "",
    ]
    return "\n".join([*lines, *(f"- {TITLES[method]}: {exponent(runs):.2f}" for method, runs in found.items())])


def claims(found: Found) -> list[Claim]:
    """What the paper says of the push form."""
    pull, push = found["pull"], found["push"]
    ratios = [push[size].iteration_seconds / pull[size].iteration_seconds for size in pull]
    said = ", ".join(f"{ratio:.1f} at M = {size}" for size, ratio in zip(pull, ratios, strict=True))
    cheaper = Claim(
        "Gibbs-sampled products limit the number of components; the pull form is cheaper",
        reports.verdict([ratio > 1 for ratio in ratios]),
        f"an iteration of push takes as many times as long as one of pull: {said}; both grow with pairs of components, "
        f"pull as M to the {exponent(pull):.1f}, push to the {exponent(push):.1f}",
    )
    sizes = [(push[size], pull[size], f"at M = {size}") for size in pull]
    fitting = [(size, _best_within(pull, push[size].run_seconds)) for size in push]
    times = [
        (push[size], pull[best], f"of push with M = {size} against pull with {best}")
        for size, best in fitting
        if best is not None
    ]
    return [
        cheaper,
        _more_accurate("With as many components the pull form is the more accurate", sizes),
        _more_accurate("In the same computing time the pull form is the more accurate", times),
    ]


def _more_accurate(text: str, compared: Sequence[tuple[Runs, Runs, str]]) -> Claim:
    """Whether pull's error is the smaller one. compared : runs of push and of pull, and what tells which they are"""
    held, words = [], []
    for push, pull, which in compared:
        mean, low, high = difference_interval(push.final, pull.final)
        held.append(low > 0)
        words.append(f"{mean:+.1f} ({low:+.1f} to {high:+.1f}) {which}")
    said = f"push's mean error minus pull's, pixels, 95 % interval: {'; '.join(words)}"
    return Claim(text, reports.verdict(held) if held else reports.NOT, said)


def _best_within(by_components: Mapping[int, Runs], seconds: float) -> int | None:
    """The most components with which all iterations take no longer."""
    fitting = [size for size, runs in by_components.items() if runs.run_seconds <= seconds]
    return max(fitting, default=None)


EXPERIMENT = Experiment(perform, (every_run,), write)
