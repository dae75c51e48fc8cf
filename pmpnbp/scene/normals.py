"""Which way does the surface at a pixel face? Planes fitted to small windows of a depth image.

In a pinhole image a plane n·P = c is linear in inverse depth: 1/z = (n·ray)/c. So the fit is a 3×3 least-squares
problem in pixel offsets, with closed-form solution, and its residuals have nearly the same spread at every distance,
because the error of a triangulating depth sensor grows with z².
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.camera import Camera

# Half width of the window; 5×5 pixels.
REACH = 2
# Neighbours that differ by more are taken for another surface, metres; and per square metre of depth squared.
STEP, STEP_GROWTH = 0.03, 0.006
# A window that no plane fits to within this is an edge, metres (root mean square).
ROUGHNESS, ROUGHNESS_GROWTH = 0.006, 0.004
# Three points define a plane; fewer than this many do not confirm one.
FEWEST = 7
# Beyond 80° of incidence neither the depth nor the fit means much.
LEAST_COSINE = 0.17


def surface_normals(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Unit normals (h, w, 3) in the camera frame, towards the camera, of `depth` (h, w), metres; zero where unknown."""
    h, w = depth.shape
    # what was not measured is infinitely far from everything
    z = np.pad(np.where(depth > 0, depth, np.inf).astype(np.float64), REACH, constant_values=np.inf)
    inverse, middle = 1.0 / z, (slice(REACH, REACH + h), slice(REACH, REACH + w))
    centre, inverse_centre = depth.astype(np.float64), inverse[middle]
    gate = STEP + STEP_GROWTH * centre**2
    # Weighted sums over the window of 1, u, v, uu, uv, vv, whole numbers below 128, and of (1, u, v, q) q, with q the
    # inverse depth's difference.
    counts = np.zeros((6, h, w), dtype=np.int8)
    q1, qu, qv, qq = np.zeros((4, h, w))
    q, product = np.empty((2, h, w))
    for dv in range(-REACH, REACH + 1):
        for du in range(-REACH, REACH + 1):
            window = (slice(REACH + dv, REACH + dv + h), slice(REACH + du, REACH + du + w))
            np.abs(np.subtract(z[window], centre, out=q), out=q)
            near = q < gate
            np.multiply(np.subtract(inverse[window], inverse_centre, out=q), near, out=q)
            for count, factor in zip(counts, (1, du, dv, du * du, du * dv, dv * dv), strict=True):
                if factor:
                    count += np.int8(factor) * near.view(np.int8)
            q1 += q
            qq += np.multiply(q, q, out=product)
            for total, factor in ((qu, du), (qv, dv)):
                if factor:
                    total += np.multiply(q, factor, out=product)
    s1, su, sv, suu, suv, svv = counts.astype(np.float64)
    # Normal equations [[suu,suv,su],[suv,svv,sv],[su,sv,s1]] (a,b,c) = (qu,qv,q1), by cofactors.
    c00, c01, c02 = svv * s1 - sv * sv, su * sv - suv * s1, suv * sv - svv * su
    c11, c12, c22 = suu * s1 - su * su, suv * su - suu * sv, suu * svv - suv * suv
    determinant = suu * c00 + suv * c01 + su * c02
    known = (centre > 0) & (s1 >= FEWEST) & (determinant > 1e-6 * np.maximum(s1, 1.0) ** 3)
    scale = 1.0 / np.where(known, determinant, 1.0)
    a = (c00 * qu + c01 * qv + c02 * q1) * scale
    b = (c01 * qu + c11 * qv + c12 * q1) * scale
    c = (c02 * qu + c12 * qv + c22 * q1) * scale
    # d(1/z) = -dz/z²: the residual in inverse depth, as metres.
    residual = np.sqrt(np.maximum(qq - a * qu - b * qv - c * q1, 0.0) / np.maximum(s1 - 3, 1.0)) * centre**2
    known &= residual < ROUGHNESS + ROUGHNESS_GROWTH * centre**2
    # 1/z = a (u-u0) + b (v-v0) + c' with c' at the centre, and u-u0 = fx (x/z - x0/z0).
    rays = camera.rays().astype(np.float64)
    at_centre = inverse_centre + c
    normal = np.stack([camera.fx * a, camera.fy * b, at_centre], axis=-1)
    normal[..., 2] -= normal[..., 0] * rays[..., 0] + normal[..., 1] * rays[..., 1]
    normal /= -np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    # Towards the camera wherever the plane's depth along the pixel's own ray is positive.
    cosine = -np.einsum("hwk,hwk->hw", normal, rays) / np.linalg.norm(rays, axis=-1)
    known &= cosine > LEAST_COSINE
    return np.where(known[..., None], normal, 0.0).astype(np.float32)
