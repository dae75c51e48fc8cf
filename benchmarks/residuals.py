"""What is left between scan and render at the estimate, on a real robot: the likelihood's assumptions against it.

The robust pixel score takes a residual for a draw from a Gaussian of half the tolerance, and pixels for independent.
Here both are looked at, pixel by pixel, on the real depth images of the xArm 7, and whether surfaces that are seen at a
grazing angle are noisier: `python -m benchmarks.residuals`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_data import DATA, ROBOTS, measure
from benchmarks.tables import markdown
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import DEVIATIONS
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.depth_noise import NEAR, NORMAL_MEDIAN, SECOND_DIFFERENCE
from pmpnbp.scene.observation import CONTINUED, OBJECT, View
from pmpnbp.settings import SessionOptions, preset

# Bins of |residual| / tolerance, the last without an end.
EDGES = (0.0, 0.25, 0.5, 0.75, 1.0, 2.0, 4.0)
# Distances in pixels whose correlation is told, and up to which pixels are asked whether they say the same.
LAGS, FARTHEST = (1, 2, 4, 8), 12
# Bins of the tangent between the line of sight and a surface's normal, and of how many a deviation is told.
SLOPES, ENOUGH = (0.0, 0.5, 1.0, 1.5, 5.0), 30


def residual_image(view: View, surfaces: Surfaces, part_poses: Array) -> NDArray[np.float64]:
    """(h, w) metres, seen minus rendered, of parts at poses (N, 7); NaN where nothing is rendered or what is seen is
    not the object's to explain: no depth, outside the region of interest, on a support plane."""
    rendered, _ = render(view.camera, surfaces, part_poses)
    compared = (rendered > 0) & np.isin(view.category, (OBJECT, CONTINUED))
    return np.where(compared, view.depth.astype(np.float64) - rendered, np.nan)


def correlation(residuals: NDArray[np.float64]) -> Array:
    """(2 FARTHEST + 1, 2 FARTHEST + 1) of an image (h, w), NaN where unknown: the mean product of two residuals so
    many rows and columns apart, over that of one with itself, in the middle. Their mean is not taken off: an offset
    that all share is the strongest correlation there is."""
    known = np.isfinite(residuals)
    values = np.where(known, residuals, 0.0)
    shape = [size + FARTHEST for size in residuals.shape]
    products, pairs = (
        np.fft.irfft2(np.abs(np.fft.rfft2(each, shape)) ** 2, shape) for each in (values, known.astype(np.float64))
    )
    lags = np.arange(-FARTHEST, FARTHEST + 1)
    products, pairs = products[np.ix_(lags, lags)], np.round(pairs[np.ix_(lags, lags)])
    mean = products / np.maximum(pairs, 1.0)
    found: Array = mean / mean[FARTHEST, FARTHEST]
    return found


def tangents(view: View) -> NDArray[np.float64]:
    """(h, w): tangent of the angle between the line of sight and the surface's normal, NaN where that is unknown."""
    rays = view.camera.rays()
    cosine = np.abs((view.normals * rays).sum(axis=-1)) / np.linalg.norm(rays, axis=-1)
    with np.errstate(divide="ignore"):
        found: NDArray[np.float64] = np.sqrt(np.maximum(1.0 / cosine**2 - 1.0, 0.0))
    return np.where(view.normals.any(axis=-1), found, np.nan)


def by_slope(view: View, residuals: NDArray[np.float64], tolerance: float) -> tuple[list[Array], list[Array]]:
    """Of each bin of SLOPES, of smooth surfaces about as far away as the object: the scan's second differences, metres,
    as deviations of one pixel; and those of `residuals` (h, w) that are within two tolerances."""
    depth = np.where(view.depth > 0, view.depth, np.nan).astype(np.float64)
    bends = np.full((2, *depth.shape), np.nan)
    bends[0, :, 1:-1] = np.diff(1.0 / depth, 2, axis=1)
    bends[1, 1:-1] = np.diff(1.0 / depth, 2, axis=0)
    bends *= depth**2
    smooth = (np.abs(bends) < tolerance * np.sqrt(SECOND_DIFFERENCE)).all(axis=0)
    smooth &= np.abs(np.log(depth / view.distance)) < np.log(NEAR)
    place = np.digitize(tangents(view), [*SLOPES[1:], np.inf])  # an unknown one behind the last
    kept = [smooth & (place == bin) for bin in range(len(SLOPES) - 1)]
    own = [bends[:, one].ravel() / np.sqrt(SECOND_DIFFERENCE) for one in kept]
    return own, [residuals[one & (np.abs(residuals) < 2 * tolerance)] for one in kept]


def slope_table(views: dict[str, tuple[View, NDArray[np.float64], float]]) -> str:
    """Deviations by slope, of all views together: of scans from their own surfaces, and from what is rendered."""
    both = [by_slope(*each) for each in views.values()]
    rows = []
    for name, kind in (("the scan's own surfaces (mm)", 0), ("seen minus rendered (mm)", 1)):
        bins = [np.concatenate(each) for each in zip(*(found[kind] for found in both), strict=True)]
        rows.append([name, *(f"{1000 * _deviation(one):.1f}" if len(one) > ENOUGH else "–" for one in bins)])
    return markdown(["tangent", *(f"{low:g} to {high:g}" for low, high in pairwise(SLOPES))], rows)


def _deviation(values: Array) -> float:
    return float(np.median(np.abs(values))) / NORMAL_MEDIAN


def core_shares(edges: Sequence[float]) -> Array:
    """Shares of |residual| / tolerance between `edges`, which end at 1, as the score's Gaussian within it has them."""
    fine = np.linspace(0.0, 1.0, 20_001)
    density = np.exp(-0.5 * (DEVIATIONS * fine) ** 2)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.diff(np.interp(edges, fine, cumulative / cumulative[-1]))


def report(images: dict[str, tuple[NDArray[np.float64], float]]) -> str:
    """The tables of residual images (h, w), metres, and tolerances, metres, by name."""
    rows, counts = [], np.zeros(len(EDGES))
    for name, (image, tolerance) in images.items():
        known = image[np.isfinite(image)]
        near = np.abs(known) < tolerance
        related = correlation(np.where(np.abs(image) < tolerance, image, np.nan))
        along = [0.5 * (related[FARTHEST, FARTHEST + lag] + related[FARTHEST + lag, FARTHEST]) for lag in LAGS]
        middle = float(np.median(known[near]))
        rows.append(
            [
                name,
                len(known),
                f"{100 * near.mean():.0f}",
                f"{1000 * middle:+.1f}",
                f"{1000 * float(np.median(np.abs(known[near] - middle))) / 0.6745:.1f}",
                f"{100 * (known >= tolerance).mean():.0f}",
                f"{100 * (known <= -tolerance).mean():.0f}",
                *(f"{one:.2f}" for one in along),
                f"{max(float(related.sum()), 1.0):.0f}",
            ]
        )
        counts += np.histogram(np.abs(known) / tolerance, [*EDGES, np.inf])[0]
    header = ["scan", "pixels", "within τ (%)", "median (mm)", "deviation (mm)", "through (%)", "in front (%)"]
    header += [f"correlation at {lag}" for lag in LAGS] + ["pixels that say the same"]
    inside = EDGES.index(1.0)
    expected = [f"{100 * share:.0f}" for share in core_shares(EDGES[: inside + 1])]
    names = [f"{low:g} to {high:g}" for low, high in pairwise(EDGES)] + [f"from {EDGES[-1]:g}"]
    measured = [f"{100 * count / counts[:inside].sum():.0f}" for count in counts]
    bins = [
        ["of those within τ: measured (%)", *measured],
        ["the score's Gaussian (%)", *expected, *["–"] * (len(EDGES) - inside)],
    ]
    return "\n\n".join([markdown(header, rows), markdown(["residual / τ", *names], bins)])


def main(arguments: Sequence[str] | None = None, data: Path = DATA) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--iterations", type=int, default=ROBOTS["xarm"].iterations)
    parser.add_argument("--particles", type=int, default=SessionOptions.particles)
    chosen = parser.parse_args(arguments)
    robot, settings = ROBOTS["xarm"], preset("robust")
    if not (data / robot.folder).is_dir():
        print(f"{robot.title}: skipped, its data is not there")
        return
    views = {}
    for run in measure(robot, 1, chosen.iterations, chosen.particles, settings, data):
        (view,) = run.case.observation.views
        surfaces = prepare_surfaces(run.case.model)
        image = residual_image(view, surfaces, run.trial.part_poses)
        views[run.scan] = view, image, settings.tolerance_end
    images = {name: (image, tolerance) for name, (_, image, tolerance) in views.items()}
    print(report(images), slope_table(views), sep="\n\n")


if __name__ == "__main__":
    main()
