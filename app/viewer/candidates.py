"""What does the search weigh against each other? The heaviest of its hypotheses, drawn as objects.

In the search the particle i of all parts is one whole object, and particles of one island are one hypothesis: here a
candidate, as everything else on the page that is called a hypothesis is the posterior's. A dot tells where a part's
frame is; whether the object there could be what was measured is seen of the object alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from app.viewer.scene_frame import Copies, Lines
from app.viewer.stage import Stage
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import Belief
from pmpnbp.pictures.palette import Colour

# Candidates drawn, lines of each of their parts, and how opaque the heaviest and the lightest are.
MOST, MOST_LINES = 8, 48
HEAVY, LIGHT = 0.34, 0.07


def heaviest(belief: Belief) -> tuple[NDArray[np.intp], Array]:
    """Particles (K,) that are the best of their islands, and the islands' weights (K,), heaviest first.

    Empty where the belief is of one population, or not of whole objects.
    """
    islands, row = np.unique(belief.origin.island[0], return_inverse=True)
    if belief.joint_positions is None or len(islands) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    log_weights = belief.log_weights[0]
    weights: Array = np.bincount(row, np.exp(log_weights)).astype(np.float64)
    # by island, the heaviest first: the first of each island is its best
    order = np.lexsort((-log_weights, row))
    best = order[np.searchsorted(row[order], np.arange(len(islands)))]
    chosen = np.argsort(-weights, kind="stable")[:MOST]
    return best[chosen], weights[chosen]


def candidates(
    belief: Belief, stage: Stage, painted: tuple[Colour, ...], lines: tuple[Colour, ...]
) -> Iterator[Copies | Lines]:
    """The candidates, each part in its colour `painted`, its edges in `lines`; the fainter, the lighter they are."""
    rows, weights = heaviest(belief)
    if not len(rows):
        return
    opacities = (LIGHT + (HEAVY - LIGHT) * np.sqrt(weights / weights[0])).astype(np.float32)
    for number, shape in enumerate(stage.shapes):
        if shape is None:
            continue
        name, of_part = f"/candidates/{number}", belief.poses[number, rows]
        yield Copies(
            name,
            shape.vertices,
            shape.faces,
            of_part[:, :3].astype(np.float32),
            of_part[:, 3:].astype(np.float32),
            np.full((len(rows), 3), painted[number], dtype=np.uint8),
            opacities,
        )
        ends = shape.edges[:MOST_LINES].reshape(1, -1, 3).astype(np.float64)
        placed = poses.transform_points(of_part[:, None], ends).reshape(-1, 2, 3)
        yield Lines(f"{name}/edges", placed.astype(np.float32), lines[number], 1.0)
