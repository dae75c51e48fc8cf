"""Is the belief honest? One word for it, and the figures that it rests on.

Honest is what nothing speaks against, as far as so many runs can tell: a belief is objected to where the 99 % interval
of a coverage lies outside of what is tolerated, where a coordinate's ranks are not uniform at 1 % after Holm, or where
certain links are wrong, or absent objects found, oftener than is allowed, at 99 % again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.calibrate import ranks as statistic
from benchmarks.calibrate.findings import Found, Mask, Rate, Uniformity, rate_of
from pmpnbp.geometry.poses import Array

HONEST, OVERCONFIDENT, BIASED, CAUTIOUS = "honest", "overconfident", "biased", "wider than it need be"
# Nominal shares of regions and intervals, and what is tolerated of each.
LEVELS = {0.75: (0.70, 0.80), 0.95: (0.92, 0.98)}
# Shares that are allowed: of links said to be certain, wrong; of absent objects, a good fit.
WRONG_ALLOWED, FALSE_ALLOWED = 0.01, 0.05
# Draws may lean by this share of what links are certain at: where it matters, truths are outside of their regions, too.
LEAN_ALLOWED = 0.1
# Standard normal quantile of a two-sided 99 % interval, and the same level for ranks.
SURE, LEVEL = 2.575829, 0.01
# Runs with the object below which next to nothing could be objected to.
FEWEST = 30
_WORDS = {statistic.NARROW: OVERCONFIDENT, statistic.WIDE: CAUTIOUS, statistic.LOW: BIASED, statistic.HIGH: BIASED}


@dataclass(frozen=True)
class Coverage:
    """what : of which regions; rates : by LEVELS, in its order; sure : the same with 99 % intervals"""

    what: str
    rates: tuple[Rate, ...]
    sure: tuple[Rate, ...]


@dataclass(frozen=True)
class Judgement:
    """word : one of the four, or None where there are too few runs; because : what speaks against it, or for it;
    coverage : how many truths are in the largest regions, as a sentence, empty where there are none"""

    word: str | None
    because: tuple[str, ...]
    coverage: str

    def sentence(self, name: str, runs: int) -> str:
        """The report's first. runs : with the object, and a good fit"""
        if self.word is None:
            return (
                f"Whether the belief is honest for {name} and this camera cannot be told: {FEWEST} runs with a good "
                f"fit are needed, and there are {runs}."
            )
        known = f"as far as {runs} runs can tell: " if self.word == HONEST else ""
        return f"The belief is {self.word} for {name} and this camera, {known or 'as '}{'; '.join(self.because)}."


def coverages(found: Found) -> list[Coverage]:
    """Of positions and joints, of seen and hidden parts apart."""
    rows: list[tuple[str, Array, Mask]] = [
        ("positions of links that are seen", found.ellipsoid_ranks, found.seen),
        ("positions of hidden links", found.ellipsoid_ranks, ~found.seen),
        ("joints of links that are seen", found.joint_regions, found.joints_seen),
        ("joints of hidden links", found.joint_regions, ~found.joints_seen),
    ]
    return [
        Coverage(
            what,
            tuple(rate_of(at <= level, among) for level in LEVELS),
            tuple(rate_of(at <= level, among, SURE) for level in LEVELS),
        )
        for what, at, among in rows
    ]


def judged(found: Found, uniform: Sequence[Uniformity], false_finds: Rate, max_std: float) -> Judgement:
    """Of the runs whose fit is good. false_finds : of runs without the object those whose fit is good, at 99 %; max_std
    : metres, at which links are certain"""
    told = [f"{_percent(one.rates[-1])} of the {one.what}" for one in coverages(found) if one.rates[-1].cases]
    coverage = f"In the regions that are told for {100 * max(LEVELS):.0f} % lie {', '.join(told)}." if told else ""
    if len(found.seeds) < FEWEST:
        return Judgement(None, (), coverage)
    odd = [one for one in uniform if one.judged < LEVEL]
    leaning = [one for one in odd if 0 < one.lean <= LEAN_ALLOWED * max_std]
    against = list(_objections(found, [one for one in odd if one not in leaning], false_finds))
    for word in (OVERCONFIDENT, BIASED, CAUTIOUS):
        reasons = tuple(reason for kind, reason in against if kind == word)
        if reasons:
            return Judgement(word, reasons, coverage)
    held = ["coverage, certain links and fits are within what is tolerated"]
    even = [one.judged for one in uniform if one not in leaning]
    if even:
        held.append(f"the ranks of {len(even)} coordinates are uniform (least p {min(even):.2g} after Holm)")
    if leaning:
        held.append(
            f"the draws lean by less than {100 * LEAN_ALLOWED:.0f} % of {1000 * max_std:g} mm: {_named(leaning)}"
        )
    return Judgement(HONEST, tuple(held), coverage)


def _objections(found: Found, odd: Sequence[Uniformity], false_finds: Rate) -> Iterator[tuple[str, str]]:
    """Which of the words something speaks for, and what. odd : whose ranks are not uniform"""
    for one in coverages(found):
        for (level, (least, most)), rate in zip(LEVELS.items(), one.sure, strict=True):
            word = OVERCONFIDENT if rate.high < least else CAUTIOUS if rate.low > most else None
            if word is not None and rate.cases:
                yield word, f"{_percent(rate)} of {one.what} are in the {100 * level:.0f} % region"
    wrong = rate_of(found.wrong, found.certain, SURE)
    if wrong.cases and wrong.low > WRONG_ALLOWED:
        yield OVERCONFIDENT, f"{_percent(wrong)} of links said to be certain are not within 1 cm and 2°"
    if false_finds.cases and false_finds.low > FALSE_ALLOWED:
        yield OVERCONFIDENT, f"the fit is good in {_percent(false_finds)} of runs without the object"
    for word in (OVERCONFIDENT, BIASED, CAUTIOUS):
        some = [one for one in odd if _WORDS[one.shape] == word]
        if some:
            least = min(one.judged for one in some)
            yield word, f"the ranks of {_named(some)} are not uniform (p {least:.2g} after Holm)"


def _named(some: Sequence[Uniformity]) -> str:
    """The first three."""
    more = f" and {len(some) - 3} more" if len(some) > 3 else ""
    return ", ".join(f"{one.of.name} (draws {one.departure})" for one in some[:3]) + more


def _percent(rate: Rate) -> str:
    return f"{100 * rate.share:.0f} % ({100 * rate.low:.0f}–{100 * rate.high:.0f})"
