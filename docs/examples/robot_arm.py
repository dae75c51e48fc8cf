"""A robot arm whose base the camera is calibrated to, to 2 cm and 2°: where are its joints? Paths are arguments:

python docs/examples/robot_arm.py arm/model.urdf arm/frame/depth.png arm/frame/camera.json
"""

import sys
from math import degrees, radians

import pmpnbp

if len(sys.argv) != 4:
    sys.exit("expected MODEL SCAN CAMERA, of an arm that stands at the origin of the world")
model, scan = pmpnbp.load_model(sys.argv[1]), pmpnbp.load_scan(sys.argv[2], sys.argv[3])
prior = {
    "kind": "gaussian",
    "link": model.links[0],  # the root
    "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
    "std_xyz": [0.02] * 3,
    "std_rpy": [radians(2)] * 3,
}
found = pmpnbp.estimate(model, scan, prior=prior, roi=[-0.75, -0.75, -0.1, 0.75, 0.75, 1.0])
print(found.verdict)
for name, joint in found.joints.items():
    print(f"{name} stands at {degrees(joint.position):.1f}° ± {degrees(joint.std):.1f}°")
for sentence in found.unknown:
    print("not told by the scan:", sentence)
