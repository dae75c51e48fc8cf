"""How many part poses a second the unary potential scores, as a multiple of what an Open3D ray caster does in the same
run: per thread, by triangle count and image size.

The reference casts the rays of the pixels in the part's bounding box, of many poses in one call, transformed into the
part's frame beforehand and without scoring anything; what the kernels are timed at includes everything from poses to
scores. Run as `python -m benchmarks.kernels`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numba
import numpy as np
import open3d as o3d

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, Renderer, render, unary_scores
from pmpnbp.scene.articulated_object import ArticulatedObject, Mesh, Part
from pmpnbp.scene.observation import NO_DEPTH, OBJECT, Observation, View

# (rings, segments) of the sphere-like part with 2 * rings * segments triangles; the smallest is a box.
SHAPES = {12: (0, 0), 96: (6, 8), 384: (12, 16), 500: (10, 25), 1500: (25, 30), 6000: (50, 60)}
IMAGES = ((80, 60), (160, 120), (320, 240))
EXTENTS = (0.36, 0.15, 0.30)
FIELD_OF_VIEW = np.deg2rad(60.0)
SECONDS = 0.25


def measure(
    seconds: float = SECONDS, shapes: Sequence[int] = tuple(SHAPES), images: Sequence[tuple[int, int]] = IMAGES
) -> dict[str, object]:
    """Rates in part poses per second, and the ratios to the ray caster's, for every case; about `seconds` each for
    the three things measured. shapes : triangle counts of SHAPES; images : (width, height) each

    Returns {"unit": ..., "cases": [{"triangles", "width", "height", "threads", "pixels", "ray_caster", "splats",
    "rasteriser", "splats_ratio", "rasteriser_ratio"}]}; `pixels` is the mean number of pixels the part covers.
    """
    threads_before = numba.get_num_threads()
    cases = []
    try:
        for triangles in shapes:
            surfaces = prepare_surfaces(_one_part(triangles))
            for width, height in images:
                for threads in sorted({1, min(2, numba.config.NUMBA_NUM_THREADS)}):
                    numba.set_num_threads(threads)
                    cases.append({"triangles": triangles, **_case(surfaces, width, height, threads, seconds)})
    finally:
        numba.set_num_threads(threads_before)
    return {"unit": "part poses per second", "cases": cases}


def table(figures: dict[str, object]) -> str:
    """The figures of `measure` as text."""
    lines = ["triangles  image    threads  pixels  ray caster      splats        rasteriser"]
    for case in figures["cases"]:  # type: ignore[attr-defined]
        size = f"{case['width']}x{case['height']}"
        lines.append(
            f"{case['triangles']:9d}  {size:<8} {case['threads']:6d}  {case['pixels']:6.0f} "
            f"{case['ray_caster']:8.0f}/s {case['splats']:10.0f}/s {case['splats_ratio']:5.0f}x "
            f"{case['rasteriser']:9.0f}/s {case['rasteriser_ratio']:5.1f}x"
        )
    return "\n".join(lines)


def _case(surfaces: Surfaces, width: int, height: int, threads: int, seconds: float) -> dict[str, float]:
    focal = width / 2.0 / np.tan(FIELD_OF_VIEW / 2.0)
    camera = Camera(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)
    rng = np.random.default_rng(0)
    count = 8192
    position = rng.normal([0.0, 0.0, 1.4], 0.05, (count, 3))
    pose = np.concatenate([position, poses.random_quaternions(rng, (count,))], axis=1)
    observation = _observation(camera, surfaces, pose[:1])
    rays = [_part_rays(camera, surfaces, one) for one in pose[:256]]
    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(np.ascontiguousarray(surfaces.vertices.T), surfaces.faces.T.astype(np.uint32))
    batch = o3d.core.Tensor(np.concatenate(rays))
    rates = {
        "ray_caster": _rate(lambda: scene.cast_rays(batch, nthreads=threads), len(rays), seconds),
        "splats": _unary_rate(observation, surfaces, pose, "splats", seconds),
        "rasteriser": _unary_rate(observation, surfaces, pose, "rasteriser", seconds),
    }
    pixels = np.mean([np.count_nonzero(render(camera, surfaces, one[None])[0]) for one in pose[:32]])
    return {
        "width": width,
        "height": height,
        "threads": threads,
        "pixels": float(pixels),
        **rates,
        "splats_ratio": rates["splats"] / rates["ray_caster"],
        "rasteriser_ratio": rates["rasteriser"] / rates["ray_caster"],
    }


def _unary_rate(observation: Observation, surfaces: Surfaces, pose: Array, renderer: Renderer, seconds: float) -> float:
    part, score = np.zeros(len(pose), dtype=np.int32), PixelScore()
    return _rate(lambda: unary_scores(observation, surfaces, part, pose, score, renderer=renderer), len(pose), seconds)


def _rate(work: Callable[[], object], poses_each: int, seconds: float) -> float:
    """The best of the calls made within `seconds`, in poses per second: what others do on the machine only slows."""
    work()
    end, best = time.perf_counter() + seconds, np.inf
    while time.perf_counter() < end or best == np.inf:
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return poses_each / float(best)


def _part_rays(camera: Camera, surfaces: Surfaces, pose_world_part: Array) -> Array:
    """Rays (R, 6) float32 in the part's frame, through the pixels of its bounding box."""
    pixels = camera.project(poses.transform_points(pose_world_part, surfaces.vertices.T.astype(np.float64)))
    low, high = np.ceil(pixels[:, :2].min(axis=0)), np.floor(pixels[:, :2].max(axis=0))
    left, top = np.maximum(low, 0).astype(int)
    right, bottom = np.minimum(high, [camera.width - 1, camera.height - 1]).astype(int)
    directions = camera.rays()[top : bottom + 1, left : right + 1].reshape(-1, 3).astype(np.float64)
    pose_part_world = poses.inverse(pose_world_part)
    turned = poses.rotate(pose_part_world[3:], directions)
    return np.concatenate([np.broadcast_to(pose_part_world[:3], turned.shape), turned], axis=1).astype(np.float32)


def _observation(camera: Camera, surfaces: Surfaces, pose: Array) -> Observation:
    """What the camera would see of the part at `pose` (1, 7), nothing around it."""
    depth, _ = render(camera, surfaces, pose)
    category = np.where(depth > 0, OBJECT, NO_DEPTH).astype(np.uint8)
    view = View(camera, depth, category, np.zeros((*depth.shape, 3), dtype=np.float32))
    nothing = np.zeros((0, 3))
    return Observation((view,), nothing, nothing, np.zeros((0, 4)), np.array([0.0, 0.0, 1.0]), None)


def _one_part(triangles: int) -> ArticulatedObject:
    rings, segments = SHAPES[triangles]
    mesh = _box() if rings == 0 else _rounded(rings, segments)
    part = Part("part", ("part",), poses.IDENTITY[None], mesh, mesh, 0.0)
    none = np.zeros(0)
    return ArticulatedObject("part", (part,), (), (), ("part",), (), none, none, np.zeros(0, dtype=np.bool_))


def _box() -> Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * EXTENTS
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(faces, dtype=np.int32))


def _rounded(rings: int, segments: int) -> Mesh:
    """A superellipsoid, a box with rounded edges, as a closed grid of latitudes and longitudes."""
    latitude = (np.arange(rings + 1) / rings - 0.5) * np.pi
    longitude = np.arange(segments) / segments * 2.0 * np.pi
    flat, turn = np.meshgrid(latitude, longitude, indexing="ij")
    across = np.where(np.arange(rings + 1) % rings == 0, 0.0, np.cos(latitude))[:, None]
    unit = np.stack([across * np.cos(turn), across * np.sin(turn), np.sin(flat)], axis=-1).reshape(-1, 3)
    vertices = np.sign(unit) * np.abs(unit) ** 0.5 * np.array(EXTENTS) / 2.0
    faces = []
    for ring in range(rings):
        for segment in range(segments):
            a, b = ring * segments + segment, ring * segments + (segment + 1) % segments
            c, d = a + segments, b + segments
            faces += [(a, b, d), (a, d, c)]
    return Mesh(vertices, np.array(faces, dtype=np.int32))


if __name__ == "__main__":
    print(table(measure()))
