"""How does a scene frame get into viser? The one module that makes, changes and removes viser's nodes.

A node that was there in the frame before is changed, not made again, and of it only what differs is sent: meshes once,
then their poses. viser compares arrays; the same object as before is not even compared.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import trimesh
import viser

from app.viewer.scene_frame import (
    Axes,
    Copies,
    Ellipsoids,
    Frustum,
    Handle,
    Label,
    Lines,
    Node,
    Points,
    SceneFrame,
    Surface,
)
from pmpnbp.geometry.poses import Array

# Called with a handle's name and the pose (7,) it was dragged to; `done` at the end of the gesture.
Dragged = Callable[[str, Array, bool], None]


class Drawing:
    """What of a scene is in viser. Not thread-safe: one thread draws at a time."""

    def __init__(self, server: viser.ViserServer, dragged: Dragged) -> None:
        self._server = server
        self._dragged = dragged
        self._nodes: dict[str, tuple[Node, Any]] = {}
        # handles that somebody holds just now: their pose is not set meanwhile
        self._held: set[str] = set()

    def draw(self, frame: SceneFrame) -> None:
        """Make the scene what the frame says, at once for whoever looks."""
        wanted = {node.name: node for node in frame.nodes}
        with self._server.atomic():
            # below before above: removing a node takes along what is below it
            for name in sorted(set(self._nodes) - set(wanted), reverse=True):
                self._remove(name)
            for name, node in wanted.items():
                old, handle = self._nodes.get(name, (None, None))
                if old is not None and not _changeable(old, node):
                    self._remove(name)
                    old = None
                if old is None:
                    handle = self._add(node)
                elif name in self._held:
                    node = old
                else:
                    _change(handle, old, node)
                self._nodes[name] = node, handle

    def _remove(self, name: str) -> None:
        for known in [known for known in self._nodes if known == name or known.startswith(name + "/")]:
            _, handle = self._nodes.pop(known)
            if known == name:
                handle.remove()

    def _add(self, node: Node) -> Any:
        scene, name = self._server.scene, node.name
        if isinstance(node, Axes):
            return scene.add_batched_axes(
                name, node.poses[:, 3:], node.poses[:, :3], axes_length=node.length, axes_radius=node.length / 28
            )
        given = {prop: getattr(node, member) for member, prop in _PROPERTIES[type(node)].items()}
        if not isinstance(node, Points | Ellipsoids | Copies):
            given |= {"position": node.pose[:3], "wxyz": node.pose[3:]}
        unlit: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
        if isinstance(node, Points):
            precision: Any = "float32" if node.exact else "float16"
            return scene.add_point_cloud(
                name, **given, point_shape=node.shape, precision=precision, point_shading="flat"
            )
        if isinstance(node, Surface):
            side: Any = "double" if node.both_sides else "front"
            return scene.add_mesh_simple(name, node.vertices, node.faces, **given, **unlit, side=side)
        if isinstance(node, Lines):
            return scene.add_line_segments(name, **given, thickness_units="screen")
        if isinstance(node, Ellipsoids | Copies):
            vertices, faces = _sphere() if isinstance(node, Ellipsoids) else (node.vertices, node.faces)
            return scene.add_batched_meshes_simple(name, vertices, faces, **given, **unlit, lod="off")
        if isinstance(node, Label):
            return scene.add_label(name, **given, anchor="bottom-center")
        if isinstance(node, Frustum):
            return scene.add_camera_frustum(name, **given, **unlit, thickness=1.25, thickness_units="screen")
        return self._add_handle(node, given)

    def _add_handle(self, node: Handle, given: dict[str, Any]) -> Any:
        handle = self._server.scene.add_transform_controls(
            node.name, **given, line_width=3.0, disable_rotations=not node.turns, depth_test=False, opacity=0.9
        )

        async def moved(event: Any) -> None:  # async: viser keeps the order of a gesture's phases then
            if event.phase == "start":
                self._held.add(node.name)
            elif event.phase == "end":
                self._held.discard(node.name)
            pose = np.concatenate([event.target.position, event.target.wxyz]).astype(np.float64)
            self._dragged(node.name, pose, event.phase == "end")

        handle.on_update(moved)
        return handle


def _changeable(old: Node, new: Node) -> bool:
    """Whether viser's node for the one can become that for the other."""
    if type(old) is not type(new):
        return False
    if isinstance(old, Points) and isinstance(new, Points):
        return old.exact == new.exact and old.shape == new.shape
    if isinstance(old, Surface) and isinstance(new, Surface):
        return old.vertices is new.vertices and old.both_sides == new.both_sides
    if isinstance(old, Copies) and isinstance(new, Copies):
        return old.vertices is new.vertices and len(old.centres) == len(new.centres)
    if isinstance(old, Handle) and isinstance(new, Handle):
        return old.turns == new.turns
    return True


def _change(handle: Any, old: Any, new: Any) -> None:
    """Tell viser what differs."""
    if isinstance(new, Axes):
        handle.batched_positions, handle.batched_wxyzs = new.poses[:, :3], new.poses[:, 3:]
        return
    for member, prop in _PROPERTIES[type(new)].items():
        value = getattr(new, member)
        if value is not getattr(old, member):
            setattr(handle, prop, np.asarray(value, dtype=np.uint8) if prop == "colors" else value)
    if hasattr(new, "pose") and not np.array_equal(new.pose, old.pose):
        handle.position, handle.wxyz = new.pose[:3], new.pose[3:]


_BATCHED = {
    "centres": "batched_positions",
    "turns": "batched_wxyzs",
    "colours": "batched_colors",
    "opacities": "batched_opacities",
}
# Members of a node and viser's properties that they become; what makes a node calls them the same.
_PROPERTIES: dict[type, dict[str, str]] = {
    Points: {"points": "points", "colours": "colors", "size": "point_size"},
    Surface: {"colour": "color", "opacity": "opacity"},
    Lines: {"segments": "points", "colour": "colors", "width": "thickness"},
    Ellipsoids: {**_BATCHED, "radii": "batched_scales"},
    Copies: _BATCHED,
    Frustum: {"colour": "color", "image": "image", "aspect": "aspect", "field_of_view": "fov", "size": "scale"},
    Label: {"text": "text", "size": "font_screen_scale"},
    Handle: {"size": "scale"},
}


@cache
def _sphere() -> tuple[Any, Any]:
    """A unit sphere's vertices and faces."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return np.asarray(sphere.vertices, dtype=np.float32), np.asarray(sphere.faces, dtype=np.uint32)
