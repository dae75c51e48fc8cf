"""What does a result say in words? Imports nothing that takes time: programs that only ask a server have it, too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmpnbp.names import some_of


def verdict(result: Mapping[str, Any]) -> str:
    """One line about a result: was the object found, and what of it is certain?"""
    if result["fit"] is None:
        return "No verdict: the search had not ended"
    if result["fit"] != "good":
        return f"{'Doubtful' if result['fit'] == 'doubtful' else 'Not found'}: {result['fit_reason']}"
    links = result["links"]
    unsure = [name for name, link in links.items() if not link["certain"]]
    if not unsure:
        return f"Found: {result['fit_reason']}; all {len(links)} links are certain"
    count = len(links) - len(unsure)
    certain = f"{count} of {len(links)} links {'is' if count == 1 else 'are'} certain"
    return f"Found: {result['fit_reason']}; {certain}, not {some_of(unsure)}"


def advice(result: Mapping[str, Any]) -> str:
    """One line about a result: what to do next?"""
    if result["fit"] is None:
        return "Next: let it make more iterations"
    if result["fit"] != "good":
        return "Next: check model, camera pose and prior, or give a (tighter) box around the object"
    unsure = [name for name, link in result["links"].items() if not link["certain"]]
    # no look tells which way they are turned
    alike = [name for name in unsure if _looks_the_same(result["links"][name])]
    hidden = [name for name in unsure if name not in alike]
    limit = f"{1000 * result['max_std']:g} mm"
    if not unsure:
        return f"Next: act; every link is known to {limit}"
    some = len(unsure) < len(result["links"])
    if not hidden:
        act = f"act on what is certain, to {limit}; " if some else ""
        return f"Next: {act}no look would tell how these are turned: {some_of(alike)}"
    act = "act on what is certain, or " if some else ""
    return f"Next: {act}look again from where {some_of(hidden)} can be seen; {limit} is asked for"


def _looks_the_same(link: Mapping[str, Any]) -> bool:
    """Whether a link is not certain only because it looks the same in several turns."""
    doubts = link.get("doubts") or ()  # what was written before there were any has none
    return "alike" in doubts and not {"denied", "outside_region", "draws"} & set(doubts)
