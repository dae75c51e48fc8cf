"""How often does a proposed region hold the object? Random scenes of every family, without a number typed.

Even seeds are those that the proposals' constants may be chosen on, odd ones are held out. The true surface is drawn
from the posed link meshes, what is hidden or out of the picture included; what was measured of it is all that an
estimate reads. Where the camera has no pose, the world is the camera's frame and boxes stand aslant to the ground.
Run it: `python -m benchmarks.proposed_regions [--seeds 40 48] [--without-pose] [--families tent lamp]`.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.hard import write_hard
from benchmarks.hard_scenes import FAMILIES, hard_scene
from benchmarks.tables import markdown, progress, rate
from benchmarks.trials import PROJECT
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.region import Region
from pmpnbp.scene.regions import propose_regions
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.truth_file import load_truth
from pmpnbp.scene.urdf import load_model
from sample_data.rendering import cast, link_meshes, load
from sample_data.scenes import held_out_scene

MADE = ("cabinet", "door", "chain")
HALVES = ("tuning", "held out")
DATA = PROJECT.parent / "shared" / "data"
REAL = {"fetch": ("scan_0", "scan_1"), "real_xarm7": ("frame_0", "frame_4", "frame_7")}
# Share of the surface, or of the measured points, that makes a box hold it.
WHOLE = 0.99
SURFACE_POINTS = 4000
# Metres between what was measured and the true surface, at most, where that is what was seen.
NEAR = 0.03


@dataclass(frozen=True)
class Scene:
    """A scan with its truth. half : of HALVES, or "data"; model : the URDF that is looked for; surface : (P, 3) and
    measured : (M, 3) metres, world, points of the object"""

    half: str
    family: str
    name: str
    model: Path
    scan: Scan
    surface: Array
    measured: Array


@dataclass(frozen=True)
class Outcome:
    """held, seen : of each region in its order, the share of the surface and of the measured points that it holds;
    ratio : of the first box's volume to that of the object's own; seconds : the call took"""

    scene: Scene
    held: tuple[float, ...]
    seen: tuple[float, ...]
    ratio: float
    seconds: float


def scenes(parent: Path, families: Sequence[str], seeds: Sequence[int], data: Path, with_pose: bool) -> Iterator[Scene]:
    """Those of `families` and `seeds`, made in the folder `parent`, and the robots in `data` where they are there."""
    for family in families:
        for seed in seeds:
            if family in MADE:
                folder = held_out_scene(family, seed, parent)
                truth = (folder / "model.urdf").read_text(encoding="utf-8")
            else:
                folder, made = parent / f"{family}_{seed}", hard_scene(family, seed)
                write_hard(folder, made, np.random.default_rng([21, list(FAMILIES).index(family), seed]))
                truth = made.scene.urdf
            yield _scene(HALVES[seed % 2], family, folder, folder / "model.urdf", truth, with_pose)
    for family in (name for name in REAL if (data / name).is_dir()):
        model = data / family / "model.urdf"
        for name in REAL[family]:
            yield _scene("data", family, data / family / name, model, model.read_text(encoding="utf-8"), with_pose)


def _scene(half: str, family: str, folder: Path, model: Path, urdf: str, with_pose: bool) -> Scene:
    truth = load_truth(folder / "truth.json")["links"]
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    meshes = link_meshes(load(urdf, model.parent), model.parent)
    posed = [mesh.copy().apply_transform(poses.to_matrix(truth[name])) for name, mesh in meshes.items()]
    surface, _ = trimesh.sample.sample_surface(trimesh.util.concatenate(posed), SURFACE_POINTS, seed=0)
    depth = cast(posed, scan.camera).depth
    own = (depth > 0) & (scan.depth > 0) & (np.abs(depth - scan.depth) < NEAR)
    camera = scan.camera
    measured = poses.transform_points(camera.pose_world_camera, camera.back_project(scan.depth)[own].astype(np.float64))
    if not with_pose:
        to_camera = poses.inverse(camera.pose_world_camera)
        surface, measured = poses.transform_points(to_camera, surface), poses.transform_points(to_camera, measured)
        scan = replace(scan, camera=replace(camera, pose_world_camera=poses.IDENTITY))
    return Scene(half, family, f"{family}, {folder.name}", model, scan, np.asarray(surface), measured)


def outcome(scene: Scene) -> Outcome:
    """What is proposed of it, judged."""
    model = load_model(scene.model)
    began = time.perf_counter()
    regions = propose_regions([scene.scan], model)
    seconds = time.perf_counter() - began
    own = np.prod(np.ptp(scene.surface, axis=0))
    ratio = float(np.prod(regions[0].roi[3:] - regions[0].roi[:3]) / own) if regions else np.nan
    held = tuple(_share(scene.surface, one) for one in regions)
    return Outcome(scene, held, tuple(_share(scene.measured, one) for one in regions), ratio, seconds)


def _share(points: Array, region: Region) -> float:
    return float(np.all((points >= region.roi[:3]) & (points <= region.roi[3:]), axis=1).mean())


def report(outcomes: Sequence[Outcome]) -> str:
    """A row for each half and family, and one for each half with the rates' intervals."""
    rows = []
    for half in dict.fromkeys(one.scene.half for one in outcomes):
        own = [one for one in outcomes if one.scene.half == half]
        for family in [*dict.fromkeys(one.scene.family for one in own), "all"]:
            some = [one for one in own if family in (one.scene.family, "all")]
            counts = [
                sum(max(shares, default=0.0) >= WHOLE for shares in of_each)
                for of_each in zip(*((one.held[:1], one.held, one.seen[:1], one.seen) for one in some), strict=True)
            ]
            told = [rate(count, len(some)) if family == "all" else f"{count} of {len(some)}" for count in counts]
            ratio, seconds = np.nanmedian([one.ratio for one in some]), np.median([one.seconds for one in some])
            rows.append([half, family, *told, f"{ratio:.1f}", f"{seconds:.2f}"])
    header = ["half", "family", "first holds it", "any does", "first holds what is seen", "any does"]
    return markdown([*header, "volume of the first to the object's", "seconds"], rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(40, 48), help="the first, and the end, not included")
    parser.add_argument("--families", nargs="*", choices=[*FAMILIES, *MADE], default=[*FAMILIES, *MADE])
    parser.add_argument("--without-pose", action="store_true", help="drop the camera's pose")
    parser.add_argument("--data", type=Path, default=DATA, help="where fetch and real_xarm7 are")
    options = parser.parse_args()
    found: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="regions-") as made:
        seeds = range(*options.seeds)
        for scene in scenes(Path(made), options.families, seeds, options.data, not options.without_pose):
            found.append(outcome(scene))
            shares = zip(found[-1].held, found[-1].seen, strict=True)
            progress(f"{scene.name}: " + " ".join(f"{held:.3f}/{seen:.3f}" for held, seen in shares))
    print(report(found))


if __name__ == "__main__":
    main()
