"""May a long read-out go on? It calls its checkpoint between rounds of draws and between modes. What that raises ends
it: nothing is told then, and read out anew it comes to the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable

# Called again and again, from the thread that reads out; returns, or raises what ends the read-out.
Checkpoint = Callable[[], object]

# Seconds after which people are told that a read-out goes on: most are over by then.
SOON = 0.5


def go_on() -> None:
    """The checkpoint of a read-out that nothing ends."""
