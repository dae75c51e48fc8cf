"""How did the runs on a scene end? Error, spread and time of each, at rest or where it was told to stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.reproduce.reports import Table
from benchmarks.tables import markdown, rate
from pmpnbp.geometry.poses import Array
from pmpnbp.runs.run_log import Asked, Result, RunLog

# Metres: the largest error of a part that counts as found.
FOUND = (0.01, 0.02, 0.05)
UNDER = tuple(f"under {100 * limit:.0f} cm" for limit in FOUND)
# What the deviations of a belief's particles are, in a sentence.
OF_PARTICLES = "it follows the algorithm's own diffusion of particles"


@dataclass(frozen=True)
class Outcomes:
    """R runs on one scene, each as it stood at rest, though it may have gone on, or else in the end.

    seeds : (R,); parts : the names of the N parts; shares : (N,) how much of each is seen; judged : (N,) whether that
    is enough to count; add, std : (R, N) metres; seconds : (R,); at_rest : (R,) the iteration, or None
    told : (R, N) whether a result calls a part certain, where it has a posterior to say so by
    """

    seeds: tuple[int, ...]
    parts: tuple[str, ...]
    shares: Array
    judged: NDArray[np.bool_]
    add: Array
    std: Array
    seconds: Array
    at_rest: tuple[int | None, ...]
    told: NDArray[np.bool_] | None = None

    def found(self, limit: float) -> int:
        """In how many runs every judged part is within `limit` metres."""
        return int(np.sum(np.all(self.add[:, self.judged] < limit, axis=1)))

    def certain(self, max_std: float) -> NDArray[np.bool_]:
        """(R, N): what is told, or else whether no link of a part is spread by more than `max_std` metres along any
        axis."""
        return np.asarray(self.std <= max_std) if self.told is None else self.told


def rates(errors: Array) -> list[str]:
    """How many of errors (K,), metres, are under each of FOUND; UNDER names the columns."""
    return [rate(int(np.sum(errors < limit)), len(errors)) for limit in FOUND]


def over_iterations(results: Sequence[Result], name: str) -> Array:
    """(R, I + 1, N) of what a result has by iteration and part; a run that ended earlier stays as it ended."""
    longest = max(len(result[name]) for result in results)
    return np.array([result[name] + result[name][-1:] * (longest - len(result[name])) for result in results])


def of_runs(asked: Sequence[Asked], run_log: RunLog) -> Outcomes:
    """Of the runs of one scene."""
    results = run_log.results(asked)
    ends = [-1 if result["at_rest"] is None else result["at_rest"] for result in results]

    def at_end(name: str) -> Array:
        return np.array([result[name][end] for result, end in zip(results, ends, strict=True)])

    first = results[0]
    return Outcomes(
        tuple(one["seed"] for one in asked),
        tuple(first["parts"]),
        np.array(first["shares"]),
        np.array(first["judged"]),
        at_end("add"),
        at_end("std"),
        at_end("seconds"),
        tuple(result["at_rest"] for result in results),
    )


def given_the_scan(asked: Sequence[Asked], run_log: RunLog) -> Outcomes:
    """The same of runs that were asked for it, as a result tells it by draws from the posterior: where the parts are
    told to be, with the deviations of the draws in place of those of the belief's particles."""
    told = [result["posterior"] for result in run_log.results(asked)]
    add, std, certain = (np.array([one[name] for one in told]) for name in ("add", "std", "certain"))
    return replace(of_runs(asked, run_log), add=add, std=std, told=certain)


def time_section(found: Mapping[str, Outcomes]) -> str:
    """How long the runs took."""
    lines = [f"- {name}: {time_taken(some)}" for name, some in found.items()]
    return "\n".join(["## Time", "", *lines])


def time_taken(some: Outcomes) -> str:
    """Seconds and iterations of a run, as part of a sentence."""
    rests = [rest for rest in some.at_rest if rest is not None]
    said = f"{np.median(some.seconds):.2f} s a run in the median, {some.seconds.max():.2f} s at most; "
    said += f"{len(rests)} of {len(some.at_rest)} runs came to rest"
    return said + (f", after {np.median(rests):.0f} iterations in the median" if rests else "")


def part_table(found: Mapping[str, Outcomes]) -> Table:
    """How every part was found in every run."""
    rows = [
        [
            name,
            some.seeds[run],
            some.parts[part],
            f"{some.shares[part]:.4f}",
            "no" if some.judged[part] else "yes",
            f"{some.add[run, part]:.6f}",
            f"{some.std[run, part]:.6f}",
        ]
        for name, some in found.items()
        for run in range(len(some.add))
        for part in range(len(some.parts))
    ]
    return Table("parts", ["case", "seed", "part", "visible_share", "hidden", "add_m", "std_m"], rows)


def part_section(found: Mapping[str, Outcomes], spread: str = OF_PARTICLES) -> str:
    """Error, success and spread part by part, over the runs. spread : of what the deviations are"""
    rows = []
    for name, some in found.items():
        for part, title in enumerate(some.parts):
            errors = some.add[:, part]
            rows.append(
                [
                    name,
                    title,
                    f"{100 * some.shares[part]:.0f} %" + ("" if some.judged[part] else ", **hidden**"),
                    f"{100 * np.median(errors):.2f}",
                    *rates(errors),
                    f"{1000 * np.median(some.std[:, part]):.1f}",
                ]
            )
    header = ["scene", "part", "seen", "median ADD (cm)", *UNDER, "median of the largest std (mm)"]
    return "\n".join(
        [
            "## Part by part",
            "",
            "Rates with Wilson's 95 % interval; hidden is a part of which less than a tenth is seen. The standard "
            f"deviation is that of the belief's position along the axis on which it is largest; {spread}.",
            "",
            markdown(header, rows),
        ]
    )
