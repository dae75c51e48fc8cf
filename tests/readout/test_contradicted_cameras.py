"""Two views whose cameras cannot both be where they are said to be are no good fit, however well each is explained."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pmpnbp

CABINET = Path(__file__).parents[2] / "sample_data" / "cabinet"


@pytest.mark.parametrize(
    ("axis", "off", "fit", "said"),
    [
        (0, 0.005, "good", "should be seen"),
        (0, 0.03, "doubtful", " of its standard deviations"),
        (2, 0.03, "doubtful", " of its standard deviations"),
    ],
)
def test_a_camera_far_from_where_it_is_said_to_be_is_doubted(
    tmp_path: Path, axis: int, off: float, fit: str, said: str
) -> None:
    """5 mm is what cameras may be off by: each link was certain to a third of a millimetre, 3 cm from its place."""
    scans, cameras = [], []
    for number, view in enumerate(("from_above", "lowered")):
        camera = json.loads((CABINET / view / "camera.json").read_text())
        camera["T_world_camera"][4 * axis + 3] += number * off
        cameras.append(tmp_path / f"{view}.json")
        cameras[-1].write_text(json.dumps(camera))
        scans.append(CABINET / view / "depth.png")
    roi = json.loads((CABINET / "from_above" / "roi.json").read_text())["roi"]
    found = pmpnbp.estimate(CABINET / "cabinet.urdf", scans, camera=cameras, roi=roi)
    assert found.fit == fit and found.fit_reason.endswith(said), found.verdict
    assert ("but the camera pose of scan 1 would be off by" in found.fit_reason) == (fit == "doubtful")
    assert found.links["frame"].certain == (fit == "good")
    moved = np.array([found.nuisances[f"camera/1/{name}"].value for name in "xyz"])
    assert np.linalg.norm(moved) > (0.02 if fit == "doubtful" else 0.0)
