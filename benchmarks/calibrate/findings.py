"""What do all runs together say? Coverage, ranks and the reliability of `certain`, each with what so many runs allow.

Links of one run are not independent: where one is off, so are the others. An interval therefore counts runs, not links:
it is Wilson's for the share of links, as if each run had told of one. Ranks are tested coordinate by coordinate, a rank
a run, and judged together by Holm's rule.

Whether a fit is good is said of the scan alone, so that coverage and ranks of those runs are what an honest posterior's
are, as those of all runs are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibrate import ranks as statistic
from benchmarks.statistics import wilson
from benchmarks.trials import VISIBLE
from pmpnbp.geometry.poses import Array
from pmpnbp.runs.run_log import Asked, Result
from pmpnbp.scene.articulated_object import ArticulatedObject, parts_of_links

# What may be wrong of a link that is said to be certain: metres, and radians where it is longer than LONG, metres.
WRONG, TURNED, LONG = 0.01, np.deg2rad(2.0), 0.10
# Metres, eq. 12: near enough to be certain of.
NEAR = 0.003
# Confidently wrong: farther off than so many metres and, along an axis, standard deviations.
FAR, DEVIATIONS = 0.02, 5.0
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Coordinate:
    """ranks : (R,) of the truth among the draws; offsets : (R,) of the draws' mean from it, in `unit`; lever : metres
    that the surface moves for one unit."""

    name: str
    ranks: Array
    offsets: Array
    unit: str
    lever: float = 1e-3


@dataclass(frozen=True, kw_only=True)
class Found:
    """R runs with the object, of N parts and D joint coordinates; see `runs.perform` for what each holds.

    lengths : (N,) metres; joint_parts : (D,) the part that a coordinate moves; units : of coordinates, D of `mm` or
    `mrad`; verdicts : R of them
    """

    parts: tuple[str, ...]
    joints: tuple[str, ...]
    lengths: Array
    joint_parts: NDArray[np.int64]
    units: tuple[str, ...]
    verdicts: tuple[str, ...]
    seeds: NDArray[np.int64]
    effective: Array
    shares: Array
    errors: Array
    stds: Array
    offsets: Array
    turned: Array
    add: Array
    expected_add: Array
    certain: Mask
    position_ranks: Array
    ellipsoid_ranks: Array
    joint_offsets: Array
    joint_ranks: Array

    @property
    def good(self) -> Found:
        """Those runs whose fit is good."""
        return self._chosen(np.array([verdict == "good" for verdict in self.verdicts], dtype=bool))

    @property
    def seen(self) -> Mask:
        """(R, N): of which parts enough is measured to count as seen."""
        return self.shares >= VISIBLE

    @property
    def joints_seen(self) -> Mask:
        """(R, D): the same of the part that a joint moves."""
        return self.seen[:, self.joint_parts]

    @property
    def wrong(self) -> Mask:
        """(R, N): which parts nobody should be certain of."""
        off = np.linalg.norm(self.errors, axis=2) > WRONG
        return off | ((self.turned > TURNED) & (self.lengths > LONG))

    @property
    def confidently_wrong(self) -> Mask:
        """(R, N)."""
        return (self.add > FAR) & np.any(np.abs(self.errors) > DEVIATIONS * self.stds, axis=2)

    @property
    def near(self) -> Mask:
        """(R, N): parts that are seen and found."""
        return self.seen & (self.add < NEAR)

    @property
    def joint_regions(self) -> Array:
        """(R, D): the share of the draws that is nearer to the middle than the truth, in order: it is within the
        central interval of more than that."""
        return np.abs(2 * self.joint_ranks - 1)

    @property
    def coordinates(self) -> list[Coordinate]:
        """Positions along the world's axes, then joints."""
        positions = [
            Coordinate(f"{part} {axis}", self.position_ranks[:, node, k], 1000 * self.offsets[:, node, k], "mm")
            for node, part in enumerate(self.parts)
            for k, axis in enumerate("xyz")
        ]
        levers = [
            length if unit == "mrad" else 1.0
            for unit, length in zip(self.units, self.lengths[self.joint_parts], strict=True)
        ]
        joints = [
            Coordinate(f"joint {name}", self.joint_ranks[:, k], 1000 * self.joint_offsets[:, k], unit, 1e-3 * lever)
            for k, (name, unit, lever) in enumerate(zip(self.joints, self.units, levers, strict=True))
        ]
        return positions + joints

    def _chosen(self, rows: Mask) -> Found:
        kept = {
            entry.name: getattr(self, entry.name)[rows]
            for entry in fields(self)
            if isinstance(getattr(self, entry.name), np.ndarray) and entry.name not in ("lengths", "joint_parts")
        }
        verdicts = tuple(verdict for verdict, row in zip(self.verdicts, rows, strict=True) if row)
        return replace(self, verdicts=verdicts, **kept)


@dataclass(frozen=True)
class Rate:
    """count of cases of which something is so, and of how many; runs : that these are of; low, high : the ends of the
    interval for the rate, 0 to 1."""

    count: int
    cases: int
    runs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """The rate; NaN without cases."""
        return self.count / self.cases if self.cases else float("nan")

    def __str__(self) -> str:
        if not self.cases:
            return "none"
        return f"{self.count} of {self.cases}, {100 * self.share:.0f} % ({100 * self.low:.0f}–{100 * self.high:.0f})"


@dataclass(frozen=True)
class Uniformity:
    """Of one coordinate's ranks: chance by chi-square, the same after Holm, and how the draws depart."""

    of: Coordinate
    chance: float
    judged: float

    @property
    def shape(self) -> str:
        """How the draws depart most."""
        return statistic.shape(self.of.ranks) if len(self.of.ranks) else statistic.UNIFORM

    @property
    def lean(self) -> float:
        """Metres: the median of the draws' offsets where they lean to one side; else 0."""
        leans = self.shape in (statistic.LOW, statistic.HIGH)
        return self.of.lever * abs(float(np.median(self.of.offsets))) if leans else 0.0

    @property
    def departure(self) -> str:
        """The shape, and how far the draws lean."""
        off = f" by {self.lean / self.of.lever:.2g} {self.of.unit} in the median" if self.lean else ""
        return f"{self.shape}{off}"


def gathered(model: ArticulatedObject, asked: Sequence[Asked], results: Sequence[Result]) -> Found:
    """Of those runs that had the object and a scan that was not refused. Of parts without a surface `add` is the
    origin's distance."""
    told = [(one, result) for one, result in zip(asked, results, strict=True) if "shares" in result]
    count, dof = len(model.parts), model.dof
    shapes = {
        "shares": (count,),
        "errors": (count, 3),
        "stds": (count, 3),
        "offsets": (count, 3),
        "turned": (count,),
        "add": (count,),
        "expected_add": (count,),
        "position_ranks": (count, 3),
        "ellipsoid_ranks": (count,),
        "joint_offsets": (dof,),
        "joint_ranks": (dof,),
    }
    arrays = {
        name: np.array([result[name] for _, result in told], dtype=np.float64).reshape(len(told), *shape)
        for name, shape in shapes.items()
    }
    arrays["add"] = np.where(np.isnan(arrays["add"]), np.linalg.norm(arrays["errors"], axis=2), arrays["add"])
    owner = parts_of_links(model)
    moved = {c: owner[joint.child] for joint in reversed(model.joints) for c in joint.coordinates}
    turns = np.zeros(dof, dtype=bool)
    for joint in model.joints:
        turns[list(joint.coordinates)] = joint.elementary_axes()[0]
    return Found(
        parts=tuple(part.name for part in model.parts),
        joints=model.coordinate_names,
        lengths=np.array([part.extents.max() for part in model.parts]),
        joint_parts=np.array([moved[c] for c in range(dof)], dtype=np.int64),
        units=tuple("mrad" if turn else "mm" for turn in turns),
        verdicts=tuple(result["verdict"] for _, result in told),
        seeds=np.array([one["seed"] for one, _ in told], dtype=np.int64),
        effective=np.array([result["effective"] for _, result in told]),
        certain=np.array([result["certain"] for _, result in told], dtype=bool).reshape(len(told), count),
        **arrays,
    )


def rate_of(held: Mask, among: Mask, quantile: float | None = None) -> Rate:
    """Of cases (R, …) `among` all, of how many something is `held`; by Wilson, each run counting once."""
    cases, count = int(among.sum()), int((held & among).sum())
    runs = int(among.reshape(len(among), -1).any(axis=1).sum()) if cases else 0
    as_runs = round(runs * count / cases) if cases else 0
    low, high = wilson(as_runs, runs) if quantile is None else wilson(as_runs, runs, quantile)
    return Rate(count, cases, runs, low, high)


def uniformities(found: Found) -> list[Uniformity]:
    """Of every coordinate."""
    coordinates = found.coordinates
    chances = [statistic.uniformity(one.ranks) for one in coordinates]
    return [
        Uniformity(one, chance, float(judged))
        for one, chance, judged in zip(coordinates, chances, statistic.holm(chances), strict=True)
    ]
