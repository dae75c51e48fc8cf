"""The specification of the unary potential's kernels: the same in plain NumPy, one pose at a time, slow and obvious.

The rasteriser's twin tests the ray of every pixel against every triangle in space, so it shares no step with the
kernel, which draws spans in the image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.continuation import AHEAD, ENDS, GOES_ON
from pmpnbp.potentials.kernels.pixel_scores import CONTINUED, NO_DEPTH, OBJECT, OUTSIDE, SUPPORT
from pmpnbp.potentials.kernels.projection import NEAR

Floats = NDArray[np.floating]


def robust_scores(
    observed: Floats,
    category: NDArray[np.uint8],
    rendered: Floats,
    terms: Floats,
    firm: NDArray[np.bool_] | bool = False,
) -> Floats:
    """Scores of covered pixels, any shape, from observed and rendered depth in metres and the observation's category.

    terms : those of `PixelScore.terms`
    Within the tolerance 1 - (difference / tolerance)², on a support plane times the support reward, on a surface
    longer than the object times the continued reward, outside the region of interest 0, all times the square of
    observed depth over unit distance. Beyond it, times the square of rendered depth over unit distance: observed behind
    the rendered surface 0 up to where a pixel is seen through, from there on minus the free space cost, and of a `firm`
    pixel that times (difference / reach)² - 1, between 1 and the firm cost, where the reach is the tolerance, or the
    firm step times the observed depth if that is more; observed in front minus the occlusion cost, but a part behind a
    support plane costs as much as one in free space. A pixel that is not firm counts all that times the edge weight.
    """
    tolerance, free_space_cost, occlusion_cost, support_reward, continued_reward = terms[:5]
    unit_distance, firm_cost, firm_step, from_on, edge_weight = terms[5:]
    difference = observed - rendered
    square = (difference / tolerance) ** 2
    farther = (difference / np.maximum(tolerance, firm_step * observed)) ** 2
    through = free_space_cost * np.where(firm, np.clip(farther - 1.0, 1.0, firm_cost), 1.0)
    rewards = {OBJECT: 1.0, SUPPORT: support_reward, CONTINUED: continued_reward}
    reward = np.select([category == what for what in rewards], list(rewards.values()), 0.0)
    behind = np.where(square < from_on, 0.0, -through)
    in_front = np.where(category == SUPPORT, -through, -occlusion_cost)
    explained = np.abs(difference) < tolerance
    score = np.where(explained, reward * (1.0 - square), np.where(difference > 0, behind, in_front))
    depth = np.where(explained, observed, rendered)
    weight = np.where(firm, 1.0, edge_weight) * (depth / unit_distance) ** 2
    return np.where(category == NO_DEPTH, 0.0, score) * weight


def distance_scores(observed: Floats, category: NDArray[np.uint8], rendered: Floats, ray_length: Floats) -> Floats:
    """Minus the distance d of eq. 10, metres, between observed and rendered point of each covered pixel, both on its
    ray, whose length at depth 1 is `ray_length`. 0 where nothing was observed in the region of interest."""
    distance = np.abs(observed - rendered) * ray_length
    return np.where((category == NO_DEPTH) | (category == OUTSIDE), 0.0, -distance)


def splat_score(
    depth: Floats,
    category: NDArray[np.uint8],
    lens: Floats,
    points: Floats,
    area: float,
    terms: Floats,
    robust: bool,
    firm: NDArray[np.bool_],
) -> float:
    """Score of one part from points (P, 3) of its visible surface, in the camera's frame.

    Each point stands for area * fx * fy / z² / P pixels like the one nearest to it. depth, category, firm : (h, w) of
    the observation; lens : fx fy cx cy; area : m², across the line of sight. Points that fall outside the image, or lie
    nearer than 5 cm, cover nothing.
    """
    fx, fy, cx, cy = lens
    height, width = depth.shape
    seen = points[points[:, 2] > 0.05]
    x, y, z = seen.T
    column, row = np.floor(x / z * fx + cx + 0.5), np.floor(y / z * fy + cy + 0.5)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    x, y, z = x[inside], y[inside], z[inside]
    at = row[inside].astype(int), column[inside].astype(int)
    if robust:
        scores = robust_scores(depth[at], category[at], z, terms, firm[at])
    else:
        scores = distance_scores(depth[at], category[at], z, np.sqrt((x / z) ** 2 + (y / z) ** 2 + 1.0))
    return float(np.sum(scores * area * fx * fy / z**2) / len(points))


def draw(vertices: Floats, faces: NDArray[np.int32], lens: Floats, width: int, height: int) -> NDArray[np.float64]:
    """Depth image (height, width), metres, 0 where nothing is, of triangles in the camera's frame.

    vertices : (V, 3); faces : (F, 3); lens : fx fy cx cy. A pixel's ray r = (x, y, 1) meets the triangle a b c in
    z r = (ka a + kb b + kc c) / (ka + kb + kc) with ka = (b x c) . r and so on, if none of the k has a sign other
    than that of a . (b x c); there z = a . (b x c) / (ka + kb + kc). What lies before the near plane is not drawn.
    """
    fx, fy, cx, cy = lens
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones((height, width))], axis=-1)
    nearest = np.full((height, width), np.inf)
    for face in faces:
        a, b, c = np.asarray(vertices[face], dtype=np.float64)
        volume = a @ np.cross(b, c)
        if volume == 0.0:
            continue
        shares = np.stack([rays @ np.cross(b, c), rays @ np.cross(c, a), rays @ np.cross(a, b)]) / volume
        inverse = shares.sum(axis=0)
        hit = np.all(shares >= 0, axis=0) & (inverse > 0)
        depth = 1.0 / np.where(hit, inverse, 1.0)
        nearest = np.where(hit & (depth >= NEAR), np.minimum(nearest, depth), nearest)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def part_score(
    depth: Floats,
    category: NDArray[np.uint8],
    lens: Floats,
    vertices: Floats,
    faces: NDArray[np.int32],
    terms: Floats,
    robust: bool,
    firm: NDArray[np.bool_],
) -> float:
    """Score of one part, drawn alone from vertices (V, 3) in the camera's frame: the sum over its covered pixels."""
    return object_score(depth, category, lens, [vertices], [faces], terms, robust, firm)


def object_score(
    depth: Floats,
    category: NDArray[np.uint8],
    lens: Floats,
    vertices: list[Floats],
    faces: list[NDArray[np.int32]],
    terms: Floats,
    robust: bool,
    firm: NDArray[np.bool_],
    patches: NDArray[np.int16] | None = None,
) -> float:
    """Score of a whole object: the sum over the pixels that any part covers, at the depth of the part in front. Rewards
    on `patches` (h, w), where they are given, are weighed by `patch_weights`, and not once more as CONTINUED."""
    height, width = depth.shape
    fx, fy, cx, cy = lens
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    ray_length = np.sqrt(((column - cx) / fx) ** 2 + ((row - cy) / fy) ** 2 + 1.0)
    drawn = np.stack([draw(*part, lens, width, height) for part in zip(vertices, faces, strict=True)])
    distance = np.where(drawn > 0, drawn, np.inf)
    rendered = distance.min(axis=0)
    covered = np.isfinite(rendered)
    rendered = np.where(covered, rendered, 0.0)
    if robust and patches is not None:
        scores = robust_scores(depth, category, rendered, np.array([*terms[:4], 1.0, *terms[5:]]), firm)
        weights = patch_weights(depth, rendered, patches, terms[0], terms[4])[patches]
        scores = np.where(scores > 0, weights * scores, scores)
    elif robust:
        scores = robust_scores(depth, category, rendered, terms, firm)
    else:
        scores = distance_scores(depth, category, rendered, ray_length)
    return float(scores[covered].sum())


def patch_weights(
    depth: Floats, rendered: Floats, patches: NDArray[np.int16], tolerance: float, least: float
) -> NDArray[np.float64]:
    """The share (K + 1,) of its reward that each patch 0 to K is left with, of what is `rendered`, 0 where nothing is.

    Wherever a row or a column leaves what is rendered, the pixels of a patch are counted on either side of the outline,
    AHEAD of them at most: those rendered within the tolerance before it, and those beyond. Of both together a share
    beyond of ENDS leaves the whole reward, one of GOES_ON or more the share `least` of it.
    """
    explained, beyond = np.zeros(patches.max() + 1), np.zeros(patches.max() + 1)
    close = (rendered > 0) & (np.abs(depth - rendered) < tolerance)
    for covered, fits, numbers in ((rendered > 0, close, patches), ((rendered > 0).T, close.T, patches.T)):
        for line, line_fits, line_numbers in zip(covered, fits, numbers, strict=True):
            for way in (1, -1):
                drawn, fit, number = line[::way], line_fits[::way], line_numbers[::way]
                for place in np.flatnonzero(drawn[:-1] & ~drawn[1:]).tolist():
                    for k in range(place, max(place - AHEAD, -1), -1):
                        if not drawn[k]:
                            break
                        explained[number[k]] += fit[k]
                    for k in range(place + 1, min(place + 1 + AHEAD, len(drawn))):
                        if drawn[k]:
                            break
                        beyond[number[k]] += 1
    share = beyond / np.maximum(explained + beyond, 1)
    weights: NDArray[np.float64] = np.interp(share, [ENDS, GOES_ON], [1.0, least])
    weights[0] = 1.0
    return weights
