"""How is a URDF written down? Boxes, cylinders and spheres as text, links and joints around them."""

from __future__ import annotations

from collections.abc import Sequence

Numbers = Sequence[float]


def _text(numbers: Numbers) -> str:
    return " ".join(f"{number + 0.0:.9g}" for number in numbers)  # + 0.0: no minus before a zero


def _origin(xyz: Numbers, rpy: Numbers) -> str:
    return f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'


def _visual(geometry: str, xyz: Numbers, rpy: Numbers) -> str:
    return f"    <visual>{_origin(xyz, rpy)}<geometry>{geometry}</geometry></visual>"


def box(size: Numbers, xyz: Numbers, rpy: Numbers = (0, 0, 0)) -> str:
    """A `<visual>`: a box of `size` (3,), metres, its centre at `xyz`, turned by `rpy`, radians."""
    return _visual(f'<box size="{_text(size)}"/>', xyz, rpy)


def cylinder(radius: float, length: float, xyz: Numbers, rpy: Numbers = (0, 0, 0)) -> str:
    """A `<visual>`: a cylinder along its own z, metres, its centre at `xyz`."""
    return _visual(f'<cylinder radius="{radius:.6g}" length="{length:.6g}"/>', xyz, rpy)


def sphere(radius: float, xyz: Numbers) -> str:
    """A `<visual>`: a sphere, metres, its centre at `xyz`."""
    return _visual(f'<sphere radius="{radius:.6g}"/>', xyz, (0, 0, 0))


def mesh(filename: str, scale: Numbers, xyz: Numbers, rpy: Numbers = (0, 0, 0)) -> str:
    """A `<visual>`: a mesh file, `filename` relative to the URDF, multiplied by `scale` (3,)."""
    return _visual(f'<mesh filename="{filename}" scale="{_text(scale)}"/>', xyz, rpy)


def link(name: str, visuals: Sequence[str]) -> str:
    """A `<link>` with these visuals."""
    return "\n".join([f'  <link name="{name}">', *visuals, "  </link>"])


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: Numbers,
    rpy: Numbers = (0, 0, 0),
    axis: Numbers | None = None,
    limits: Numbers | None = None,
) -> str:
    """A `<joint>` of type `kind` between two links; `limits` lower and upper, metres or radians."""
    lines = [
        f'  <joint name="{name}" type="{kind}">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f"    {_origin(xyz, rpy)}",
    ]
    if axis is not None:
        lines.append(f'    <axis xyz="{_text(axis)}"/>')
    if limits is not None:
        lower, upper = limits
        lines.append(f'    <limit lower="{lower:.6g}" upper="{upper:.6g}" effort="50" velocity="1"/>')
    return "\n".join([*lines, "  </joint>"])


def slide(name: str, parent: str, child: str, xyz: Numbers, axis: Numbers, reach: float) -> str:
    """A prismatic `<joint>` that comes out by `reach` metres along `axis`."""
    return joint(name, "prismatic", parent, child, xyz, axis=axis, limits=(0, reach))


def robot(name: str, elements: Sequence[str]) -> str:
    """The whole file."""
    return "\n".join(['<?xml version="1.0"?>', f'<robot name="{name}">', *elements, "</robot>", ""])
