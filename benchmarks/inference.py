"""How long does an iteration take, by particles and by parts, and how long until an object is found?

Iterations are given in milliseconds and as multiples of a fixed NumPy workload that is timed just before, so that
figures of different machines, and of a busy one, can be held against each other. Run it:
`python -m benchmarks.inference`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import peak_memory
from benchmarks.generated import KINDS, generated_case
from benchmarks.success import MODES, ROUGH_ITERATIONS, SCENES, TOLERANCE, load_cabinet
from benchmarks.tables import markdown, progress
from benchmarks.trials import Case, Trial, run_trial, shortened, warm_kernels
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run as engine
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import SessionOptions, Settings, preset

PRESETS = ("paper", "robust")
REFERENCE = "exp, then sort, of a million float64 in NumPy, one thread"


@dataclass(frozen=True)
class Plan:
    """How much is measured.

    particles : numbers of particles on the sample cabinet; parts : numbers of parts at `parts_particles` particles
    repeats : iterations of each stage but the search; scenes, seeds : runs to convergence
    memory : whether a process is started to measure it
    """

    particles: tuple[int, ...] = (100, 200, 400, 800, 1600, 3200)
    parts: tuple[int, ...] = (4, 12, 24, 48)
    parts_particles: int = SessionOptions.particles
    repeats: int = 8
    scenes: tuple[str, ...] = SCENES
    seeds: int = 3
    memory: bool = True


def measure(plan: Plan, say: Callable[[str], None] = progress) -> dict[str, Any]:
    """All figures.

    Returns {"reference", "by_particles", "by_parts", "to_convergence", "peak_megabytes"}: lists of cases as
    `iteration_times` and `convergence` give them.
    """
    settings = {name: preset(name) for name in PRESETS}
    cabinet = {name: load_cabinet("open", True, settings[name]) for name in PRESETS}
    say("compiling kernels, or reading them from the cache")
    for name in PRESETS:
        warm_kernels(cabinet[name], settings[name])
    by_particles = []
    for particles in plan.particles:
        for name in PRESETS:
            say(f"iterations of preset {name}, {particles} particles")
            by_particles.append(
                {"preset": name, **iteration_times(cabinet[name], settings[name], particles, plan.repeats)}
            )
    by_parts = []
    for kind in KINDS:
        for parts in plan.parts:
            for name in PRESETS:
                say(f"iterations of preset {name}, {kind} of {parts} parts")
                case = generated_case(kind, parts, settings[name])
                times = iteration_times(case, settings[name], plan.parts_particles, plan.repeats, search=1)
                by_parts.append({"object": kind, "parts": parts, "preset": name, **times})
    return {
        "reference": REFERENCE,
        "by_particles": by_particles,
        "by_parts": by_parts,
        "to_convergence": [convergence(known, plan, say) for known in ("roi", "rough")],
        "peak_megabytes": peak_memory.measure() if plan.memory else None,
    }


def reference_milliseconds() -> float:
    """Median time of the fixed workload."""
    numbers = np.random.default_rng(0).standard_normal(1_000_000)
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        np.sort(np.exp(numbers))
        taken.append(time.perf_counter() - start)
    return 1000.0 * float(np.median(taken))


def iteration_times(case: Case, settings: Settings, particles: int, repeats: int, search: int = 2) -> dict[str, Any]:
    """Median milliseconds of an iteration in each stage, from no prior: {"particles", "reference_ms", "ms": {stage: },
    "ratio": {stage: }}.

    The schedule is shortened: `search` iterations of search, which are slow and all alike, and `repeats` of belief
    propagation. Of each stage the first iteration is left out, unless it is the only one.
    """
    reference = reference_milliseconds()
    short = shortened(settings, search=search, anneal=repeats, refine=0)
    problem = problems.build(case.model, case.observation, UniformPrior("upright"), short, particles=particles, seed=0)
    state, _ = engine.begin(problem)
    taken: dict[str, list[float]] = {}
    for _ in range(max(short.search_iterations + short.anneal_iterations, repeats)):
        state, report = engine.advance(state, problem)
        taken.setdefault(report.stage, []).append(1000.0 * report.seconds)
    stages = {stage: float(np.median(times[1:] or times)) for stage, times in taken.items()}
    return {
        "particles": particles,
        "reference_ms": reference,
        "ms": stages,
        "ratio": {stage: milliseconds / reference for stage, milliseconds in stages.items()},
    }


def convergence(known: str, plan: Plan, say: Callable[[str], None] = progress) -> dict[str, Any]:
    """Medians over scenes and seeds of the sample cabinet of one of `success.MODES`, up to 30 iterations.

    Returns {"known", "runs", "converged", "prepare_seconds", "seconds", "iterations", "seconds_to_20",
    "seconds_to_result", "found"}: `seconds` until convergence, preparation included, reading files not; `seconds_to_20`
    until iteration 20; `seconds_to_result` until every part that counts is within 1 cm and stays so, of the `found`
    runs.
    """
    mode, robust = MODES[known], preset("robust")
    trials: list[Trial] = []
    for scene in plan.scenes:
        case = load_cabinet(scene, mode.roi, robust)
        for seed in range(plan.seeds):
            say(f"to convergence, {mode.name}: {scene}, seed {seed}")
            trials.append(
                run_trial(case, mode.prior(case, seed), robust, seed=seed, iterations=30, at_least=ROUGH_ITERATIONS)
            )
    results = np.array([trial.seconds_to_result(TOLERANCE) for trial in trials])
    found = results[np.isfinite(results)]
    return {
        "known": mode.name,
        "runs": len(trials),
        "converged": sum(trial.at_rest is not None for trial in trials),
        "prepare_seconds": float(np.median([trial.elapsed[0] for trial in trials])),
        "seconds": float(np.median([trial.seconds for trial in trials])),
        "iterations": float(np.median([trial.iterations for trial in trials])),
        "seconds_to_20": float(np.median([trial.elapsed[ROUGH_ITERATIONS] for trial in trials])),
        "seconds_to_result": float(np.median(found)) if len(found) else None,
        "found": len(found),
    }


def table(figures: dict[str, Any]) -> str:
    """The figures of `measure` as Markdown."""
    cells = ["search (ms)", "belief propagation (ms)", "belief propagation / reference"]
    particles = [[case["preset"], case["particles"], *_time_cells(case)] for case in figures["by_particles"]]
    parts = [[case["object"], case["parts"], case["preset"], *_time_cells(case)] for case in figures["by_parts"]]
    ways = [
        [
            way["known"],
            way["runs"],
            way["found"],
            way["converged"],
            f"{way['prepare_seconds']:.2f}",
            f"{way['seconds']:.2f}",
            f"{way['iterations']:.0f}",
            f"{way['seconds_to_20']:.2f}",
            "–" if way["seconds_to_result"] is None else f"{way['seconds_to_result']:.2f}",
        ]
        for way in figures["to_convergence"]
    ]
    header = ["known", "runs", "found", "converged", "prepared (s)", "converged (s)", "iterations", "20 iterations (s)"]
    lines = [
        "An iteration by particles, sample cabinet:",
        "",
        markdown(["preset", "M", *cells], particles),
        "",
        "An iteration by parts:",
        "",
        markdown(["object", "parts", "preset", *cells], parts),
        "",
        f"Reference: {figures['reference']}.",
        "",
        "Until the sample cabinet is found, medians:",
        "",
        markdown([*header, "within 1 cm (s)"], ways),
        "",
    ]
    memory = figures["peak_megabytes"]
    if memory is not None:
        lines += [f"Peak memory: {memory['estimate']:.0f} MB, of which imports {memory['imports']:.0f} MB.", ""]
    return "\n".join(lines)


def _time_cells(case: dict[str, Any]) -> list[str]:
    stages = ("search", "belief propagation")
    times = [f"{case['ms'][stage]:.1f}" if stage in case["ms"] else "–" for stage in stages]
    ratio = case["ratio"].get("belief propagation")
    return [*times, "–" if ratio is None else f"{ratio:.2f}"]


if __name__ == "__main__":
    print(table(measure(Plan())))
