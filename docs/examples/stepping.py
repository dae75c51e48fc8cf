"""A belief that forms, iteration by iteration, and a setting that is changed on the way. From the project's folder:

python docs/examples/stepping.py
"""

from pathlib import Path

import pmpnbp

SCENE = Path("sample_data/cabinet/open")
ROI = [-0.08, -0.19, -0.1, 0.89, 0.7, 0.85]


def tell(iteration):
    """What the algorithm does; what is believed is the estimate's to say."""
    count, slide = iteration.effective_sample_size["drawer1"], iteration.joints["slide1"][0]
    print(f"{iteration.number:2} {iteration.stage}: slide1 at {slide:.3f} m, where {count:.0f} particles count")


with pmpnbp.Session(
    "sample_data/cabinet/cabinet.urdf",
    SCENE / "depth.png",
    camera=SCENE / "camera.json",
    roi=ROI,
    recording="steps.sqlite",  # what `pmpnbp view` and `pmpnbp.open_recording` show
) as session:
    for iteration in session:  # until it is at rest
        tell(iteration)
    session.change(effective_share=0.5)  # half of the particles shall count, from the next iteration on
    for _ in range(3):
        tell(session.step())
    print(session.estimate().verdict)
