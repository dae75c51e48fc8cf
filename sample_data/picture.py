"""Make the README's picture again: `python -m sample_data.picture [OUT.png]`, by default docs/images/estimate.png.

Two sample scenes side by side, the open cabinet and the one behind an arm, each with what an estimate without a prior
finds in its region of interest.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from pmpnbp.inference import problem as problems
from pmpnbp.inference import run as engine
from pmpnbp.pictures.pictures import Pictures
from pmpnbp.readout.estimate import agreeing
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Settings

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "docs" / "images" / "estimate.png"
SCENES = ("open", "arm")
WIDTH = 560
# Rows of each picture that are shown, as shares of its height: floor and wall go on beyond.
TOP, BOTTOM = 0.10, 0.90
GAP = 16
# Colours of the file: as many as leave no steps in the greys.
COLOURS = 256


def estimated(folder: Path, pictures: Pictures) -> Image.Image:
    """The scene in `folder` with its estimate drawn over it."""
    settings = Settings()
    model = load_model(HERE / "cabinet" / "cabinet.urdf", triangle_budget=settings.triangles)
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    roi = np.array(json.loads((folder / "roi.json").read_text(encoding="utf-8"))["roi"])
    observation = problems.look(model, [scan], roi, settings)
    problem = problems.build(model, observation, UniformPrior("upright"), settings)
    *_, report = engine.iterate(problem, 100)
    part_poses = model.part_poses(*agreeing(problem, report))
    return Image.open(io.BytesIO(pictures.draw(scan, model, part_poses, WIDTH)))


def picture() -> Image.Image:
    """The scenes side by side, a white gap between them."""
    drawing = Pictures()
    shown = [estimated(HERE / "cabinet" / name, drawing) for name in SCENES]
    drawing.close()
    top, bottom = round(TOP * shown[0].height), round(BOTTOM * shown[0].height)
    both = Image.new("RGB", (len(shown) * (WIDTH + GAP) - GAP, bottom - top), "white")
    for place, one in enumerate(shown):
        both.paste(one.crop((0, top, WIDTH, bottom)), (place * (WIDTH + GAP), 0))
    return both.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, kmeans=4, dither=Image.Dither.NONE)


def main() -> None:
    """Write the picture."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else OUT
    out.parent.mkdir(parents=True, exist_ok=True)
    picture().save(out, optimize=True)


if __name__ == "__main__":
    main()
