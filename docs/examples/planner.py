"""A planner that looks until it may act, on a drawer that another one hides. From the project's folder, by a server:

python docs/examples/planner.py http://127.0.0.1:8080
"""

import sys
from pathlib import Path

import pmpnbp

CABINET = Path("sample_data/cabinet")
DRAWER, MAX_STD = "drawer3", 0.004  # metres, to which its place must be known
# Where the camera can go: x y z qw qx qy qz, metres, optical frame in world. What it sees there was rendered before.
PLACES = {
    "from_above": [0.9269, 0.8942, 1.75, -0.174, 0.5391, 0.7825, -0.2582],
    "lowered": [0.9269, 0.8942, 1.3, -0.2243, 0.5196, 0.7542, -0.333],
}


def look(place):
    """Take a scan there and send it to the server."""
    return server.upload_scan(CABINET / place / "depth.png", camera=CABINET / place / "camera.json")


with pmpnbp.Client(sys.argv[1]) as server:
    known = CABINET / "from_above" / "prior.json"  # roughly where the cabinet stands
    session = server.session(CABINET / "cabinet.urdf", look("from_above"), prior=known)
    for _ in range(5):  # so many looks at most
        session.run(until="converged")
        session.wait()
        decision = session.decision(DRAWER, MAX_STD, views=PLACES.values())
        if decision.action != "look":
            break
        best = decision.views[0]
        place = min(PLACES, key=lambda name: abs(best.pose - PLACES[name]).sum())
        print(f"{decision.reason}; looking {place}, where {best.gain:.1f} nats are to be learnt")
        session.add_scan(look(place))
    print(f"{decision.action}: {decision.reason}")
    if decision.action == "act":
        print("pull the drawer at", session.estimate().links[DRAWER].pose.round(3))
