"""A prior of one's own: a mobile robot knows from its map where the cabinet stands, to 5 cm and 5°, and that the upper
drawer was left open. From the project's folder:

python docs/examples/known_base.py
"""

from math import cos, radians, sin
from pathlib import Path

import pmpnbp

SCENE = Path("sample_data/cabinet/open")


def standing_at(x, y, yaw):
    """A prior for an object whose root link stands on the floor there, metres and radians in world."""
    turn = {"x": 0, "y": 0, "z": sin(yaw / 2), "w": cos(yaw / 2)}
    return {
        "kind": "gaussian",
        "link": "frame",
        "pose": {"position": {"x": x, "y": y, "z": 0}, "orientation": turn},
        "std_xyz": [0.05, 0.05, 0.01],
        "std_rpy": [radians(1), radians(1), radians(5)],
        "joints": {"slide1": {"position": 0.2, "std": 0.1}},  # the other joints start anywhere in their range
    }


scan = pmpnbp.load_scan(SCENE / "depth.png", SCENE / "camera.json")
found = pmpnbp.estimate("sample_data/cabinet/cabinet.urdf", scan, prior=standing_at(0.33, 0.17, radians(24)))
print(found.verdict)
print("the cabinet stands at", found.links["frame"].pose[:3].round(4), "±", found.links["frame"].std_xyz.round(4), "m")
print(f"slide1 is open by {found.joints['slide1'].position:.4f} m, after {found.iteration} iterations")
