"""The tree of an object's edges as the kernels take it, and in which order its edges are reached from each part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.tree import Tree
from pmpnbp.scene.articulated_object import Edge


def tree_table(edges: Sequence[Edge], parts: int) -> Tree:
    """The table of the tree's edges, each after the one that reaches its parent, over so many parts."""
    count, depth = len(edges), max((len(edge.axes) for edge in edges), default=1)

    def filled(name: str, dtype: type, *shape: int) -> NDArray[Any]:
        table: NDArray[Any] = np.zeros((count, depth, *shape), dtype=dtype)
        for row, edge in enumerate(edges):
            table[row, : len(edge.axes)] = getattr(edge, name)
        return table

    reached = [_reached(edges, part) for part in range(parts)]
    return Tree(
        parent=np.array([edge.parent for edge in edges], dtype=np.int64),
        child=np.array([edge.child for edge in edges], dtype=np.int64),
        axis_count=np.array([len(edge.axes) for edge in edges], dtype=np.int64),
        before=filled("poses_before", np.float64, 7),
        revolute=filled("revolute", np.bool_),
        axes=filled("axes", np.float64, 3),
        after=np.array([edge.pose_after for edge in edges], dtype=np.float64).reshape(-1, 7),
        lower=filled("lower", np.float64),
        upper=filled("upper", np.float64),
        coordinates=filled("coordinates", np.int64),
        multiplier=filled("multiplier", np.float64),
        offset=filled("offset", np.float64),
        order=np.array([[row for row, _ in way] for way in reached], dtype=np.int64).reshape(parts, count),
        outward=np.array([[out for _, out in way] for way in reached], dtype=np.bool_).reshape(parts, count),
    )


def _reached(edges: Sequence[Edge], part: int) -> list[tuple[int, bool]]:
    """The edges in the order in which a walk from `part` takes them, and whether it takes each from its parent."""
    there, way = {part}, []
    waiting = list(enumerate(edges))
    while waiting:
        later = []
        for row, edge in waiting:
            if edge.parent not in there and edge.child not in there:
                later.append((row, edge))
                continue
            way.append((row, edge.parent in there))
            there |= {edge.parent, edge.child}
        waiting = later
    return way
