"""One triangle into a z-buffer.

A pixel is covered where its centre lies in the triangle, edges included. The buffer holds a value that is affine in
the image, the larger in front: 1/z for a pinhole camera, minus the depth in parallel projection. A zero is a pixel
where nothing was drawn.

Each row of a triangle is visited in whole vectors, and what lies outside the triangle is written with what it held: a
loop over the covered pixels alone has a length that changes by the row, and costs more in mispredicted branches and
scalar remainders than it saves. The three edge functions decide what is inside, with a slack above their rounding, so
that a closed mesh has no cracks; neighbours overlap by about a millionth of their size.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pmpnbp.potentials.kernels.compiling import inner
from pmpnbp.potentials.kernels.pixel_scores import LANES
from pmpnbp.potentials.kernels.projection import NEAR

# What an edge function may be below zero and still count as inside, for vertices in single and in double precision, in
# units of the area of the triangle's box: about ten times the rounding of one number.
SINGLE, DOUBLE = np.float32(5e-7), 2e-15
_ZERO, _ONE = np.float32(0), np.float32(1)


@inner
def row_stride(width: int) -> int:
    """Length of a buffer's rows that are to hold `width` pixels: whole vectors."""
    return (width + LANES - 1) // LANES * LANES


@inner(forceinline=True, fastmath={"nnan", "nsz", "contract"})
def scan_triangle(target: Any, a: Any, b: Any, c: Any, slack: Any) -> None:
    """Draw the triangle a b c, each (u, v, w): u v in pixels of the buffer, w its value; slack : SINGLE or DOUBLE, as
    the vertices are. Single precision will do for a triangle that is not much larger than the image.

    target : (buffer, owner, number, stride, width, height); buffer (height * stride,) float32, of whose rows the first
        `width` values are the image and whose stride is a `row_stride`; owner as buffer, int32, set to `number` where
        the triangle is in front, or None
    """
    buffer, owner, number, stride, width, height = target
    u0, v0, w0 = a
    u1, v1, w1 = b
    u2, v2, w2 = c
    least_u, most_u = min(u0, min(u1, u2)), max(u0, max(u1, u2))
    least_v, most_v = min(v0, min(v1, v2)), max(v0, max(v1, v2))
    left, right = max(np.ceil(least_u), _ZERO), min(np.floor(most_u), np.float32(width - 1))
    top, bottom = max(np.ceil(least_v), _ZERO), min(np.floor(most_v), np.float32(height - 1))
    if top > bottom or left > right:
        return
    u_1, v_1, u_2, v_2 = u1 - u0, v1 - v0, u2 - u0, v2 - v0
    determinant = u_1 * v_2 - u_2 * v_1
    if determinant == _ZERO:
        return
    turn, inverse = (_ONE if determinant > _ZERO else -_ONE), _ONE / determinant
    along_u = ((w1 - w0) * v_2 - (w2 - w0) * v_1) * inverse
    along_v = ((w2 - w0) * u_1 - (w1 - w0) * u_2) * inverse
    # vectors begin at multiples of LANES: a triangle then reads what its neighbour just wrote from the same addresses,
    # and need not wait until it has left the processor's store buffer
    first_row, start = np.int32(top), np.int32(left) & np.int32(-LANES)
    columns = np.int32((np.int32(right) - start + np.int32(LANES)) & np.int32(-LANES))
    u, v = u0 - np.float32(start), v0 - top
    u_1, v_1, u_2, v_2 = u_1 * turn, v_1 * turn, u_2 * turn, v_2 * turn
    margin = (most_u - least_u + np.float32(LANES)) * (most_v - least_v + _ONE) * slack
    on_a, on_c = v_1 * u - u_1 * v, u_2 * v - v_2 * u
    on_b = abs(determinant) - on_a - on_c + margin
    on_a, on_c = on_a + margin, on_c + margin
    last = right - np.float32(start)
    value, most = w0 - along_u * u - along_v * v, max(w0, max(w1, w2))
    begin = np.int64(first_row) * stride + np.int64(start)
    for row in range(np.int32(np.int32(bottom) - first_row + np.int32(1))):
        y = np.float32(row)
        edges = (on_a + u_1 * y, on_b + (u_2 - u_1) * y, on_c - u_2 * y, -v_1, v_1 - v_2, v_2, last)
        _scan_row(buffer, owner, number, np.uint64(begin), columns, edges, value + along_v * y, along_u, most)
        begin += stride


@inner(fastmath={"nnan", "nsz", "contract"})
def _scan_row(
    buffer: Any, owner: Any, number: int, begin: int, columns: int, edges: Any, value: Any, step: Any, most: Any
) -> None:
    on_a, on_b, on_c, across_a, across_b, across_c, last = edges
    for k in range(columns):
        place, x = begin + np.uint64(k), np.float32(k)
        within = min(min(on_a + across_a * x, on_b + across_b * x), on_c + across_c * x) >= _ZERO
        inside = within & (x <= last)
        w, held = np.float32(min(value + step * x, most)), buffer[place]
        front = inside & (w > held)
        if owner is not None:
            owner[place] = number if front else owner[place]
        buffer[place] = w if front else held


@inner
def scan_clipped(target: Any, lens: Any, left: float, top: float, corners: Any, clipped: Any) -> None:
    """As scan_triangle, for corners (3, 3) in camera coordinates of which some may lie before the near plane, into a
    buffer that begins at pixel `left`, `top`. clipped : (4, 3), scratch."""
    count = 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if a[2] >= NEAR:
            for axis in range(3):
                clipped[count, axis] = a[axis]
            count += 1
        if (a[2] >= NEAR) != (b[2] >= NEAR):
            # from the far end to the near one, whichever triangle of the edge asks
            far, near = (a, b) if a[2] >= NEAR else (b, a)
            share = (far[2] - NEAR) / (far[2] - near[2])
            for axis in range(2):
                clipped[count, axis] = far[axis] + share * (near[axis] - far[axis])
            clipped[count, 2] = NEAR
            count += 1
    for k in range(count):
        w = 1.0 / clipped[k, 2]
        clipped[k, 0] = clipped[k, 0] * w * lens[0] + lens[2] - left
        clipped[k, 1] = clipped[k, 1] * w * lens[1] + lens[3] - top
        clipped[k, 2] = w
    first = (clipped[0, 0], clipped[0, 1], clipped[0, 2])
    for k in range(1, count - 1):
        second = (clipped[k, 0], clipped[k, 1], clipped[k, 2])
        third = (clipped[k + 1, 0], clipped[k + 1, 1], clipped[k + 1, 2])
        scan_triangle(target, first, second, third, DOUBLE)
