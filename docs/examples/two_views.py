"""What a second view tells: from the first camera the upper drawer hides the two below it. From the project's folder:

python docs/examples/two_views.py
"""

from pathlib import Path

import pmpnbp

CABINET = Path("sample_data/cabinet")
ROI = [-0.46, 0.13, -0.1, 0.55, 0.95, 0.85]

model = pmpnbp.load_model(CABINET / "cabinet.urdf")
scans = [
    pmpnbp.load_scan(CABINET / view / "depth.png", CABINET / view / "camera.json") for view in ("from_above", "lowered")
]
for views in (scans[:1], scans):
    found = pmpnbp.estimate(model, views, roi=ROI)
    seen, hidden = found.links["drawer3"].visible_fraction, found.joints["slide3"]
    low, high = hidden.interval
    print(f"{len(views)} of 2 views, {seen:.0%} of drawer3 in sight: slide3 is open by {low:.3f} to {high:.3f} m")
