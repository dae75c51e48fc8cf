"""How long an object is: of boxes it is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.extent import length_of, lengths_along_root
from pmpnbp.scene.urdf import load_model

# A drawer that is 0.3 to 0.5 m out of a box; its far end is 1.2 m from the box's.
URDF = """
<robot name="chest">
  <link name="box"><visual><geometry><box size="0.8 0.1 0.1"/></geometry></visual></link>
  <link name="bare"/>
  <link name="drawer"><visual><geometry><box size="1.0 0.2 0.1"/></geometry></visual></link>
  <joint name="held" type="fixed"><parent link="box"/><child link="bare"/></joint>
  <joint name="slide" type="prismatic"><parent link="bare"/><child link="drawer"/>
    <axis xyz="1 0 0"/><limit lower="{low}" upper="0.5" effort="1" velocity="1"/></joint>
</robot>
"""


def made(folder: Path, text: str) -> ArticulatedObject:
    path = folder / "model.urdf"
    path.write_text(text, encoding="utf-8")
    return load_model(path)


@pytest.mark.parametrize(("low", "whole"), [(0.3, 1.2), (-0.3, 1.0)])
def test_an_object_is_as_long_as_it_is_at_rest_or_its_longest_part(tmp_path: Path, low: float, whole: float) -> None:
    model = made(tmp_path, URDF.format(low=low))
    assert length_of(model) == pytest.approx(whole, rel=0.02)
    np.testing.assert_allclose(lengths_along_root(model), [whole, 0.2, 0.1], atol=1e-6)
