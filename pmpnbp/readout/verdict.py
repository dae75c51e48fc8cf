"""What does a result say in one line? Imports nothing that takes time: programs that only ask a server have it, too."""

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
    certain = f"{len(links) - len(unsure)} of {len(links)} links are certain"
    return f"Found: {result['fit_reason']}; {certain}, not {some_of(unsure)}"
