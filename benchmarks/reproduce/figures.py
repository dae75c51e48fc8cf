"""How do figures look? As wide as a column, in print's sizes, in colours and strokes that stay apart for every eye."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from app.palette import part_colours
from app.pictures.backdrop import backdrop
from app.pictures.pictures import Pictures
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan

matplotlib.use("Agg")  # no screen is needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

# Inches: a column of a two-column page; dots an inch.
COLUMN, DPI = 3.4, 300
# Colours that stay apart whatever one's colour vision (Okabe and Ito 2008), with a stroke each for print in grey.
STROKES: Mapping[str, tuple[str, str]] = {
    "robust": ("#0072B2", "-"), "paper": ("#D55E00", "--"), "filter": ("#000000", ":"),
    "pull": ("#0072B2", "-"), "push": ("#D55E00", "--"), "threshold": ("#777777", "-."),
}  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Pixels across of a picture of a scene.
ACROSS = 640

plt.rcParams.update({
    "font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7,
    "legend.fontsize": 7, "legend.frameon": False, "axes.spines.top": False, "axes.spines.right": False,
    "axes.linewidth": 0.6, "lines.linewidth": 1.2, "axes.grid": True, "grid.linewidth": 0.3, "grid.color": "#d0d0d0",
    "figure.constrained_layout.use": True, "savefig.dpi": DPI,
})  # fmt: skip


def panels(rows: int, columns: int, height: float, **more: Any) -> tuple[Figure, Any]:
    """A figure one column wide and `height` inches high, and its axes (rows, columns)."""
    return plt.subplots(rows, columns, figsize=(COLUMN, height), squeeze=False, **more)


def save(figure: Figure, path: Path) -> None:
    """Write the PNG."""
    figure.savefig(path)
    plt.close(figure)


def band(axes: Axes, x: Array, mean: Array, low: Array, high: Array, name: str, label: str | None = None) -> None:
    """A line with its interval."""
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


def beside(axes: Axes, picture: Array, title: str) -> None:
    """A picture without axes."""
    axes.imshow(picture)
    axes.set(title=title, xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set(visible=True, color="#d0d0d0")


def observed(scan: Scan) -> Array:
    """The scan in greys (h, w, 3), 0 to 1."""
    height = round(scan.camera.height * ACROSS / scan.camera.width)
    return backdrop(scan, ACROSS, height).astype(np.float64)


def draw_particles(axes: Axes, scan: Scan, particles: Sequence[Array], title: str) -> None:
    """Positions (T, 3), world, of every part's particles over the scan, as its camera sees them."""
    beside(axes, observed(scan), title)
    pose_camera_world = poses.inverse(scan.camera.pose_world_camera)
    scale = ACROSS / scan.camera.width
    for positions, colour in zip(particles, part_colours(len(particles)), strict=True):
        points = poses.transform_points(pose_camera_world, np.asarray(positions))
        seen = scan.camera.project(points[points[:, 2] > 0.05]) * scale
        axes.scatter(seen[:, 0], seen[:, 1], s=1.2, color=np.array(colour) / 255, linewidths=0, alpha=0.8)
    height, width = observed(scan).shape[:2]
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)


def estimate_picture(pictures: Pictures, scan: Scan, model: ArticulatedObject, part_poses: Array) -> Array:
    """The parts at `part_poses` (N, 7) over the scan, (h, w, 3), 0 to 1."""
    drawn = Image.open(io.BytesIO(pictures.draw(scan, model, np.asarray(part_poses), ACROSS)))
    return np.asarray(drawn.convert("RGB")) / 255.0


def name_lines(figure: Figure, axes: Axes, columns: int = 2) -> None:
    """A legend of the lines in `axes` below a figure."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def name_parts(figure: Figure, names: Sequence[str], columns: int = 4) -> None:
    """A legend of the parts' colours below a figure."""
    dots = [
        plt.Line2D([], [], marker="o", linestyle="", markersize=4, color=np.array(colour) / 255)
        for colour in part_colours(len(names))
    ]
    figure.legend(dots, list(names), loc="outside lower center", ncols=columns, handletextpad=0.2, columnspacing=1.0)
