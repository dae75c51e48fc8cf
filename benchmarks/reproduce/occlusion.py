"""`pmpnbp reproduce occlusion`: is the cabinet found though much of it is hidden, and does the belief know what is?

The paper: a drawer hides those below, a robot's arm is in front, a blanket hangs over half of it; a plausible pose is
estimated accurately each time, with a belief of possible poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from benchmarks.reproduce import figures, outcomes, reports
from benchmarks.reproduce.experiment import Experiment, Options
from benchmarks.reproduce.outcomes import Outcomes
from benchmarks.reproduce.reports import Claim
from benchmarks.reproduce.scene_runs import LAST, asked_of, case_of, perform, scene_scan
from benchmarks.tables import markdown, rate
from pmpnbp.runs.run_log import Asked, Result, RunLog

SCENES = {
    "cabinet/self_occluded": "drawer 1 hides those below",
    "cabinet/arm": "a robot's arm is in front",
    "cabinet/blanket": "a blanket hangs over half of it",
}
ITERATIONS, PARTICLES = 100, 400
# Metres: the largest error of a part that counts as an accurate estimate.
ACCURATE = 0.02


def asked(options: Options, _: RunLog | None = None) -> list[Asked]:
    """All runs: no prior, the region of interest given."""
    return [run for scene in SCENES for run in _asked(options, scene)]


def _asked(options: Options, scene: str) -> list[Asked]:
    return [
        asked_of(
            scene,
            "robust",
            seed,
            particles=options.particles or PARTICLES,
            iterations=options.iterations or ITERATIONS,
            stop_at_rest=True,
            posterior=True,
            keep=[LAST] if seed == options.seed else [],
        )
        for seed in options.seeds
    ]


def write(options: Options, run_log: RunLog) -> None:
    """Figures, table and the report."""
    found: dict[str, Outcomes] = {}
    drawn: dict[str, Outcomes] = {}
    captions: dict[str, str] = {}
    drawing = figures.Drawing()
    for scene, title in SCENES.items():
        runs = _asked(options, scene)
        found[scene], drawn[scene] = outcomes.of_runs(runs, run_log), outcomes.given_the_scan(runs, run_log)
        name = f"{scene.replace('/', '_')}.png"
        draw(options, drawing, runs[0], run_log.results(runs[:1])[0], name)
        captions[name] = (
            f"{scene}, {title}: the scan; particles of the belief in the end (run of seed {options.seed}); the "
            "estimate, its most likely pose, as the camera sees it and from beside."
        )
    drawing.close()
    for table in (outcomes.part_table(found), replace(outcomes.part_table(drawn), name="posterior")):
        reports.write_table(options.out, table)
    claims = [
        *(accurate(scene, some) for scene, some in found.items()),
        spread_where_hidden(found, "its particles"),
        spread_where_hidden(drawn, "draws given the scan"),
    ]
    reports.write_report(
        options.out,
        "Occlusion",
        options.command,
        options.named_seeds,
        claims,
        [outcomes.part_section(found), open_section(found, drawn), outcomes.time_section(found)],
        captions,
    )


def draw(options: Options, drawing: figures.Drawing, run: Asked, result: Result, name: str) -> None:
    """Observation, belief, and the estimate from two sides."""
    scan, model = scene_scan(run["scene"]), case_of(run).model
    last = result["kept"][LAST]
    estimate = np.array(last["poses"])
    figure, axes = figures.panels(2, 2, 3.0)
    figures.beside(axes[0, 0], drawing.observed(scan), "scan")
    drawing.particles(axes[0, 1], scan, last["particles"], "belief")
    figures.beside(axes[1, 0], drawing.estimate(scan, model, estimate), "estimate")
    figures.closer((axes[0, 0], axes[0, 1], axes[1, 0]), scan, model, estimate)
    beside = figures.from_beside(scan, model, estimate)
    figures.beside(axes[1, 1], drawing.estimate(beside, model, estimate), "estimate from beside")
    figures.name_parts(figure, result["parts"])
    figures.save(figure, options.out / name)


def accurate(scene: str, some: Outcomes) -> Claim:
    """Whether what is seen of the object is found."""
    held, runs = some.found(ACCURATE), len(some.add)
    said = f"{scene}: {rate(held, runs)} runs have every part that is seen under {100 * ACCURATE:.0f} cm"
    seen = some.add[:, some.judged]
    said += f"; their ADD {100 * np.median(seen):.2f} cm in the median, {100 * seen.max():.2f} cm at most"
    for part in np.flatnonzero(~some.judged):
        errors = 100 * some.add[:, part]
        said += f"; {some.parts[part]}, hidden, {np.median(errors):.2f} cm in the median, {errors.max():.2f} cm at most"
    text = f"The pose is estimated accurately where {SCENES[scene]}"
    return Claim(text, reports.verdict_of_runs(held, runs), said)


def open_section(found: Mapping[str, Outcomes], drawn: Mapping[str, Outcomes]) -> str:
    """How wide the belief is beside what the scan leaves open."""
    rows = [
        [
            scene,
            title,
            f"{100 * some.shares[part]:.0f} %",
            f"{1000 * np.median(some.std[:, part]):.1f}",
            f"{1000 * np.median(drawn[scene].std[:, part]):.1f}",
        ]
        for scene, some in found.items()
        for part, title in enumerate(some.parts)
    ]
    told = (
        "The largest standard deviation of each part's position, median of the runs, in millimetres: of the belief's "
        'particles, and of draws from the posterior of the whole object given the scan (docs/algorithm.md, "How sure '
        'one can be").'
    )
    header = ["scene", "part", "seen", "particles", "draws given the scan"]
    return "\n".join(["## What the scan leaves open", "", told, "", markdown(header, rows)])


def spread_where_hidden(found: Mapping[str, Outcomes], by: str) -> Claim:
    """Whether the part that is seen least has a wider belief than the one that is seen best."""
    held, said = [], []
    for scene, some in found.items():
        least, best = int(some.shares.argmin()), int(some.shares.argmax())
        wider = int(np.sum(some.std[:, least] > some.std[:, best]))
        held.append(reports.verdict_of_runs(wider, len(some.std)) == reports.HOLDS)
        described = (
            f"{some.parts[part]} ({100 * some.shares[part]:.0f} % seen) {1000 * np.median(some.std[:, part]):.1f} mm"
            for part in (least, best)
        )
        said.append(f"{scene}: {' against '.join(described)}, wider in {wider} of {len(some.std)} runs")
    text = f"The belief of the part that is seen least is spread wider than that of the part that is seen best ({by})"
    return Claim(text, reports.verdict(held), "; ".join(said))


EXPERIMENT = Experiment(perform, (asked,), write)
