"""The benchmark of the kernels compares like with like."""

from __future__ import annotations

import numba
import numpy as np
import open3d as o3d
import pytest

from benchmarks import kernels
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render


@pytest.mark.parametrize("triangles", [12, 384])
def test_the_reference_casts_the_rays_of_every_pixel_the_part_covers(rng: np.random.Generator, triangles: int) -> None:
    surfaces = prepare_surfaces(kernels._one_part(triangles))
    assert surfaces.one_sided.all()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(surfaces.vertices.T), surfaces.faces.T.astype(np.uint32))
    camera = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
    for q in poses.random_quaternions(rng, (5,)):
        pose = np.concatenate([rng.normal([0.0, 0.0, 1.4], 0.05), q])
        rays = kernels._part_rays(camera, surfaces, pose)
        hits = np.isfinite(scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy())
        covered = np.count_nonzero(render(camera, surfaces, pose[None])[0])
        assert covered > 300
        assert np.count_nonzero(hits) == pytest.approx(covered, abs=1)


def test_every_case_is_measured_and_the_threads_are_left_as_they_were() -> None:
    before = numba.get_num_threads()
    figures = kernels.measure(seconds=0.01, shapes=(12,), images=((80, 60),))
    assert numba.get_num_threads() == before
    cases = figures["cases"]
    assert isinstance(cases, list)
    assert {case["threads"] for case in cases} == {1, min(2, numba.config.NUMBA_NUM_THREADS)}
    for case in cases:
        assert case["splats"] == pytest.approx(case["splats_ratio"] * case["ray_caster"])
        assert case["rasteriser"] == pytest.approx(case["rasteriser_ratio"] * case["ray_caster"])
        assert 100 < case["pixels"] < 500
    assert "80x60" in kernels.table(figures)
