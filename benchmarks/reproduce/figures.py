"""How do figures look? As wide as a column, in print's sizes, in colours and strokes that stay apart for every eye."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.viewer.ellipsoids import radius_scale
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.backdrop import backdrop
from pmpnbp.pictures.palette import part_colours
from pmpnbp.pictures.pictures import Pictures
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from sample_data.surroundings import looking_at

matplotlib.use("Agg")  # no screen is needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import FuncFormatter, NullFormatter

# Inches: a column of a two-column page; dots an inch.
COLUMN, DPI = 3.4, 220
# Colours that stay apart whatever one's colour vision (Okabe and Ito 2008), with a stroke each for print in grey.
STROKES: Mapping[str, tuple[str, str]] = {
    "robust": ("#0072B2", "-"),
    "paper": ("#D55E00", "--"),
    "filter": ("#000000", ":"),
    "pull": ("#0072B2", "-"),
    "push": ("#D55E00", "--"),
    "threshold": ("#777777", "-."),
    "seen": ("#0072B2", "-"),
    "hidden": ("#D55E00", "--"),
    "joints": ("#000000", ":"),
}
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Pixels across of a picture of a scene.
ACROSS = 640
# Degrees about the vertical between a scan's camera and the one that shows the same from beside, and how far off that
# one is, in radii of what it shows: as much as it takes in at 525 pixels of focal length and 480 of height.
TURN, DISTANCE = 55.0, 2.3
# What is left around an object on either side, in its own size.
AROUND = 0.2

plt.rcParams.update(
    {
        "font.size": 8,
        "axes.titlesize": 8,
        "axes.labelsize": 8,
        "xtick.labelsize": 7,
        "ytick.labelsize": 7,
        "legend.fontsize": 7,
        "legend.frameon": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.6,
        "lines.linewidth": 1.2,
        "axes.grid": True,
        "grid.linewidth": 0.3,
        "grid.color": "#d0d0d0",
        "figure.constrained_layout.use": True,
        "savefig.dpi": DPI,
    }
)


def panels(rows: int, columns: int, height: float, **more: Any) -> tuple[Figure, Any]:
    """A figure one column wide and `height` inches high, and its axes (rows, columns)."""
    return plt.subplots(rows, columns, figsize=(COLUMN, height), squeeze=False, **more)


def save(figure: Figure, path: Path) -> None:
    """Write the PNG."""
    figure.savefig(path)
    plt.close(figure)


def band(axes: Axes, x: Array, interval: Array, name: str, label: str | None = None) -> None:
    """A line with its interval. interval : (3, X), mean, low and high"""
    mean, low, high = interval
    colour, stroke = STROKES[name]
    axes.plot(x, mean, stroke, color=colour, label=label)
    if np.isfinite(low).all():
        axes.fill_between(x, np.maximum(low, 1e-9), high, color=colour, alpha=0.18, linewidth=0)


def errors_in(axes: Axes, least: float = 0.01) -> None:
    """A logarithmic axis of errors in centimetres, not below `least`: an interval may reach to zero and beyond."""
    axes.set_yscale("log")
    axes.set_ylim(bottom=least)
    plain(axes.yaxis)


def plain(axis: Axis) -> None:
    """Numbers as one writes them along a logarithmic axis, 0.1 and 20, not as powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def beside(axes: Axes, picture: NDArray[np.floating[Any]], title: str) -> None:
    """A picture without axes."""
    axes.imshow(picture)
    axes.set(title=title, xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set(visible=True, color="#d0d0d0")


class Drawing:
    """Draws scans and estimates of one report; what is slow to begin, or would be drawn again, is there once."""

    def __init__(self) -> None:
        self._pictures = Pictures()
        self._observed: dict[int, tuple[Scan, Array]] = {}  # with the scan, so that no other one can have its id

    def close(self) -> None:
        """Free what is held."""
        self._pictures.close()

    def observed(self, scan: Scan) -> Array:
        """The scan in greys (h, w, 3), 0 to 1."""
        if id(scan) not in self._observed:
            height = round(scan.camera.height * ACROSS / scan.camera.width)
            self._observed[id(scan)] = scan, backdrop(scan, ACROSS, height).astype(np.float64)
        return self._observed[id(scan)][1]

    def estimate(self, scan: Scan, model: ArticulatedObject, part_poses: Array) -> Array:
        """The parts at `part_poses` (N, 7) over the scan, (h, w, 3), 0 to 1."""
        self.observed(scan)
        drawn = self._pictures.draw(scan, model, np.asarray(part_poses), ACROSS, scan_name=id(scan))
        return np.asarray(Image.open(io.BytesIO(drawn)).convert("RGB")) / 255.0

    def particles(self, axes: Axes, scan: Scan, particles: Sequence[Array], title: str) -> None:
        """Positions (T, 3), world, of every part's particles over the scan, as its camera sees them."""
        beside(axes, self.observed(scan), title)
        pose_camera_world = poses.inverse(scan.camera.pose_world_camera)
        scale = ACROSS / scan.camera.width
        for positions, colour in zip(particles, part_colours(len(particles)), strict=True):
            points = poses.transform_points(pose_camera_world, np.asarray(positions))
            seen = scan.camera.project(points[points[:, 2] > 0.05]) * scale
            axes.scatter(seen[:, 0], seen[:, 1], s=1.2, color=np.array(colour) / 255, linewidths=0, alpha=0.8)
        axes.set_xlim(0, ACROSS)
        axes.set_ylim(ACROSS * scan.camera.height / scan.camera.width, 0)


def from_beside(scan: Scan, model: ArticulatedObject, part_poses: Array) -> Scan:
    """An empty scan whose camera sees the parts at `part_poses` (N, 7) from another side, on plain ground.

    It has moved about the vertical to the other side of the direction that the object faces, its root's +x, and looks
    at the object's middle from the height it had.
    """
    corners = _corners(model, part_poses)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    away = scan.camera.pose_world_camera[:3] - middle
    faces = poses.rotate(part_poses[0, 3:], np.array([1.0, 0.0, 0.0]))
    left = faces[0] * away[1] - faces[1] * away[0] > 0
    turn = poses.from_rotation_vector(np.array([0.0, 0.0, np.radians(-TURN if left else TURN)]))
    distance = DISTANCE * np.linalg.norm(corners - middle, axis=1).max()
    camera = looking_at(middle + distance * poses.rotate(turn, away / np.linalg.norm(away)), middle)
    return Scan(camera, np.zeros((camera.height, camera.width), np.float32))


def closer(axes: Sequence[Axes], scan: Scan, model: ArticulatedObject, part_poses: Array) -> None:
    """Of pictures of a scan show what is around the parts at `part_poses` (N, 7), in the scan's proportions."""
    seen = poses.transform_points(poses.inverse(scan.camera.pose_world_camera), _corners(model, part_poses))
    pixels = scan.camera.project(seen[seen[:, 2] > 0.05])[:, :2] * ACROSS / scan.camera.width
    size = np.array([ACROSS, ACROSS * scan.camera.height / scan.camera.width])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    half = size / 2 * min(1.0, float(np.max((high - low) / size)) * (1 + 2 * AROUND))
    middle = np.clip((low + high) / 2, half, size - half)
    for one in axes:
        one.set_xlim(middle[0] - half[0], middle[0] + half[0])
        one.set_ylim(middle[1] + half[1], middle[1] - half[1])


def _corners(model: ArticulatedObject, part_poses: Array) -> Array:
    """(K, 3) of all surfaces, world, metres."""
    posed = zip(part_poses, model.parts, strict=True)
    return np.concatenate([poses.transform_points(pose, part.mesh.vertices) for pose, part in posed])


def draw_ellipsoids(axes: Axes, scan: Scan, part_poses: Array, covariances: Array, share: float) -> None:
    """What of each part's position, (N, 7) with covariances (N, 3, 3), square metres, world, holds `share` of its
    belief, as the scan's camera sees it."""
    pose_camera_world = poses.inverse(scan.camera.pose_world_camera)
    turn = poses.to_matrix(pose_camera_world)[:3, :3]
    scale = ACROSS / scan.camera.width
    middles = poses.transform_points(pose_camera_world, part_poses[:, :3])
    for (x, y, z), covariance, colour in zip(middles, covariances, part_colours(len(middles)), strict=True):
        # of the camera's projection at the middle, its Jacobian
        slope = np.array(
            [[scan.camera.fx / z, 0, -scan.camera.fx * x / z**2], [0, scan.camera.fy / z, -scan.camera.fy * y / z**2]]
        )
        variances, main = np.linalg.eigh(slope @ turn @ covariance @ turn.T @ slope.T)
        wide = 2 * scale * radius_scale(share) * np.sqrt(np.maximum(variances, 0.0))
        at = scan.camera.project(np.array([x, y, z]))[:2] * scale
        angle = np.degrees(np.arctan2(main[1, 0], main[0, 0]))
        paint = np.array(colour) / 255
        axes.plot(*at, "o", color=paint, markersize=2.5)  # an ellipse may be too small to be seen
        axes.add_patch(
            Ellipse((at[0], at[1]), *wide, angle=angle, facecolor=(*paint, 0.7), edgecolor=paint, linewidth=0.8)
        )


def name_lines(figure: Figure, axes: Axes, columns: int = 2) -> None:
    """A legend of the lines in `axes` below a figure."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns, columnspacing=1.0)


def name_parts(figure: Figure, names: Sequence[str], columns: int = 4) -> None:
    """A legend of the parts' colours below a figure."""
    dots = [
        Line2D([], [], marker="o", linestyle="", markersize=4, color=(red / 255, green / 255, blue / 255))
        for red, green, blue in part_colours(len(names))
    ]
    figure.legend(dots, list(names), loc="outside lower center", ncols=columns, handletextpad=0.2, columnspacing=1.0)
