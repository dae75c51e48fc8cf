"""What the tests of a calibration calibrate: a box with a tray, as files and as a task."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibrate.task import Task, task_of
from pmpnbp.geometry.poses import Array
from pmpnbp.settings import changed, preset

SLIDER = """\
<robot name="slider">
<link name="box"><visual><origin xyz="0 0 0.15"/><geometry><box size="0.3 0.4 0.3"/></geometry></visual></link>
<link name="tray"><visual><origin xyz="-0.12 0 0"/><geometry><box size="0.24 0.34 0.12"/></geometry></visual></link>
<joint name="slide" type="prismatic"><parent link="box"/><child link="tray"/><origin xyz="0.16 0 0.15"/>
<axis xyz="1 0 0"/><limit lower="0" upper="0.2" effort="1" velocity="1"/></joint>
</robot>
"""
# As much of the search as a test of what comes after it needs.
QUICK = {"search_proposals": 200, "search_islands": 2, "search_iterations": 2}


def slider(folder: Path) -> Path:
    """Its URDF in a folder."""
    path = folder / "slider.urdf"
    path.write_text(SLIDER)
    return path


def task(folder: Path, camera: Path | None = None, region: Array | None = None, **more: Any) -> Task:
    """To calibrate it."""
    prior: Path | None = more.pop("prior", None)
    return task_of(slider(folder), camera, region, prior, changed(preset("robust"), QUICK), **more)


def cube(side: float) -> Array:
    """(6,) a region about the origin, on the ground."""
    return np.array([-side / 2, -side / 2, 0.0, side / 2, side / 2, side])
