"""Does a scene frame show what the iteration and the view state say, and nothing else?"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import special_ortho_group

from app.viewer.ellipsoids import ellipsoids, radius_scale
from app.viewer.frames import BEST, frame
from app.viewer.gizmos import default_prior
from app.viewer.scan_points import fits
from app.viewer.scene_frame import Axes, Ellipsoids, Frustum, Label, Lines, Points, SceneFrame, Surface
from app.viewer.view_state import LAYERS, ViewState
from pmpnbp.geometry import poses
from pmpnbp.pictures.palette import PART_COLOURS, rgb
from pmpnbp.potentials.pixel_kinds import PixelKind
from pmpnbp.readout.view_planning import FIELD
from pmpnbp.scene.observation import SUPPORT
from tests.app.scenes import as_told, drawn, estimated, heavy, of_a_part, only, scene, shown, views

NAMES = ("frame", "drawer1", "drawer2", "drawer3")


def tops(found: SceneFrame) -> set[str]:
    return {node.name.split("/")[1] for node in found.nodes}


def test_each_layer_draws_its_own() -> None:
    assert tops(drawn(only())) == set()
    alone = {
        "scan": {"scan"},
        "camera": {"camera"},
        "image": set(),
        "particles": {"particles"},
        "axes": {"axes"},
        "estimate": {"estimate"},
        "ellipsoids": {"ellipsoids"},
        "draws": {"draws"},
        "candidates": set(),  # none after the search
        "next_views": set(),  # it is told which ones
        "particle_ellipsoids": {"particle_ellipsoids"},
        "truth": {"truth"},
        "frames": {"frames"},
        "ruler": {"ruler"},
        "planes": {"planes"},
        "region": {"region"},
        "prior": {"prior"},
        "messages": {"messages"},
    }
    assert set(alone) == set(LAYERS)
    model = scene().stage.model
    chosen = {
        "part": "drawer1",
        "edge": ["frame", "drawer2"],
        "region": [-1, -1, 0, 1, 1, 1],
        "prior": default_prior(model, scene().snapshots[-1].result["links"], None),
    }
    for layer, expected in alone.items():
        assert tops(drawn(only(layer, **chosen))) == expected, layer
    assert tops(drawn(ViewState())) == {"scan", "camera", "particles", "estimate", "ellipsoids", "draws", "ruler"}
    # the iteration before has no posterior, of which these tell
    assert tops(drawn(only("ellipsoids", "draws", "particle_ellipsoids"), -2)) == {"particle_ellipsoids"}


def test_what_is_not_there_is_not_drawn() -> None:
    newest = scene().snapshots[-1]
    untold = replace(newest, criteria=replace(newest.criteria, truth=None))
    assert tops(frame(untold, only("truth"), scene().stage)) == set()
    assert tops(drawn(only("axes", "messages", "prior", "region"))) == set()
    assert tops(drawn(only("messages", edge=["frame", "drawer2"]), 0)) == set()  # the start sends none


def test_the_same_state_gives_the_same_frame_and_changes_nothing() -> None:
    whole, state = scene(), only(*LAYERS, part="drawer2", particle=3, edge=["frame", "drawer2"])
    before = arrays(whole.snapshots[-1].report)
    one, other = frame(whole.snapshots[-1], state, whole.stage), frame(whole.snapshots[-1], state, whole.stage)
    assert [node.name for node in one.nodes] == [node.name for node in other.nodes]
    for a, b in zip(arrays(one.nodes), arrays(other.nodes), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(before, arrays(whole.snapshots[-1].report), strict=True):
        np.testing.assert_array_equal(a, b)


def arrays(value: Any) -> list[np.ndarray]:
    """Copies of all arrays in a value."""
    if isinstance(value, np.ndarray):
        return [value.copy()]
    if is_dataclass(value):
        return [array for entry in fields(value) for array in arrays(getattr(value, entry.name))]
    return [array for one in value for array in arrays(one)] if isinstance(value, tuple | list) else []


def test_what_does_not_change_is_the_same_object() -> None:
    one, other = drawn(ViewState(), 1), drawn(ViewState(), 5)
    for name in ("/scan/0/object", "/scan/0/around"):
        assert shown(Points, one, name).points is shown(Points, other, name).points
        assert shown(Points, one, name).colours is shown(Points, other, name).colours
    for number in range(4):
        first, second = (shown(Surface, found, f"/estimate/{number}") for found in (one, other))
        assert first.vertices is second.vertices and first.faces is second.faces
        assert not np.array_equal(first.pose, second.pose)


def test_particles_are_where_the_belief_has_them() -> None:
    whole, found = scene(), drawn(only("particles"))
    belief = whole.snapshots[-1].report.belief
    assert found.iteration == 5 and found.particles == {name: len(heavy(number)) for number, name in enumerate(NAMES)}
    for number, colour in enumerate(PART_COLOURS[:4]):
        clouds = of_a_part(found, number)
        assert all(cloud.points.dtype == np.float32 and cloud.exact for cloud in clouds)
        assert all(tuple(cloud.colours) == rgb(colour) for cloud in clouds)
        places = np.concatenate([cloud.points for cloud in clouds])
        expected = belief.poses[number, heavy(number), :3]
        np.testing.assert_allclose(sorted(places.tolist()), sorted(expected.tolist()), atol=1e-6)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_lighter_particles_are_paler(theme: str) -> None:
    belief = scene().snapshots[-1].report.belief
    clouds = of_a_part(drawn(only("particles", colour_particles="weight", theme=theme)), 1)
    ground = np.array([243, 244, 246] if theme == "light" else [20, 24, 31])
    colour_at = {tuple(p): c for cloud in clouds for p, c in zip(cloud.points.tolist(), cloud.colours, strict=True)}
    places = belief.poses[1, :, :3].astype(np.float32).tolist()
    order = heavy(1)[np.argsort(belief.log_weights[1, heavy(1)])]
    distance = {n: np.linalg.norm(colour_at[tuple(places[n])].astype(float) - ground) for n in order}
    assert (np.diff([distance[n] for n in order]) > -3).all()  # but for rounding to eight bits
    assert distance[order[-1]] > 2 * distance[order[0]] > 0


def test_the_estimate_is_where_the_result_has_it() -> None:
    whole, found = scene(), drawn(only("estimate", part="drawer2"))
    for number, name in enumerate(NAMES):
        pose = whole.snapshots[-1].result["links"][name]["pose"]
        surface = shown(Surface, found, f"/estimate/{number}")
        np.testing.assert_allclose(surface.pose[:3], [pose["position"][axis] for axis in "xyz"])
        np.testing.assert_allclose(as_told(surface.pose)[3:], [pose["orientation"][axis] for axis in "wxyz"])
        assert 0 < surface.opacity < 1
        assert (surface.colour == rgb(PART_COLOURS[number])) == (name == "drawer2")
    widths = [shown(Lines, found, f"/estimate/{number}/edges").width for number in range(4)]
    assert widths[2] > widths[0] == widths[1] == widths[3]


def test_next_views_are_numbered_cameras_and_one_stands_out() -> None:
    whole = scene()
    for chosen, state in ((0, only("next_views")), (2, only("next_views", next_view=2))):
        found = frame(whole.snapshots[-1], state, whole.stage, next_views=views())
        cameras = [shown(Frustum, found, f"/next_views/{place}") for place in range(3)]
        ranks = [shown(Label, found, f"/next_views/{place}/rank") for place in range(3)]
        assert [rank.text for rank in ranks] == ["1", "2", "3"] and len(found.nodes) == 6
        for camera, view in zip(cameras, views(), strict=True):
            np.testing.assert_array_equal(camera.pose, view.pose)
            # as wide and as high as the images that views are told apart in
            assert 2 * np.arctan(np.tan(camera.field_of_view / 2) * camera.aspect) == pytest.approx(FIELD)
        others = [place for place in range(3) if place != chosen]
        assert all(cameras[chosen].size > cameras[place].size for place in others)
        assert all(cameras[chosen].colour != cameras[place].colour for place in others)
        assert all(ranks[chosen].size > ranks[place].size for place in others)


def test_a_drawn_shape_is_the_parts_mesh() -> None:
    for part, shape in zip(scene().stage.model.parts, scene().stage.shapes, strict=True):
        assert shape is not None
        np.testing.assert_allclose(shape.vertices.min(axis=0), part.mesh.vertices.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(shape.vertices.max(axis=0), part.mesh.vertices.max(axis=0), atol=1e-6)
        assert len(shape.faces) == len(part.mesh.faces)
        # boxes and cylinders: an edge of a box is a line, one along a cylinder's round is not
        assert 12 <= len(shape.edges) < len(part.mesh.faces)


@pytest.mark.parametrize("confidence", [0.3, 0.75, 0.95])
def test_an_ellipsoid_holds_the_share_it_says(confidence: float) -> None:
    rng = np.random.default_rng(5)
    roots = rng.standard_normal((4, 3, 3)) * [1.0, 0.1, 0.01]
    covariances = roots @ np.swapaxes(roots, 1, 2)
    turns, radii = ellipsoids(covariances, confidence)
    for covariance, turn, radius in zip(covariances, turns, radii, strict=True):
        samples = rng.multivariate_normal(np.zeros(3), covariance, 20_000)
        inside = np.linalg.norm(poses.rotate(turn * [1, -1, -1, -1], samples) / radius, axis=1) <= 1
        # five standard deviations of a share of 20,000 samples
        assert abs(inside.mean() - confidence) < 5 * np.sqrt(confidence * (1 - confidence) / 20_000)


def test_an_ellipsoids_axes_are_those_of_its_covariance() -> None:
    turn = special_ortho_group.rvs(3, random_state=3)
    std = np.array([0.01, 0.02, 0.05])
    turns, radii = ellipsoids((turn @ np.diag(std**2) @ turn.T)[None], 0.75)
    np.testing.assert_allclose(radii[0], 2.0271 * std, rtol=1e-3)
    assert radius_scale(0.75) == pytest.approx(2.0271, rel=1e-4)  # of a table of the chi-square distribution
    found = np.stack([poses.rotate(turns[0], axis) for axis in np.eye(3)], axis=1)
    np.testing.assert_allclose(np.abs(found.T @ turn), np.eye(3), atol=1e-9)
    assert np.linalg.det(found) == pytest.approx(1)


def test_ellipsoids_are_one_batch_about_the_estimate() -> None:
    whole = scene()
    near, far = (shown(Ellipsoids, drawn(only("ellipsoids", confidence=c)), "/ellipsoids") for c in (0.5, 0.95))
    np.testing.assert_allclose(near.centres, estimated(whole.snapshots[-1])[:, :3], atol=1e-6)
    np.testing.assert_allclose(far.radii / near.radii, radius_scale(0.95) / radius_scale(0.5), rtol=1e-4)
    assert [tuple(colour) for colour in near.colours] == [rgb(colour) for colour in PART_COLOURS[:4]]
    spread = whole.snapshots[-1].placed.spread
    assert spread is not None
    first = [whole.stage.model.links.index(part.links[0]) for part in whole.stage.model.parts]
    expected = ellipsoids(spread.covariances[first, :3, :3], 0.5)[1]
    np.testing.assert_allclose(near.radii, expected, rtol=1e-5)
    flat, radii = ellipsoids(np.zeros((2, 3, 3)), 0.75)
    assert np.isfinite(flat).all() and (radii > 0).all()


def test_draws_are_outlines_of_uncertain_parts_where_the_posterior_has_them() -> None:
    """With a limit that nothing is within, of all parts; with one that all are within, of none."""
    whole = scene()
    newest = whole.snapshots[-1]
    unsure, sure = (
        frame(replace(newest, criteria=replace(newest.criteria, max_std=limit)), only("draws"), whole.stage)
        for limit in (1e-9, 10.0)
    )
    assert not [node for node in sure.nodes if node.name.startswith("/draws")] or newest.placed.posterior.told is False
    posterior = newest.placed.posterior
    assert posterior is not None
    poses_of = whole.stage.model.part_poses(posterior.drawn_roots, posterior.drawn_joints)
    lines = [node for node in unsure.nodes if node.name.startswith("/draws/2/")]
    assert len(lines) == 8
    for line in lines:
        assert isinstance(line, Lines)
        assert np.abs(poses_of[:, 2] - line.pose).sum(axis=1).min() < 1e-12


def test_the_axes_are_the_heaviest_particles() -> None:
    belief = scene().snapshots[-1].report.belief
    found = shown(Axes, drawn(only("axes", part="drawer2")), "/axes")
    assert found.poses.shape == (BEST, 7)
    heaviest = np.sort(belief.log_weights[2])[::-1][:BEST]
    for pose, weight in zip(found.poses, heaviest, strict=True):
        assert belief.log_weights[2][np.all(belief.poses[2] == pose, axis=1)].max() == weight


def test_the_truth_is_where_the_links_really_are() -> None:
    whole, found = scene(), drawn(only("truth"))
    truth = whole.snapshots[-1].criteria.truth
    assert truth is not None
    for number, name in enumerate(NAMES):
        lines = shown(Lines, found, f"/truth/{number}")
        np.testing.assert_allclose(
            poses.transform_points(lines.pose, lines.segments.astype(float)),
            poses.transform_points(truth["links"][name], whole.stage.shapes[number].edges.astype(float)),  # type: ignore[union-attr]
            atol=1e-6,
        )


def test_points_are_told_apart_by_how_the_estimate_fits_them() -> None:
    whole = scene()
    made, cloud = whole.snapshots[-1], whole.stage.scans[0]
    truth = made.criteria.truth
    assert truth is not None
    right = np.stack([truth["links"][name] for name in NAMES])
    towards = poses.rotate(cloud.camera.pose_world_camera[3:], np.array([0.0, 0.0, -0.1]))
    nearer, farther = (right + np.concatenate([sign * towards, np.zeros(4)]) for sign in (1, -1))

    def kinds(part_poses: Any) -> Any:
        return fits(cloud, whole.stage.categories[0], made.problem.surfaces, part_poses, 0.012)

    def shares(part_poses: Any) -> dict[int, float]:
        found = kinds(part_poses)
        covered = found[found != PixelKind.NOT_COVERED]
        assert 0.02 < len(covered) / len(found) < 0.6
        return {kind: float((covered == kind).mean()) for kind in PixelKind}

    assert shares(right)[PixelKind.EXPLAINED] > 0.8  # the rest are edges, and noise
    # a surface before the measured one is seen through; one behind it is hidden by it
    assert shares(nearer)[PixelKind.SEEN_THROUGH] > 0.8
    assert shares(farther)[PixelKind.IN_FRONT] > 0.8
    # where it is sunk into the floor it is not hidden by something: the score takes that for free space violated
    sunk = right + np.array([0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
    floor = kinds(sunk)[(whole.stage.categories[0] == SUPPORT) & (kinds(sunk) != PixelKind.NOT_COVERED)]
    assert len(floor) > 100 and (floor == PixelKind.SEEN_THROUGH).mean() > 0.95


def test_the_scene_and_the_potentials_tell_points_of_the_floor_apart_alike() -> None:
    """The scan's points are finer than the working image, by one rule."""
    whole = scene()
    category, view = whole.stage.categories[0], whole.snapshots[-1].problem.observation.views[0]
    points = whole.stage.scans[0].points.astype(float)
    seen = view.camera.project(poses.transform_points(poses.inverse(view.camera.pose_world_camera), points))
    column, row = np.round(seen[:, :2]).astype(int).T
    inside = (row >= 0) & (row < view.camera.height) & (column >= 0) & (column < view.camera.width)
    same = category[inside] == view.category[row[inside], column[inside]]
    assert np.count_nonzero(inside) > 10_000 and same.mean() > 0.97


def test_a_scans_points_are_where_its_pixels_are() -> None:
    whole = scene()
    found, camera, depth = drawn(only("scan")), whole.scan.camera, whole.scan.depth
    points = np.concatenate([shown(Points, found, f"/scan/0/{which}").points for which in ("object", "around")])
    assert len(points) == whole.stage.scans[0].measured.sum() > 50_000
    seen = camera.project(poses.transform_points(poses.inverse(camera.pose_world_camera), points.astype(float)))
    columns, rows = seen[:, 0].round().astype(int), seen[:, 1].round().astype(int)
    np.testing.assert_allclose(seen[:, :2], np.stack([columns, rows], axis=1), atol=2e-3)
    np.testing.assert_allclose(depth[rows, columns], seen[:, 2], atol=1e-5)


def test_economy_may_leave_out_points_around_the_object_only() -> None:
    whole, sparing = (drawn(only("scan", economy=economy)) for economy in (False, True))
    for name, shape in (("object", "circle"), ("around", "square")):
        every, some = (shown(Points, found, f"/scan/0/{name}") for found in (whole, sparing))
        assert (every.shape, some.shape) == ("circle", shape)
        np.testing.assert_array_equal(some.points, every.points)


def test_the_first_points_around_the_object_are_spread_over_all() -> None:
    """One of each block of pixels: where there are any, there is one of the first nearby, and few twice."""
    whole = scene()
    points = shown(Points, drawn(only("scan")), "/scan/0/around").points.astype(float)
    first = points[: len(points) // 6]
    camera = whole.scan.camera
    pixels = [
        camera.project(poses.transform_points(poses.inverse(camera.pose_world_camera), some))[:, :2].round()
        for some in (points, first)
    ]
    step = np.array([3, 2]) * camera.width / whole.stage.scans[0].camera.width
    every, of_first = ({tuple(block) for block in (found // step).astype(int)} for found in pixels)
    assert len(of_first) > 0.9 * len(first) and len(of_first) > 0.8 * len(every)


def test_the_frustum_is_the_scans_camera() -> None:
    found, camera = shown(Frustum, drawn(only("camera")), "/camera/0"), scene().scan.camera
    np.testing.assert_array_equal(found.pose, camera.pose_world_camera)
    assert found.field_of_view == pytest.approx(2 * np.arctan(240 / 525), rel=1e-6)
    assert found.aspect == pytest.approx(4 / 3) and found.image is None
    assert shown(Frustum, drawn(only("camera", "image")), "/camera/0").image is not None


def test_the_messages_of_an_edge_are_both_drawn_and_told_apart() -> None:
    found = drawn(only("messages", edge=["drawer2", "frame"]))
    messages = scene().snapshots[-1].report.messages
    assert messages is not None
    assert {node.name.rsplit("/", 1)[0] for node in found.nodes} == {"/messages/0-2", "/messages/2-0"}
    colours = []
    for number, (sender, receiver) in enumerate(zip(messages.sender, messages.receiver, strict=True)):
        if {sender, receiver} == {0, 2}:
            places = messages.poses[number, :, :3].astype(np.float32)
            clouds = [shown(Points, found, f"/messages/{sender}-{receiver}/{size}") for size in range(3)]
            drawn_ones = {tuple(point) for cloud in clouds for point in cloud.points.tolist()}
            assert drawn_ones <= {tuple(place) for place in places.tolist()}
            heaviest = places[messages.log_weights[number].argmax()].tolist()
            colours.append(tuple(clouds[0].colours[clouds[0].points.tolist().index(heaviest)]))
    assert set(colours) == {rgb(PART_COLOURS[0]), rgb(PART_COLOURS[2])}


def test_the_selected_particle_is_marked() -> None:
    found = drawn(only(part="drawer3", particle=17))
    pose = scene().snapshots[-1].report.belief.poses[3, 17]
    np.testing.assert_allclose(shown(Ellipsoids, found, "/selected/mark").centres[0], pose[:3], atol=1e-6)
    np.testing.assert_array_equal(shown(Lines, found, "/selected/edges").pose, pose)
    assert tops(drawn(only(part="drawer3", particle=40))) == set()  # there are 40


def test_another_iteration_lies_over_it_in_grey() -> None:
    whole = scene()
    other = whole.snapshots[3].read_out()
    found = frame(whole.snapshots[-1], only("estimate", "ellipsoids"), whole.stage, compared=(other, whole.stage))
    for number, pose in enumerate(estimated(other)):
        ghost, own = (shown(Surface, found, f"/{name}/{number}") for name in ("compare", "estimate"))
        np.testing.assert_array_equal(as_told(ghost.pose), pose)
        assert ghost.opacity < own.opacity and max(ghost.colour) - min(ghost.colour) < 32
    assert shown(Ellipsoids, found, "/compare/ellipsoids").radii.shape == (4, 3)


def test_support_planes_are_drawn_where_they_are() -> None:
    planes = scene().snapshots[-1].problem.observation.planes
    found = drawn(only("planes"))
    assert len(planes) >= 1
    for number, plane in enumerate(planes):
        corners = shown(Surface, found, f"/planes/{number}").vertices
        np.testing.assert_allclose(corners @ plane[:3] + plane[3], 0, atol=1e-5)
        assert np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[1])) > 0.5


def test_the_view_begins_behind_and_above_the_camera() -> None:
    whole = scene()
    eye, camera = whole.stage.eye, whole.scan.camera.pose_world_camera
    target = np.array(eye.look_at)
    assert np.linalg.norm(np.array(eye.position) - target) > 1.2 * np.linalg.norm(camera[:3] - target)
    assert eye.position[2] > camera[2] and eye.up == (0, 0, 1)
    ahead = poses.rotate(camera[3:], np.array([0.0, 0.0, 1.0]))
    sight = target - np.array(eye.position)
    assert ahead @ sight / np.linalg.norm(sight) > 0.85
