"""What was an inference given? Its inputs, in a form that makes the same problem again on another machine."""

from __future__ import annotations

import io
import json
import math
import posixpath
import sqlite3
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args
from xml.etree import ElementTree

import numpy as np

from pmpnbp.errors import SettingError
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problem_module
from pmpnbp.inference.arrival import Arrival, present
from pmpnbp.inference.problem import Problem
from pmpnbp.json_text import read_json
from pmpnbp.names import name_fault
from pmpnbp.recording.changes import changes, first_scans
from pmpnbp.recording.scans import store_scan
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.common_scene import check_views
from pmpnbp.scene.model_files import ModelLimits, open_model
from pmpnbp.scene.observation import Observation, Scan
from pmpnbp.scene.prior import GaussianPrior, Orientation, UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings, changed, checked_option, preset
from pmpnbp.version import version


@dataclass(frozen=True)
class Inputs:
    """model : the URDF or zip that was loaded; roi : (6,), metres, world, or None; arrival : that of the scans; the
    rest as `problem.build` takes it."""

    model: Path
    scans: tuple[Scan, ...]
    roi: Array | None
    prior: UniformPrior | GaussianPrior
    settings: Settings
    particles: int
    seed: int
    method: str = SessionOptions.method
    arrival: Arrival | None = None

    def problem(self, model: ArticulatedObject | None = None, observation: Observation | None = None) -> Problem:
        """The problem these make; `model` is what is in their file, `observation` what is seen in their scans, where
        that is known already. Raises PmpnbpError where they make none."""
        model = model or load_model(self.model, triangle_budget=self.settings.triangles)
        observation = observation or problem_module.look(model, self.scans, self.roi, self.settings)
        return problem_module.build(
            model,
            observation,
            self.prior,
            self.settings,
            particles=self.particles,
            seed=self.seed,
            method=self.method,
            arrival=self.arrival,
        )


def prepare(
    model: Path,
    scans: Sequence[Scan],
    roi: Sequence[float] | None,
    prior: Path | Mapping[str, object] | None,
    settings: Settings,
    *,
    particles: int,
    seed: int,
    method: str = SessionOptions.method,
    arrival: Arrival | None = None,
    known_model: ArticulatedObject | None = None,
    known_observation: Observation | None = None,
) -> tuple[Problem, Inputs]:
    """The problem, and the inputs that a recording keeps of it: the same input and seed give the same numbers, whoever
    asks.

    model : a URDF or zip; roi : x0 y0 z0 x1 y1 z1, metres, world, or None; prior : prior.json, its members, or None
    for upright anywhere; method : one of `settings.METHODS`; arrival : that of the newest scans, where they came later;
    known_model : what is in the file, where it was read already, with the triangles that the settings ask for
    known_observation : what `scene.observe` makes of the scans, where that was done already
    Raises PmpnbpError for what does not fit together.
    """
    check_views(scans)
    found = known_model or load_model(model, triangle_budget=settings.triangles)
    known = UniformPrior("upright") if prior is None else load_prior(prior, found)
    box = None if roi is None else np.array(roi, dtype=np.float64)
    inputs = Inputs(model, tuple(scans), box, known, settings, particles, seed, method, arrival)
    return inputs.problem(found, known_observation), inputs


def store(connection: sqlite3.Connection, inputs: Inputs, model: ArticulatedObject, max_std: float) -> None:
    """Write inputs, the names of the `model` they lead to and of its parts, and the metres up to which a link is said
    to be certain, into a new recording."""
    values = {
        "version": version(),
        "method": inputs.method,
        "model": model.name,
        "parts": [{"name": part.name, "links": list(part.links)} for part in model.parts],
        "settings": asdict(inputs.settings),
        "prior": _prior_members(inputs.prior),
        "region": None if inputs.roi is None else [float(number) for number in inputs.roi],
        "particles": inputs.particles,
        "seed": inputs.seed,
        "max_std": max_std,
    }
    rows = [(name, json.dumps(value)) for name, value in values.items()]
    connection.executemany("INSERT INTO inputs VALUES (?, ?)", rows)
    connection.execute("INSERT INTO model VALUES (?, ?)", (inputs.model.stem + ".zip", model_zip(inputs.model)))
    for scan in inputs.scans:
        store_scan(connection, scan)


def value(connection: sqlite3.Connection, name: str) -> Any:
    """The entry `name` of the table `inputs`."""
    return read_json(connection.execute("SELECT value FROM inputs WHERE name = ?", (name,)).fetchone()[0])


def option(connection: sqlite3.Connection, name: str) -> Any:
    """The entry `name`, a whole number that is an option. Raises ValueError beyond what an inference is asked for."""
    number, entry = value(connection, name), next(one for one in fields(SessionOptions) if one.name == name)
    if type(number) is not int or not entry.metadata["low"] <= number <= entry.metadata["high"]:
        raise ValueError(f"{name} is {number!r}")
    return number


def max_std(connection: sqlite3.Connection) -> float:
    """Metres up to which a link was said to be certain; the default in a recording of before it was kept. Raises
    ValueError where it is no such number."""
    row = connection.execute("SELECT value FROM inputs WHERE name = 'max_std'").fetchone()
    try:
        return float(SessionOptions.max_std if row is None else checked_option("max_std", read_json(row[0])))
    except SettingError as error:
        raise ValueError(str(error)) from None


def restored_model(connection: sqlite3.Connection) -> ArticulatedObject:
    """The model, as it is before anything is looked at."""
    with tempfile.TemporaryDirectory(prefix="recording-") as folder:
        # no mesh is made coarser, which takes longest
        return load_model(_model_file(connection, Path(folder)), triangle_budget=ModelLimits().triangles)


def _model_file(connection: sqlite3.Connection, folder: Path) -> Path:
    file_name, data = connection.execute("SELECT file_name, zip FROM model").fetchone()
    if not isinstance(file_name, str) or name_fault(file_name) or not Path(file_name).stem.strip("."):
        raise ValueError("the model has no name")
    path = folder / Path(file_name).name
    path.write_bytes(data)
    return path


def restored_inputs(connection: sqlite3.Connection, folder: Path, iteration: int | None = None) -> Inputs:
    """What iteration `iteration` was made with, or else the next one will be; the model becomes a file in `folder`."""
    roi = value(connection, "region")
    found = Inputs(
        _model_file(connection, folder),
        first_scans(connection),
        None if roi is None else np.array(roi),
        _prior(value(connection, "prior")),
        first_settings(connection),
        option(connection, "particles"),
        option(connection, "seed"),
        str(value(connection, "method")),
    )
    changed_then = changes(connection, iteration)
    came = [(one.after_iteration, one.scan, one.mode) for one in changed_then if one.scan is not None]
    scans, arrival = present(found.scans, came)
    settings = [one.settings for one in changed_then if one.settings is not None]
    return replace(found, scans=scans, arrival=arrival, settings=settings[-1] if settings else found.settings)


def first_settings(connection: sqlite3.Connection) -> Settings:
    """The settings that the inference began with."""
    return changed(preset("robust"), value(connection, "settings"))


def restored_problem(connection: sqlite3.Connection, iteration: int | None = None) -> Problem:
    """The problem of an iteration, or else of the next one, made again from its inputs."""
    with tempfile.TemporaryDirectory(prefix="recording-") as folder:
        return restored_inputs(connection, Path(folder), iteration).problem()


def model_zip(path: Path) -> bytes:
    """The model as one zip: the zip itself, or the URDF with the meshes it names, laid out so that it finds them.

    The same model gives the same bytes. Raises ModelError where a mesh is missing.
    """
    limits = ModelLimits()
    with open_model(path, limits) as files:
        if files.from_zip:
            return path.read_bytes()
        urdf = files.read_urdf(limits)
        entries = {f"{path.stem}.urdf": urdf}
        for link in ElementTree.fromstring(urdf).iter("link"):
            # a link's collision geometry is not read where it has visual geometry, and then need not be there
            shapes = link.findall("visual") or link.findall("collision")
            for mesh in (mesh for shape in shapes for mesh in shape.iter("mesh")):
                filename = mesh.get("filename", "")
                inside = filename.partition("://")[2] or filename
                name = posixpath.normpath(inside.replace("\\", "/")).lstrip("/")
                if name not in entries:
                    entries[name] = files.read_mesh(filename, link.get("name", ""), limits)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _prior_members(prior: UniformPrior | GaussianPrior) -> dict[str, Any]:
    """Not the form of prior.json: reading that one normalises, and a replay has to have the same bits."""
    if isinstance(prior, UniformPrior):
        return {"kind": "uniform", "orientation": prior.orientation}
    return {
        "kind": "gaussian",
        "link": prior.link,
        "pose_world_link": np.asarray(prior.pose_world_link).tolist(),
        "std_xyz": np.asarray(prior.std_xyz).tolist(),
        "std_rpy": np.asarray(prior.std_rpy).tolist(),
        "joints": {name: [float(position), float(std)] for name, (position, std) in prior.joints.items()},
    }


# Arrays of a gaussian prior, and their lengths.
_GAUSSIAN = {"pose_world_link": 7, "std_xyz": 3, "std_rpy": 3}


def _prior(members: dict[str, Any]) -> UniformPrior | GaussianPrior:
    """Raises ValueError where it is none. Whether its link and joints are in the model is asked where a problem is made
    of it."""
    if members["kind"] == "uniform":
        if members["orientation"] not in get_args(Orientation):
            raise ValueError("no orientation")
        return UniformPrior(members["orientation"])
    pose, std_xyz, std_rpy = (_finite(members[name], count) for name, count in _GAUSSIAN.items())
    joints = {name: tuple(_finite(numbers, 2).tolist()) for name, numbers in members["joints"].items()}
    widths = [*std_xyz, *std_rpy, *(std for _, std in joints.values())]
    if not all(0 < width <= 1e6 for width in widths) or not math.isclose(np.linalg.norm(pose[3:]), 1, abs_tol=1e-3):
        raise ValueError("no prior")
    return GaussianPrior(members["link"], pose, std_xyz, std_rpy, joints)


def _finite(numbers: list[Any], count: int) -> Array:
    found = np.array(numbers, dtype=np.float64)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise ValueError("no numbers")
    return found
