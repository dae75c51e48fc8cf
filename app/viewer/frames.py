"""What does a view show of an iteration? A pure function: iteration and view state in, scene frame out.

Live view, replay and export are this one path: live is replay of the newest iteration. Particles and ellipsoids stand
where the part's frame is, as everywhere in REST, which need not be its middle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from app.viewer import scan_points
from app.viewer.candidates import candidates
from app.viewer.coordinates import coordinates
from app.viewer.ellipsoids import ellipsoid, ellipsoids
from app.viewer.emphasis import FADED, INK, QUIET, faded, mixed, paled
from app.viewer.gizmos import ACCENT, gizmos
from app.viewer.particles import particles, weighs
from app.viewer.scan_points import ScanPoints
from app.viewer.scene_frame import (
    Axes,
    Ellipsoids,
    Frustum,
    Label,
    Lines,
    Node,
    Points,
    PointShape,
    SceneFrame,
    Surface,
    Targets,
)
from app.viewer.stage import Stage
from app.viewer.view_state import Theme, ViewState
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import Belief, Messages
from pmpnbp.pictures import palette
from pmpnbp.pictures.palette import Colour
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.readout.view_planning import FIELD, HEIGHT, WIDTH, PlannedView

# Particles whose orientation is drawn.
BEST = 24
# Sizes as shares of the object's.
POINT, MESSAGE_POINT, AXIS, FRUSTUM, MARK = 0.006, 0.010, 0.06, 0.10, 0.008
# Of a scan's points, as a share of the space between two: of the object, where the estimate shows between them, and
# around it.
SPACED = 0.55, 1.1
# How opaque: the estimate lets its particles shine through, where there are some.
ESTIMATE, WITH_PARTICLES, FAINT, GHOST, SUPPORT, ELLIPSOID = 0.94, 0.74, 0.12, 0.22, 0.30, 0.6
# Draws of the posterior whose outlines are drawn, and how far towards the background: of parts that are faded farther.
DRAWS, PALE_DRAW, PALER_DRAW = 8, 0.45, 0.8
# How large a next view is that is not the emphasised one.
OTHER_VIEW = 0.6
# How much larger its rank is.
EMPHASIS = 1.5


def frame(
    snapshot: Snapshot,
    state: ViewState,
    stage: Stage,
    *,
    compared: tuple[Snapshot, Stage] | None = None,
    next_views: Sequence[PlannedView] = (),
) -> SceneFrame:
    """The scene of iteration `snapshot`.

    stage : of the iteration's object and scans; compared : another iteration to lay over it, with its stage
    next_views : where to look from next, best first
    """
    show, theme = state.show, state.theme
    part_poses = snapshot.placed.part_poses
    names = [part.name for part in stage.model.parts]
    nodes: list[Node] = []
    if show.scan:
        nodes += _scans(snapshot, state, stage, part_poses)
    if show.camera:
        nodes += [_frustum(f"/camera/{n}", cloud, stage, state) for n, cloud in enumerate(stage.scans)]
    if show.estimate:
        # the categories' colours are to be seen then, not the parts'
        solid = WITH_PARTICLES if show.particles else ESTIMATE
        opacity = FAINT if show.scan and state.colour_scan == "explained" else solid
        nodes += _posed("/estimate", stage, part_poses, colours(stage, theme), opacity, state, faded(stage, state))
    placed = snapshot.placed
    if show.ellipsoids and placed.spread is not None:
        nodes.append(_ellipsoids("/ellipsoids", placed.spread.covariances, stage, part_poses, state))
    if show.particle_ellipsoids:
        nodes.append(_ellipsoids("/particle_ellipsoids", placed.particle_covariances, stage, part_poses, state))
    if show.draws:
        nodes += _draws(snapshot, stage, state)
    if show.next_views:
        nodes += _next_views(next_views, stage, state)
    if show.particles:
        nodes += _particles(snapshot.report.belief, stage, state)
    if show.candidates:
        both = zip(colours(stage, theme), faded(stage, state), strict=True)
        painted = tuple(paled(colour, theme) if other else colour for colour, other in both)
        lines = tuple(paled(colour, theme, PALE_DRAW) for colour in painted)
        nodes += candidates(snapshot.report.belief, stage, painted, lines)
    if show.axes and state.part in names:
        belief, node = snapshot.report.belief, names.index(state.part)
        heaviest = np.argsort(-belief.log_weights[node], kind="stable")[:BEST]
        nodes.append(Axes("/axes", belief.poses[node][heaviest], AXIS * stage.size))
    if show.truth and snapshot.criteria.truth is not None:
        nodes += _truth(snapshot.criteria.truth["links"], stage, state)
    if show.planes:
        nodes += _planes(stage, state)
    if show.messages and state.edge is not None and snapshot.report.messages is not None:
        nodes += _messages(snapshot.report.messages, stage, state)
    nodes += _selected(snapshot.report.belief, stage, state)
    if compared is not None:
        nodes += _compared(*compared, state)
    nodes += gizmos(stage, state)
    nodes += coordinates(stage, state, part_poses)
    belief = snapshot.report.belief
    drawn = weighs(belief.log_weights)
    counts = dict(zip(names, drawn.sum(axis=1).tolist(), strict=True)) if show.particles else {}
    corners = tuple(np.zeros((0, 3, 3), np.float32) if shape is None else shape.corners for shape in stage.shapes)
    # what is not drawn is nowhere
    places = np.where(drawn[..., None], belief.poses[..., :3], np.nan)
    targets = Targets(tuple(names), places, part_poses, corners, show.particles, show.estimate)
    return SceneFrame(snapshot.iteration, tuple(nodes), counts, targets)


def colours(stage: Stage, theme: Theme) -> tuple[Colour, ...]:
    """Each part's colour."""
    return palette.part_colours(len(stage.model.parts), dark=theme == "dark")


def _scans(snapshot: Snapshot, state: ViewState, stage: Stage, part_poses: Array) -> Iterator[Points]:
    for number, (scan, category, clouds) in enumerate(zip(stage.scans, stage.categories, stage.clouds, strict=True)):
        explained = None
        if state.colour_scan == "explained":
            fit = scan_points.fits(
                scan, category, snapshot.problem.surfaces, part_poses, snapshot.problem.tolerance_end
            )
            explained = scan_points.explained_colours(scan, state.theme, fit)
        for name, cloud, size in zip(("object", "around"), clouds, SPACED, strict=True):
            painted = (cloud.depth_colours if state.colour_scan == "depth" else cloud.plain_colours)[state.theme]
            if explained is not None:
                painted = explained[cloud.which]
            # where little is to be drawn, squares are those points of which the browser may leave some out
            shape: PointShape = "square" if state.economy and name == "around" else "circle"
            yield Points(f"/scan/{number}/{name}", cloud.points, painted, size * scan.spacing, shape, exact=False)


def _frustum(name: str, cloud: ScanPoints, stage: Stage, state: ViewState) -> Frustum:
    camera = cloud.camera
    image = cloud.images[state.theme] if state.show.image else None
    field_of_view = 2 * float(np.arctan2(camera.height / 2, camera.fy))
    aspect = (camera.width / camera.fx) / (camera.height / camera.fy)
    return Frustum(
        name, camera.pose_world_camera, field_of_view, aspect, FRUSTUM * stage.size, QUIET[state.theme], image
    )


def _posed(
    name: str,
    stage: Stage,
    part_poses: Array,
    painted: tuple[Colour, ...],
    opacity: float,
    state: ViewState,
    pale: tuple[bool, ...],
) -> Iterator[Node]:
    """The parts' surfaces, and lines along their edges. pale : which of them are faded"""
    for number, shape in enumerate(stage.shapes):
        if shape is None:
            continue
        colour, part_opacity = painted[number], opacity * (FADED if pale[number] else 1.0)
        chosen = stage.model.parts[number].name == state.part
        line = mixed(colour, INK[state.theme], 0.35)
        if pale[number]:
            colour, line = paled(colour, state.theme), paled(line, state.theme)
        yield Surface(f"{name}/{number}", shape.vertices, shape.faces, part_poses[number], colour, part_opacity)
        yield Lines(f"{name}/{number}/edges", shape.edges, line, 2.5 if chosen else 1.25)


def _ellipsoids(
    name: str,
    covariances: Array,
    stage: Stage,
    part_poses: Array,
    state: ViewState,
    painted: tuple[Colour, ...] | None = None,
) -> Ellipsoids:
    """covariances : (L, 6, 6) of the links; painted : each part's colour, its own where none is given"""
    # a part's frame is that of its first link
    rows = [stage.model.links.index(part.links[0]) for part in stage.model.parts]
    turns, radii = ellipsoids(covariances[rows, :3, :3], state.confidence)
    painted = colours(stage, state.theme) if painted is None else painted
    # the larger an ellipsoid, the more is behind it that is to be seen
    opacities = np.clip(0.1 * ELLIPSOID * stage.size / radii.max(axis=1), FAINT, ELLIPSOID)
    opacities = np.where(faded(stage, state), FADED * opacities, opacities)
    return Ellipsoids(
        name,
        part_poses[:, :3].astype(np.float32),
        turns.astype(np.float32),
        radii.astype(np.float32),
        np.array(painted, dtype=np.uint8),
        opacities.astype(np.float32),
    )


def _draws(snapshot: Snapshot, stage: Stage, state: ViewState) -> Iterator[Lines]:
    """Outlines of parts that are not certain, where draws of the posterior have them."""
    posterior = snapshot.placed.posterior
    if posterior is None:
        return
    certain = snapshot.placed.certain(snapshot.criteria.max_std)
    chosen = posterior.even_draws(DRAWS)
    drawn = posterior.part_poses(stage.model, chosen)
    kinds = zip(stage.model.parts, stage.shapes, colours(stage, state.theme), faded(stage, state), strict=True)
    for number, (part, shape, colour, other) in enumerate(kinds):
        if shape is None or all(certain[stage.model.links.index(link)] for link in part.links):
            continue
        pale = paled(colour, state.theme, PALER_DRAW if other else PALE_DRAW)
        for place, pose in enumerate(drawn[:, number]):
            yield Lines(f"/draws/{number}/{place}", shape.edges, pale, 1.0, pose)


def _next_views(views: Sequence[PlannedView], stage: Stage, state: ViewState) -> Iterator[Node]:
    """Cameras, each with its rank; one of them larger and in a colour."""
    field_of_view = 2 * float(np.arctan(np.tan(FIELD / 2) * HEIGHT / WIDTH))
    for place, view in enumerate(views):
        chosen = place == (state.next_view or 0)
        name, size = f"/next_views/{place}", FRUSTUM * stage.size * (1.0 if chosen else OTHER_VIEW)
        colour = ACCENT[state.theme] if chosen else QUIET[state.theme]
        yield Frustum(name, view.pose, field_of_view, WIDTH / HEIGHT, size, colour, None)
        yield Label(f"{name}/rank", f"{place + 1}", EMPHASIS if chosen else 1.0)


def _particles(belief: Belief, stage: Stage, state: ViewState) -> Iterator[Points]:
    pale, by_weight, size = faded(stage, state), state.colour_particles == "weight", POINT * stage.size
    for number, colour in enumerate(colours(stage, state.theme)):
        placed, weights = belief.poses[number], belief.log_weights[number]
        name = f"/particles/{number}"
        yield from particles(name, placed, weights, colour, size, state, by_weight=by_weight, faded=pale[number])


def _truth(truth: Mapping[str, Array], stage: Stage, state: ViewState) -> Iterator[Node]:
    for number, (part, shape) in enumerate(zip(stage.model.parts, stage.shapes, strict=True)):
        known = next((link for link in part.links if link in truth), None)
        if known is None or shape is None:
            continue
        pose = poses.multiply(truth[known], poses.inverse(part.poses_part_link[part.links.index(known)]))
        yield Lines(f"/truth/{number}", shape.edges, INK[state.theme], 1.75, pose)


def _planes(stage: Stage, state: ViewState) -> Iterator[Node]:
    faces, colour = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), QUIET[state.theme]
    for number, square in enumerate(stage.planes):
        yield Surface(f"/planes/{number}", square, faces, poses.IDENTITY, colour, SUPPORT, both_sides=True)
        sides = np.stack([square, np.roll(square, -1, axis=0)], axis=1)
        yield Lines(f"/planes/{number}/edges", sides, colour, 1.25)


def _messages(messages: Messages, stage: Stage, state: ViewState) -> Iterator[Node]:
    """The particles of both messages of an edge, in the sender's colour: it is the sender who says this."""
    names = [part.name for part in stage.model.parts]
    painted = colours(stage, state.theme)
    for number, (sender, receiver) in enumerate(zip(messages.sender.tolist(), messages.receiver.tolist(), strict=True)):
        if {names[sender], names[receiver]} != set(state.edge or ()):
            continue
        name, size = f"/messages/{sender}-{receiver}", MESSAGE_POINT * stage.size
        placed, weights = messages.poses[number], messages.log_weights[number]
        yield from particles(name, placed, weights, painted[sender], size, state, by_weight=True, shape="diamond")


def _selected(belief: Belief, stage: Stage, state: ViewState) -> Iterator[Node]:
    """The selected particle: a mark at its position, and the part's edges at its pose."""
    number = next((n for n, part in enumerate(stage.model.parts) if part.name == state.part), None)
    if number is None or state.particle is None or state.particle >= belief.poses.shape[1]:
        return
    pose, shape, ink = belief.poses[number, state.particle], stage.shapes[number], INK[state.theme]
    yield ellipsoid("/selected/mark", pose[:3], np.full(3, MARK * stage.size), ink, 0.95)
    if shape is not None:
        yield Lines("/selected/edges", shape.edges, ink, 2.0, pose)


def _compared(snapshot: Snapshot, stage: Stage, state: ViewState) -> Iterator[Node]:
    grey = tuple(QUIET[state.theme] for _ in stage.shapes)
    part_poses = snapshot.placed.part_poses
    yield from _posed("/compare", stage, part_poses, grey, GHOST, state, (False,) * len(grey))
    spread = snapshot.placed.spread
    if state.show.ellipsoids and spread is not None:
        yield _ellipsoids("/compare/ellipsoids", spread.covariances, stage, part_poses, state, grey)
