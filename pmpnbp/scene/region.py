"""A box that may hold an object: what `regions` proposes, also of a server's proposals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Region:
    """A thing that stands in a scan.

    roi : (6,) x0 y0 z0 x1 y1 z1, metres, world: the box of its points, and of the model where that fits, and a margin;
    size : (3,) metres: its height, and the longer and the shorter side of its footprint, without a margin, of its
    points; points : share of the measured points that are its; unlikeness : by how much its sides are unlike the
    model's and the model does not fit it, 0 for not at all; None without a model
    """

    roi: NDArray[np.float64]
    size: NDArray[np.float64]
    points: float
    unlikeness: float | None
