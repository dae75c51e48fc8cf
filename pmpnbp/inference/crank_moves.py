"""How else could a long chain be bent, with most links where they are? One joint is turned, and the next, and the links
behind them are brought back as near to their places as their joints allow, or those before them are.

Such places are easily taken for each other, since few links differ, and no step of a single joint leads from one to the
other. Chemists move chains of atoms so, by "crankshafts" (Verdier and Stockmayer 1962).
"""

from __future__ import annotations

from itertools import product

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.tree_estimate import assemble

# Radians by which a joint is turned.
TURNS = (-0.3, -0.15, -0.06, 0.06, 0.15, 0.3)


def crank_moves(mrf: Mrf, root: Array, joints: Array) -> tuple[Array, Array]:
    """Root poses (C, 7) and joint vectors (C, D): of a configuration (7,), (D,) each joint turned by each of TURNS, and
    each that hangs on it by each of these or not at all, as far as limits allow; once what hangs on them is brought
    back, and once what they hang on."""
    model, here = mrf.model, mrf.part_poses(root, joints)
    turned, ends = [], []
    for first, second in mrf.edges_in_a_row(2):
        for one, other in product(TURNS, (*TURNS, 0.0)):
            moved = joints.copy()
            moved[first.coordinates] += one
            moved[second.coordinates] += other
            if np.all((moved >= model.lower) & (moved <= model.upper)):
                turned.append(moved)
                ends.append((first.child, second.child))
    if not turned:
        return np.zeros((0, 7)), np.zeros((0, model.dof))
    tried, end = np.array(turned), np.array(ends)
    wanted = np.tile(here, (len(tried), 1, 1))
    rows = np.arange(len(tried))[:, None]
    wanted[rows, end] = mrf.part_poses(np.tile(root, (len(tried), 1)), tried)[rows, end]
    both = [assemble(mrf, wanted, anchor) for anchor in (0, end[:, 1])]
    return np.concatenate([roots for roots, _ in both]), np.concatenate([found for _, found in both])
