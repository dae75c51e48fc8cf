"""The visible surface of a part as points, for each of a grid of directions to look along.

The part is drawn in parallel projection, each direction on a grid fine enough to hold a few thousand pixels of it; the
points are drawn pixels, one from each of as many equal stretches of their Morton order, which spreads them over the
area.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.triangles import SINGLE, scan_triangle

# Side of the drawn grid, a power of two; doubled up to FINEST while fewer than ENOUGH pixels are drawn.
COARSEST, FINEST, ENOUGH = 64, 512, 2000


@kernel
def cell_direction(cell: int, size: int) -> Any:
    """Unit vector at the middle of a cell of the octahedral grid that `splatting.direction_cell` looks up."""
    u = (cell % size + 0.5) / size * 2.0 - 1.0
    v = (cell // size + 0.5) / size * 2.0 - 1.0
    z = 1.0 - abs(u) - abs(v)
    x, y = u, v
    if z < 0.0:
        x = (1.0 - abs(v)) * (1.0 if u >= 0 else -1.0)
        y = (1.0 - abs(u)) * (1.0 if v >= 0 else -1.0)
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@inner
def _even_bits(code: int) -> int:
    """The number whose bits are the even bits of `code`."""
    # neighbours move together, in pairs, fours, eights and sixteens
    code &= 0x55555555
    code = (code | code >> 1) & 0x33333333
    code = (code | code >> 2) & 0x0F0F0F0F
    code = (code | code >> 4) & 0x00FF00FF
    return (code | code >> 8) & 0x0000FFFF


@inner
def _sample(vertices: Any, faces: Any, cell: int, size: int, order: Any, jitter: Any, points: Any) -> float:
    """Fill points (3, P) and return the projected area for one direction."""
    dx, dy, dz = cell_direction(cell, size)
    # any two axes across the direction; the smallest component keeps them well defined
    if abs(dx) <= abs(dy) and abs(dx) <= abs(dz):
        ax, ay, az = 0.0, -dz, dy
    elif abs(dy) <= abs(dz):
        ax, ay, az = dz, 0.0, -dx
    else:
        ax, ay, az = -dy, dx, 0.0
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    count = vertices.shape[1]
    us, vs, ws = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        x, y, z = float(vertices[0, k]), float(vertices[1, k]), float(vertices[2, k])
        us[k] = ax * x + ay * y + az * z
        vs[k] = bx * x + by * y + bz * z
        ws[k] = dx * x + dy * y + dz * z
    least_u, least_v, most_w = us.min(), vs.min(), ws.max()
    extent_u = max(us.max() - least_u, 1e-9)
    extent_v = max(vs.max() - least_v, 1e-9)
    # the front is what is largest, and must be above the empty buffer's zero
    nearest = most_w + 1e-3 * (most_w - ws.min()) + 1e-6
    side, drawn = np.int64(COARSEST), 0
    while True:
        pixel_u, pixel_v = extent_u / side, extent_v / side
        flat = np.zeros(side * side, dtype=np.float32)
        buffer = flat.reshape(side, side)
        target = (flat, None, np.int64(0), side, side, side)
        columns = ((us - least_u) / pixel_u - 0.5).astype(np.float32)
        rows = ((vs - least_v) / pixel_v - 0.5).astype(np.float32)
        heights = (nearest - ws).astype(np.float32)
        for f in range(faces.shape[1]):
            i, j, k = faces[0, f], faces[1, f], faces[2, f]
            a = (columns[i], rows[i], heights[i])
            b = (columns[j], rows[j], heights[j])
            c = (columns[k], rows[k], heights[k])
            scan_triangle(target, a, b, c, SINGLE)
        drawn = 0
        for row in range(side):
            for column in range(side):
                drawn += buffer[row, column] > 0
        if drawn >= ENOUGH or side >= FINEST:
            break
        side *= 2
    wanted = points.shape[1]
    if drawn == 0:
        return 0.0
    # a random pixel of each stretch of drawn / wanted, put at a random place of the list; the same pixel of every
    # stretch would be a lattice in the image, which miscounts narrow faces
    taken, passed = 0, 0
    for code in range(side * side):
        column, row = _even_bits(code), _even_bits(code >> 1)
        value = buffer[row, column]
        if value > 0:
            passed += 1
            while taken < wanted and (taken + jitter[taken]) * drawn < passed * wanted:
                u = least_u + (column + 0.5) * pixel_u
                v = least_v + (row + 0.5) * pixel_v
                w = nearest - value
                place = order[taken]
                points[0, place] = ax * u + bx * v + dx * w
                points[1, place] = ay * u + by * v + dy * w
                points[2, place] = az * u + bz * v + dz * w
                taken += 1
    return drawn * pixel_u * pixel_v


@kernel(parallel=True)
def _sample_directions(vertices: Any, faces: Any, size: int, order: Any, jitter: Any, points: Any, areas: Any) -> None:
    for cell in prange(size * size):
        areas[cell] = _sample(vertices, faces, np.int64(cell), size, order[cell], jitter[cell], points[cell])


def sample_directions(
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    size: int,
    order: NDArray[np.int32],
    jitter: NDArray[np.float64],
    points: NDArray[np.float32],
    areas: NDArray[np.float32],
) -> None:
    """Fill points (D, 3, P) and areas (D,), m², for the D = size * size directions of one part.

    vertices : (3, V), metres; faces : (3, F); order : (D, P), the place in the list that each point gets;
    jitter : (D, P), 0 to 1, which pixel of its stretch it is
    """
    _sample_directions(vertices, faces, size, order, jitter, points, areas)
