"""Moving many poses through joints at once: the numba twin of `Edge.pose_parent_child`, which is the specification.

With few poses starting threads costs more than it saves; the search moves hundreds of thousands.
"""

import numpy as np
from numba import get_num_threads, prange

from pmpnbp.potentials.kernels.compiling import inner, kernel

# Below this many poses a parallel launch costs more than it saves; poses are dealt to the threads in blocks.
PARALLEL_FROM, BLOCK = 4096, 64


@inner
def _multiply(a, b, out):  # type: ignore[no-untyped-def]
    """out = a * b, poses of seven numbers; out may not alias a or b."""
    w, x, y, z = a[3], a[4], a[5], a[6]
    px, py, pz = b[0], b[1], b[2]
    # v' = v + 2 u × (u × v + w v)
    cx = y * pz - z * py + w * px
    cy = z * px - x * pz + w * py
    cz = x * py - y * px + w * pz
    out[0] = a[0] + px + 2.0 * (y * cz - z * cy)
    out[1] = a[1] + py + 2.0 * (z * cx - x * cz)
    out[2] = a[2] + pz + 2.0 * (x * cy - y * cx)
    out[3] = w * b[3] - x * b[4] - y * b[5] - z * b[6]
    out[4] = w * b[4] + x * b[3] + y * b[6] - z * b[5]
    out[5] = w * b[5] - x * b[6] + y * b[3] + z * b[4]
    out[6] = w * b[6] + x * b[5] - y * b[4] + z * b[3]


@inner
def _invert(a, out):  # type: ignore[no-untyped-def]
    """out = a^-1; out may not alias a."""
    w, x, y, z = a[3], -a[4], -a[5], -a[6]
    px, py, pz = -a[0], -a[1], -a[2]
    cx = y * pz - z * py + w * px
    cy = z * px - x * pz + w * py
    cz = x * py - y * px + w * pz
    out[0] = px + 2.0 * (y * cz - z * cy)
    out[1] = py + 2.0 * (z * cx - x * cz)
    out[2] = pz + 2.0 * (x * cy - y * cx)
    out[3] = w
    out[4] = x
    out[5] = y
    out[6] = z


@kernel
def _through_range(  # type: ignore[no-untyped-def]
    start, stop, poses_from, edge, to_child, axis_positions, axis_count, before, revolute, axes, after, out
):
    """`through_joints` of the poses numbered `start` to `stop` of G M."""
    relative = np.empty(7)
    scratch = np.empty(7)
    motion = np.empty(7)
    first = np.empty(7)
    for place in range(start, stop):
        g, m = place // poses_from.shape[1], place % poses_from.shape[1]
        e = edge[g]
        # all positions have the way to the first axis in common
        if to_child[g]:
            _multiply(poses_from[g, m], before[e, 0], first)
        else:
            for c in range(7):
                first[c] = before[e, 0, c]
        for d in range(axis_positions.shape[2]):
            for k in range(axis_count[e]):
                if k == 0:
                    for c in range(7):
                        scratch[c] = first[c]
                else:
                    _multiply(relative, before[e, k], scratch)
                q = axis_positions[g, m, d, k]
                motion[:] = 0.0
                if revolute[e, k]:
                    sine = np.sin(0.5 * q)
                    motion[3] = np.cos(0.5 * q)
                    for c in range(3):
                        motion[4 + c] = sine * axes[e, k, c]
                else:
                    motion[3] = 1.0
                    for c in range(3):
                        motion[c] = q * axes[e, k, c]
                _multiply(scratch, motion, relative)
            if to_child[g]:
                _multiply(relative, after[e], out[g, m, d])
            else:
                _multiply(relative, after[e], scratch)
                _invert(scratch, relative)
                _multiply(poses_from[g, m], relative, out[g, m, d])


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
