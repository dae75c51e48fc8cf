"""Moving many poses through joints at once: the numba twin of `Edge.pose_parent_child`, which is the specification.

With few poses starting threads costs more than it saves; the search moves hundreds of thousands.
"""

import numpy as np
from numba import get_num_threads, prange

from pmpnbp.potentials.kernels.compiling import kernel
from pmpnbp.potentials.kernels.pose_algebra import inverse, product, rotated, seven, slid, store

# Below this many poses a parallel launch costs more than it saves; poses are dealt to the threads in blocks.
PARALLEL_FROM, BLOCK = 4096, 64


@kernel
def _through_range(  # type: ignore[no-untyped-def]
    start, stop, poses_from, edge, to_child, axis_positions, axis_count, before, revolute, axes, after, out
):
    """`through_joints` of the poses numbered `start` to `stop` of G M."""
    for place in range(start, stop):
        g, m = place // poses_from.shape[1], place % poses_from.shape[1]
        e = edge[g]
        here, first = seven(poses_from[g, m]), seven(before[e, 0])
        # all positions have the way to the first axis in common
        if to_child[g]:
            first = product(here, first)
        for d in range(axis_positions.shape[2]):
            pose = first
            for k in range(axis_count[e]):
                if k > 0:
                    pose = product(pose, seven(before[e, k]))
                q = axis_positions[g, m, d, k]
                if revolute[e, k]:
                    pose = rotated(pose, np.sin(0.5 * q), np.cos(0.5 * q), axes[e, k])
                else:
                    pose = slid(pose, q, axes[e, k])
            pose = product(pose, seven(after[e]))
            store(pose if to_child[g] else product(here, inverse(pose)), out[g, m, d])


@kernel(parallel=True)
def _through_parallel(  # type: ignore[no-untyped-def]
    count, poses_from, edge, to_child, axis_positions, axis_count, before, revolute, axes, after, out
):
    for block in prange((count + BLOCK - 1) // BLOCK):
        start = np.int64(block) * BLOCK
        stop = min(count, start + BLOCK)
        _through_range(
            start, stop, poses_from, edge, to_child, axis_positions, axis_count, before, revolute, axes, after, out
        )


def through_joints(poses_from, edge, to_child, axis_positions, axis_count, before, revolute, axes, after, out):  # type: ignore[no-untyped-def]
    """Poses of the part on the other side of an edge.

    poses_from : (G, M, 7), part on this side in world; edge : (G,) row of the edge table; to_child : (G,) bool
    axis_positions : (G, M, D, K)
    axis_count (E,), before (E, K, 7), revolute (E, K), axes (E, K, 3), after (E, 7) : the edge table
    out : (G, M, D, 7)
    """
    count = poses_from.shape[0] * poses_from.shape[1]
    table = (axis_count, before, revolute, axes, after)
    if count * axis_positions.shape[2] < PARALLEL_FROM or get_num_threads() == 1:
        _through_range(0, count, poses_from, edge, to_child, axis_positions, *table, out)
    else:
        _through_parallel(count, poses_from, edge, to_child, axis_positions, *table, out)
