"""One triangle into a z-buffer.

A pixel is covered where its centre lies in the triangle, edges included. The buffer holds a value that is affine in
the image, the larger in front: 1/z for a pinhole camera, minus the depth in parallel projection. A zero is a pixel
where nothing was drawn.

Triangles are drawn by rows. The ends of a row's span come from the lines through the edges, which two neighbours
compute from the same two vertices to the same bit, so that a closed mesh has no cracks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from pmpnbp.potentials.kernels.pixel_scores import LANES
from pmpnbp.potentials.kernels.projection import NEAR

# Added to a column, it takes a bound out of the image on the side where it does not bound.
_BEYOND = 1e12


@njit(nogil=True, cache=True, error_model="numpy")
def row_stride(width: int) -> int:
    """Length of a buffer's rows that are to hold `width` pixels: what is written beyond a row's end is what was there,
    but the last row needs LANES more."""
    return (width + LANES - 1) // LANES * LANES


@njit(nogil=True, cache=True, error_model="numpy")
def scan_triangle(target: Any, a: Any, b: Any, c: Any) -> None:
    """Draw the triangle a b c, each (u, v, w): u v in pixels of the buffer, w its value.

    target : (buffer, owner, number, stride, width, height); buffer (height * stride + LANES,) float32, of whose rows
        the first `width` values are the image; owner as buffer, int16, set to `number` where the triangle is in front,
        or None
    """
    buffer, owner, number, stride, width, height = target
    u0, v0, w0 = a
    u1, v1, w1 = b
    u2, v2, w2 = c
    top = max(np.ceil(min(v0, v1, v2)), 0.0)
    bottom = min(np.floor(max(v0, v1, v2)), height - 1.0)
    leftmost = max(np.ceil(min(u0, u1, u2)), 0.0)
    rightmost = min(np.floor(max(u0, u1, u2)), width - 1.0)
    if top > bottom or leftmost > rightmost:
        return
    determinant = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if determinant == 0.0:
        return
    along_u = ((w1 - w0) * (v2 - v0) - (w2 - w0) * (v1 - v0)) / determinant
    along_v = ((u1 - u0) * (w2 - w0) - (u2 - u0) * (w1 - w0)) / determinant
    at_origin = w0 - along_u * u0 - along_v * v0
    clockwise = determinant > 0.0
    slope_a, shift_a, low_a, high_a = _edge(u0, v0, u1, v1, clockwise)
    slope_b, shift_b, low_b, high_b = _edge(u1, v1, u2, v2, clockwise)
    slope_c, shift_c, low_c, high_c = _edge(u2, v2, u0, v0, clockwise)
    step, left, columns = np.float32(along_u), int(leftmost), int(rightmost) - int(leftmost) + 1
    for row in range(int(top), int(bottom) + 1):
        y = float(row)
        on_a, on_b, on_c = y * slope_a + shift_a, y * slope_b + shift_b, y * slope_c + shift_c
        first = max(max(on_a + low_a, on_b + low_b), max(on_c + low_c, leftmost))
        last = min(min(on_a + high_a, on_b + high_b), min(on_c + high_c, rightmost))
        value = np.float32(at_origin + along_v * y + along_u * first)
        span = (np.float32(first - leftmost), np.float32(last - leftmost), value, step)
        _fill_span(buffer, owner, number, row * stride + left, columns, span)


@njit(nogil=True, cache=True, error_model="numpy")
def _edge(u0: float, v0: float, u1: float, v1: float, clockwise: bool) -> Any:
    """The line u = v * slope + shift through an edge, and what to add to u so that it bounds a span's begin or end.

    Every term only changes its sign where the vertices are swapped. A horizontal edge bounds no span: the triangle's
    rows end there.
    """
    rise = v1 - v0
    flat = rise == 0.0
    inverse = 1.0 / (1.0 if flat else rise)
    end = (rise > 0.0) == clockwise
    slope = 0.0 if flat else (u1 - u0) * inverse
    shift = 0.0 if flat else (u0 * v1 - u1 * v0) * inverse
    return slope, shift, (-_BEYOND if flat or end else 0.0), (_BEYOND if flat or not end else 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_span(buffer: Any, owner: Any, number: int, begin: int, columns: int, span: Any) -> None:
    """Draw a row's span (first, last, value at first, step), columns counted from `begin` and not whole.

    All of the triangle's columns are visited in every row, in whole vectors, and those outside the span are written
    with what they held: a loop over the span alone has a length that changes by the row, and costs more in
    mispredicted branches and scalar remainders than it saves. Rounding a bound to single precision can only move it
    onto a column, never across, so it opens no crack.
    """
    first, last, value, step = span
    start = np.uint64(begin)
    for k in range(np.int32((columns + LANES - 1) & -LANES)):
        place, column = start + np.uint64(k), np.float32(k)
        w, held = value + step * (column - first), buffer[place]
        front = (column >= first) & (column <= last) & (w > held)
        if owner is not None:
            owner[place] = number if front else owner[place]
        buffer[place] = w if front else held


@njit(nogil=True, cache=True, error_model="numpy")
def scan_clipped(target: Any, lens: Any, left: float, top: float, corners: Any, clipped: Any) -> None:
    """As scan_triangle, for corners (3, 3) in camera coordinates of which some may lie before the near plane, into a
    buffer that begins at pixel `left`, `top`. clipped : (4, 3), scratch."""
    count = 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if a[2] >= NEAR:
            clipped[count] = a
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
        scan_triangle(target, first, second, third)
