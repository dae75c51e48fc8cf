"""Questions to the posterior: its draws in ArviZ (`pip install 'pmpnbp[arviz]'`). From the project's folder:

python docs/examples/draws_in_arviz.py
"""

from pathlib import Path

import arviz

import pmpnbp

SCENE = Path("sample_data/cabinet/self_occluded")
ROI = [-0.79, 0.04, -0.1, 0.24, 1.0, 0.85]

found = pmpnbp.estimate("sample_data/cabinet/cabinet.urdf", SCENE / "depth.png", camera=SCENE / "camera.json", roi=ROI)
draws = found.to_arviz()
print(arviz.summary(draws, var_names="joint_position", kind="stats", round_to=4))
# Draw i of every joint and link is of one configuration of the object: what hangs together can be asked for
slides = draws.posterior["joint_position"]
upper, hidden = slides.sel(joint="slide1"), slides.sel(joint="slide2")
print(f"the hidden drawer is open by more than 5 cm with {float((hidden > 0.05).mean()):.0%}")
print(
    f"the upper one stands out by {float((upper - hidden).mean()):.4f} m more, ± {float((upper - hidden).std()):.4f} m"
)
arviz.to_netcdf(draws, "draws.nc")
