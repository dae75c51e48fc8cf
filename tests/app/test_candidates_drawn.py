"""Are the candidates that are drawn the search's heaviest hypotheses, as whole objects, where they are?"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from app.viewer.candidates import HEAVY, LIGHT, MOST, heaviest
from app.viewer.frames import frame
from app.viewer.scene_frame import Copies, Lines
from pmpnbp.geometry import poses
from pmpnbp.inference.belief import Belief
from tests.app.scenes import only, scene, shown


def slowly(belief: Belief) -> list[tuple[int, float]]:
    """`heaviest`, island by island: the best particle of each, and the island's weight; a search that has left a
    single one is of one population."""
    islands: dict[int, list[int]] = defaultdict(list)
    for particle, island in enumerate(belief.origin.island[0].tolist()):
        islands[island].append(particle)
    if len(islands) == 1:
        return []
    weight = np.exp(belief.log_weights[0])
    found = [
        (max(members, key=lambda one: belief.log_weights[0, one]), float(weight[members].sum()))
        for _, members in sorted(islands.items())
    ]
    return sorted(found, key=lambda entry: -entry[1])[:MOST]


def searched() -> list[int]:
    return [number for number, made in enumerate(scene().snapshots) if made.report.stage == "search"]


def test_each_is_the_best_of_its_island_and_the_heaviest_islands_are_shown() -> None:
    assert any(len(slowly(scene().snapshots[number].report.belief)) > 1 for number in searched())
    for number in searched():
        belief = scene().snapshots[number].report.belief
        rows, weights = heaviest(belief)
        expected = slowly(belief)
        assert rows.tolist() == [row for row, _ in expected]
        np.testing.assert_allclose(weights, [weight for _, weight in expected], rtol=1e-12)


def test_they_are_objects_where_the_particles_have_their_parts() -> None:
    whole = scene()
    made = whole.snapshots[searched()[0]]
    belief = made.report.belief
    rows, _ = heaviest(belief)
    assert len(rows) > 1
    found = frame(made, only("candidates"), whole.stage)
    for number, shape in enumerate(whole.stage.shapes):
        assert shape is not None
        copies = shown(Copies, found, f"/candidates/{number}")
        assert copies.vertices is shape.vertices  # sent once, whatever the iteration
        np.testing.assert_allclose(copies.centres, belief.poses[number, rows, :3], atol=1e-6)
        np.testing.assert_allclose(copies.turns, belief.poses[number, rows, 3:], atol=1e-6)
        assert (np.diff(copies.opacities) <= 0).all()
        assert LIGHT <= copies.opacities[-1] <= copies.opacities[0] == np.float32(HEAVY)
        # the edges of the heaviest come first
        edges = shown(Lines, found, f"/candidates/{number}/edges").segments
        first = poses.transform_points(belief.poses[number, rows[0]], shape.edges[0].astype(np.float64))
        np.testing.assert_allclose(edges[0], first, atol=1e-5)


def test_a_belief_of_one_population_has_none() -> None:
    whole = scene()
    for number in (0, -1):  # the start, and belief propagation
        made = whole.snapshots[number]
        assert not len(heaviest(made.report.belief)[0])
        assert not frame(made, only("candidates"), whole.stage).nodes
