"""From where to look next, after an iteration? One ranking for whoever asks: REST's decision and the 3D views draw it.

It is kept as long as it is asked for, since it is of a posterior, which stays while the inference is at rest; the
posterior itself is not kept by it.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Sequence

from cachetools import LRUCache

from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.readout.view_planning import PlannedView, RankedView, around, ranked

# Views that are told, of those that are tried around the object.
TOLD = 6
# Nats of expected gain below which a scan is hardly worth its while, and a view is not drawn.
WORTH = 0.1
# Rankings kept.
_KEPT = 16

_lock = threading.Lock()
# with a reference to the posterior, by which one is told apart that came to have the id of one that is gone
_Known = tuple[weakref.ref[Posterior], tuple[RankedView, ...]]
_known: LRUCache[tuple[int, tuple[str, ...], float], _Known] = LRUCache(_KEPT)


def uncertain(snapshot: Snapshot, links: Sequence[str], max_std: float) -> list[str]:
    """Those of the links, by name, that are not certain, up to `max_std`, metres."""
    certain, names = snapshot.placed.certain(max_std), snapshot.problem.mrf.model.links
    return [link for link in links if not certain[names.index(link)]]


def next_views(snapshot: Snapshot, links: Sequence[str], max_std: float | None = None) -> tuple[RankedView, ...]:
    """The best places around the object to look from, by what a scan is expected to tell of the links that is not known
    to `max_std`, metres, None: the session's; best first. None where there is no posterior."""
    limit = snapshot.criteria.max_std if max_std is None else max_std
    posterior = snapshot.placed.posterior
    if posterior is None:
        return ()
    key = id(posterior), tuple(links), limit
    with _lock:
        known = _known.get(key)
    if known is None or known[0]() is not posterior:
        known = weakref.ref(posterior), ranking(snapshot, posterior, links, None, limit)[:TOLD]
        with _lock:
            _known[key] = known
    return known[1]


def ranking(
    snapshot: Snapshot, posterior: Posterior, links: Sequence[str], views: Sequence[PlannedView] | None, max_std: float
) -> tuple[RankedView, ...]:
    """The views, None: those around the object, best first by what is not known to `max_std`, metres."""
    problem = snapshot.placed.problem
    if not problem.observation.views or not links:
        return ()
    names = problem.mrf.model.links
    tried = around(problem, posterior) if views is None else views
    return tuple(ranked(problem, posterior, [names.index(link) for link in links], tried, max_std))
