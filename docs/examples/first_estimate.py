"""Where are a cabinet's drawers, and how sure can one be? From the project's folder:

python docs/examples/first_estimate.py
"""

from pathlib import Path

import pmpnbp

SCENE = Path("sample_data/cabinet/open")

found = pmpnbp.estimate(
    "sample_data/cabinet/cabinet.urdf",
    SCENE / "depth.png",
    camera=SCENE / "camera.json",
    roi=[-0.08, -0.19, -0.1, 0.89, 0.7, 0.85],  # two corners of a box that holds the cabinet, metres in world
)
print(found.verdict)
for name, joint in found.joints.items():
    low, high = joint.interval
    print(f"{name} is open by {joint.position:.4f} m, and with 90 % from {low:.4f} to {high:.4f} m")
x, y, z = found.links["handle1"].pose[:3]
print(f"the upper drawer's handle is on the link at x = {x:.3f}, y = {y:.3f}, z = {z:.3f} m in {found.frame_id}")
Path("estimate.png").write_bytes(found.picture())
