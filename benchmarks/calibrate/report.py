"""What is written of a calibration? Tables, figures, and a report whose first sentence says whether the belief is
honest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from benchmarks.calibrate import judgement
from benchmarks.calibrate import ranks as statistic
from benchmarks.calibrate.findings import Found, Mask, Rate, Uniformity, gathered, rate_of, uniformities
from benchmarks.calibrate.judgement import LEVELS, SURE
from benchmarks.calibrate.runs import REFUSED
from benchmarks.calibrate.task import Task
from benchmarks.reproduce import figures, reports
from benchmarks.reproduce.experiment import Options
from benchmarks.reproduce.reports import Table
from benchmarks.statistics import wilson
from benchmarks.tables import markdown
from pmpnbp.geometry.poses import Array
from pmpnbp.runs.run_log import Asked, RunLog
from pmpnbp.scene.prior import UniformPrior

VERDICTS = ("good", "doubtful", "none", REFUSED)
# Columns of histograms, and histograms at most: those of the least chances.
ACROSS, DRAWN = 3, 60
# Of a histogram's bars nearly all lie within this interval, if ranks are uniform.
BAND = 0.99
NOMINAL = np.linspace(0.02, 0.98, 49)
# Millimetres that distances are drawn at, at least, and what is left around them, as a factor.
LEAST, AROUND = 0.01, 1.5


def write(task: Task, asked: Sequence[Asked], options: Options, run_log: RunLog) -> None:
    """Figures, tables and the report of all runs that were asked for."""
    results = run_log.results(asked)
    found = gathered(task.model, asked, results)
    good = found.good
    uniform = uniformities(good)
    verdicts = {
        absent: [result["verdict"] for one, result in zip(asked, results, strict=True) if one["absent"] is absent]
        for absent in (False, True)
    }
    is_good = np.array([verdict == "good" for verdict in verdicts[True]], dtype=bool)
    false_finds = rate_of(is_good, np.ones_like(is_good), SURE)
    verdict = judgement.judged(good, uniform, false_finds, task.max_std)
    captions = {}
    if len(good.seeds):
        draw_ranks(options, good, uniform, "ranks.png")
        draw_coverage(options, good, "coverage.png")
        draw_reliability(options, task, found, "reliability.png")
        captions = {
            "ranks.png": f"Ranks of the truth among the draws, runs with a good fit. Of an honest posterior "
            f"{100 * BAND:.0f} % of the bars end in the grey band; high at both ends the draws are too narrow, high in "
            f"the middle too wide.",
            "coverage.png": "Share of truths within the region that holds a share of the draws, runs with a good fit: "
            "on the diagonal the belief is honest, below overconfident. Bands are 95 % intervals, each run counting "
            "once.",
            "reliability.png": "Distance from the truth (eq. 12) against what the posterior expects of it, a dot for "
            "each link and run.",
        }
    for table in (
        _rank_table(uniform, good),
        _coverage_table(found, good),
        _run_table(asked, results),
        _link_table(found),
    ):
        reports.write_table(options.out, table)
    sections = [
        " ".join(
            [verdict.sentence(f"'{task.model.name}'", len(good.seeds)), verdict.coverage, _found_sentence(verdicts)]
        ),
        reports.how(options.command, options.named_seeds),
        _setting_section(task),
        _coverage_section(found, good),
        _certain_section(task, found),
        _fit_section(found, verdicts),
        _rank_section(uniform),
    ]
    reports.write_sections(options.out, f"Calibration of {task.model.name}", sections, captions)


def _found_sentence(verdicts: dict[bool, list[str]]) -> str:
    present, absent = (_simple(some.count("good"), len(some)) for some in (verdicts[False], verdicts[True]))
    said = f"The fit is good in {present} runs with the object"
    return said + (f", and in {absent} without it." if verdicts[True] else ".")


def _simple(count: int, runs: int) -> Rate:
    return Rate(count, runs, runs, *wilson(count, runs))


def _setting_section(task: Task) -> str:
    camera, prior = task.camera, task.prior
    eye = ", ".join(f"{x:.2f}" for x in camera.pose_world_camera[:3])
    known = f"{prior.orientation}, anywhere" if isinstance(prior, UniformPrior) else f"roughly where '{prior.link}' is,"
    lines = [
        "## What was asked",
        "",
        f"- The object {known} in the region {','.join(f'{x:.3f}' for x in task.region)} (metres, world), its joints "
        f"anywhere within their limits; at least half of it in the picture.",
        f"- A camera of {camera.width}x{camera.height} pixels, focal length {camera.fx:.0f}, at {eye}; the noise of "
        f"{task.sensor.replace('_', ' ')}; a floor right below the object, a wall behind the region. No clutter, no "
        f"wrong model, no bias: those are not in these figures.",
        f"- {task.particles} particles, {task.iterations} iterations at most; certain at {1000 * task.max_std:g} mm.",
    ]
    return "\n".join(lines)


def _coverage_section(found: Found, good: Found) -> str:
    header = ["of", "runs", *(f"in the {100 * level:.0f} % region" for level in LEVELS)]
    rows = []
    for title, some in (("", good), (", any fit", found)):
        for one in judgement.coverages(some):
            rows.append([f"{one.what}{title}", one.rates[0].runs, *one.rates])
    told = (
        "Of a link's position the region is the ellipsoid about the estimate, of the covariance's form, that holds the "
        "share of the draws; of a joint the central interval. Hidden is less than a tenth measured. Runs with a good "
        "fit first, then all. The 95 % intervals count each run once, as its links are off together."
    )
    return "\n".join(["## Coverage", "", told, "", markdown(header, rows)])


def _certain_section(task: Task, found: Found) -> str:
    everywhere = np.ones_like(found.certain)
    rows = [
        ["of links said to be certain, within 1 cm and 2°", rate_of(~found.wrong, found.certain)],
        ["of seen links within 3 mm, said to be certain", rate_of(found.certain, found.near)],
        ["of all links, confidently wrong", rate_of(found.confidently_wrong, everywhere)],
    ]
    told = (
        f"A link is certain at {1000 * task.max_std:g} mm; the angle counts where it is longer than 10 cm. Confidently "
        f"wrong is over 2 cm and over five standard deviations off."
    )
    return "\n".join(["## Certain", "", told, "", markdown(["what", "rate"], rows)])


def _fit_section(found: Found, verdicts: dict[bool, list[str]]) -> str:
    rows = [
        [title, len(some), *(_simple(some.count(verdict), len(some)) for verdict in VERDICTS)]
        for title, some in (("with the object", verdicts[False]), ("without it", verdicts[True]))
    ]
    drawn = ""
    if len(found.seeds):
        drawn = (
            f"Effective draws: {np.median(found.effective):.0f} in the median, {found.effective.min():.0f} at least."
        )
    told = (
        f"In the object's place are boxes of about its size. Refused is a scan in whose region nothing may be an "
        f"object. {drawn}"
    )
    header = ["runs", "", *(f"fit {VERDICTS[0]}", *VERDICTS[1:])]
    return "\n".join(["## Fit", "", told.strip(), "", markdown(header, rows)])


def _rank_section(uniform: Sequence[Uniformity]) -> str:
    odd = [one for one in sorted(uniform, key=lambda one: one.judged) if one.judged < 0.05]
    told = (
        f"Chi-square over the bars of each of {len(uniform)} histograms, one rank a run, and p after Holm: where all "
        f"are uniform, the least is below 0.05 in one calibration of twenty. "
    )
    if not odd:
        return "\n".join(["## Ranks", "", told + "None is."])
    rows = [[one.of.name, len(one.of.ranks), f"{one.chance:.2g}", f"{one.judged:.2g}", one.departure] for one in odd]
    return "\n".join(
        ["## Ranks", "", told.strip(), "", markdown(["coordinate", "runs", "p", "after Holm", "draws"], rows)]
    )


def _rank_table(uniform: Sequence[Uniformity], good: Found) -> Table:
    bars = statistic.bars(len(good.seeds))
    rows = [
        [
            one.of.name,
            len(one.of.ranks),
            f"{one.chance:.6g}",
            f"{one.judged:.6g}",
            *statistic.counts(one.of.ranks).astype(int),
        ]
        for one in uniform
    ]
    header = ["coordinate", "runs", "p", "p_holm", *(f"bar_{k + 1}" for k in range(bars))]
    return Table("ranks", header, rows)


def _coverage_table(found: Found, good: Found) -> Table:
    rows = [
        [fit, one.what, level, rate.count, rate.cases, rate.runs, f"{rate.low:.4f}", f"{rate.high:.4f}"]
        for fit, some in (("good", good), ("any", found))
        for one in judgement.coverages(some)
        for level, rate in zip(LEVELS, one.rates, strict=True)
    ]
    return Table("coverage", ["fit", "of", "nominal", "within", "cases", "runs", "low", "high"], rows)


def _run_table(asked: Sequence[Asked], results: Sequence[dict[str, object]]) -> Table:
    rows = [
        [one["seed"], one["absent"], result["verdict"], result.get("at_rest", ""), result.get("effective", "")]
        for one, result in zip(asked, results, strict=True)
    ]
    return Table("runs", ["seed", "absent", "fit", "at_rest", "effective_draws"], rows)


def _link_table(found: Found) -> Table:
    rows = [
        [
            seed,
            part,
            f"{found.shares[row, node]:.4f}",
            f"{found.add[row, node]:.7f}",
            f"{found.expected_add[row, node]:.7f}",
            f"{found.turned[row, node]:.6f}",
            f"{found.ellipsoid_ranks[row, node]:.6f}",
            bool(found.certain[row, node]),
            bool(found.wrong[row, node]),
        ]
        for row, seed in enumerate(found.seeds)
        for node, part in enumerate(found.parts)
    ]
    header = ["seed", "part", "visible_share", "add_m", "expected_add_m", "turned_rad", "ellipsoid_rank"]
    return Table("links", [*header, "certain", "wrong"], rows)


def draw_ranks(options: Options, good: Found, uniform: Sequence[Uniformity], name: str) -> None:
    """A histogram for each coordinate."""
    shown = {one.of.name for one in sorted(uniform, key=lambda one: one.chance)[:DRAWN]}
    coordinates = [one.of for one in uniform if one.of.name in shown]
    rows = -(-len(coordinates) // ACROSS)
    figure, axes = figures.panels(rows, ACROSS, max(0.75 * rows, 1.6), sharex=True, sharey=True)
    bars, runs = statistic.bars(len(good.seeds)), len(good.seeds)
    low, high = stats.binom.interval(BAND, runs, 1 / bars)
    for place, one in zip(axes.flat, coordinates, strict=False):
        place.axhspan(low, high, color="#d0d0d0", linewidth=0)
        place.bar((np.arange(bars) + 0.5) / bars, statistic.counts(one.ranks), 0.9 / bars, color="#0072B2")
        place.set_title(one.name, fontsize=6, pad=2)
        place.set(xlim=(0, 1), xticks=[0, 0.5, 1], xticklabels=["0", "0.5", "1"])
        place.tick_params(labelsize=6)
        place.grid(False)
    for place in list(axes.flat)[len(coordinates) :]:
        place.axis("off")
    figures.save(figure, options.out / name)


def draw_coverage(options: Options, good: Found, name: str) -> None:
    """The share of truths within regions over the share of draws that these hold."""
    figure, axes = figures.panels(1, 1, 3.4)
    place = axes[0, 0]
    place.plot([0, 1], [0, 1], color="#777777", linewidth=0.6)
    for one, key in zip(_curves(good), ("seen", "hidden", "joints"), strict=True):
        label, at, among = one
        if among.any():
            found = [rate_of(at <= level, among) for level in NOMINAL]
            interval = np.array([[rate.share, rate.low, rate.high] for rate in found]).T
            figures.band(place, NOMINAL, interval, key, label)
    place.set(xlabel="share of the draws", ylabel="share of the truths", xlim=(0, 1), ylim=(0, 1), aspect="equal")
    figures.name_lines(figure, place, columns=3)
    figures.save(figure, options.out / name)


def _curves(good: Found) -> list[tuple[str, Array, Mask]]:
    return [
        ("seen links", good.ellipsoid_ranks, good.seen),
        ("hidden links", good.ellipsoid_ranks, ~good.seen),
        ("joints", good.joint_regions, np.ones_like(good.joint_regions, dtype=bool)),
    ]


def draw_reliability(options: Options, task: Task, found: Found, name: str) -> None:
    """Errors over what was expected of them."""
    figure, axes = figures.panels(1, 1, 3.4)
    place = axes[0, 0]
    told = np.isfinite(found.expected_add)
    for key, label, some in (("seen", "certain", found.certain), ("hidden", "not certain", ~found.certain)):
        expected, actual = (np.maximum(1000 * one[told & some], LEAST) for one in (found.expected_add, found.add))
        place.scatter(expected, actual, s=4, color=figures.STROKES[key][0], alpha=0.5, linewidths=0, label=label)
    drawn = 1000 * np.concatenate([found.expected_add[told], found.add[told], [task.max_std]])
    ends = np.maximum([drawn.min() / AROUND, drawn.max() * AROUND], LEAST)
    place.plot(ends, ends, color="#777777", linewidth=0.6)
    place.axvline(1000 * task.max_std, color="#777777", linestyle="-.", linewidth=0.6)
    place.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    place.set(xlabel="expected distance (mm)", ylabel="distance from the truth (mm)")
    for axis in (place.xaxis, place.yaxis):
        figures.plain(axis)
    figures.name_lines(figure, place)
    figures.save(figure, options.out / name)
