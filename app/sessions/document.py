"""What does a session's document say? How it was asked for, and what was changed since.

`config` and `scan_ids` are those it began with; `changes` those that came later. The page and REST see them folded.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.problems import HttpProblem
from app.sessions.kept_inputs import model_in, observation_of
from app.store.store import Store
from pmpnbp import recording
from pmpnbp.inference.arrival import Arrival, present
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.snapshot import Criteria
from pmpnbp.recording import Inputs
from pmpnbp.scene.extent import length_of
from pmpnbp.scene.truth_file import truth_of
from pmpnbp.settings import SessionOptions, Settings, changed, preset

Document = dict[str, Any]

# There has to be room for so many bytes before a recording grows: some iterations of a large robot.
ROOM = 8 << 20


def fold(config: Mapping[str, Any], further: Mapping[str, Any]) -> dict[str, Any]:
    """`config` with `further` settings over it; a preset among those undoes what was set before."""
    return dict(further) if "preset" in further else {**config, **further}


def present_config(document: Mapping[str, Any]) -> dict[str, Any]:
    """The settings now in force, as they were given."""
    config = dict(document.get("config") or {})
    for change in document.get("changes") or ():
        config = fold(config, change.get("config") or {})
    return config


def present_scans(document: Mapping[str, Any], iteration: int | None = None) -> tuple[list[str], Arrival | None]:
    """Ids of the scans that an iteration was made with, or else the next one will be, and their arrival."""
    came = [
        (change["after_iteration"], change["scan_id"], change.get("mode", "joins"))
        for change in document.get("changes") or ()
        if change.get("scan_id")
    ]
    ids, arrival = present(document.get("scan_ids") or (), came, iteration)
    return list(ids), arrival


def settings_of(config: Mapping[str, Any]) -> Settings:
    """The settings that `config` makes of the preset `robust`. Raises SettingError."""
    return changed(preset("robust"), config)


def folded(document: Mapping[str, Any]) -> Document:
    """The members that are others once a session begins anew with what is now in force."""
    return {"config": present_config(document), "scan_ids": present_scans(document)[0], "changes": []}


def shown(document: Mapping[str, Any]) -> Document:
    """What REST shows of a document."""
    as_given = ("name", "model_id", "method", "particles", "seed", "roi", "prior", "max_std", "created")
    return {
        **{member: document.get(member) for member in as_given},
        "tags": list(document.get("tags") or ()),
        "scan_ids": present_scans(document)[0],
        "config": present_config(document),
    }


def prepare(store: Store, document: Mapping[str, Any]) -> tuple[Problem, Inputs]:
    """The problem that a document asks for now, and its inputs. Raises PmpnbpError, HttpProblem 404, 409."""
    check_whole(document)
    check_room(store)
    ids, arrival = present_scans(document)
    settings, roi = settings_of(present_config(document)), document.get("roi")
    file = store.file("models", document["model_id"])
    model = model_in(file, settings.triangles)
    scans = [store.load_scan(id) for id in ids]
    return recording.prepare(
        file,
        scans,
        roi,
        document.get("prior"),
        settings,
        particles=document["particles"],
        seed=document["seed"],
        method=document["method"],
        arrival=arrival,
        known_model=model,
        known_observation=observation_of(
            [store.file("scans", id) for id in ids], scans, roi, settings.image_width, length_of(model)
        ),
    )


def criteria(document: Mapping[str, Any]) -> Criteria:
    """By what a session's iterations are judged. Raises ScanError for a truth that is none."""
    truth = document.get("truth")
    return Criteria(
        max_std=document.get("max_std") or SessionOptions.max_std,
        truth=None if truth is None else truth_of(truth, "the truth"),
    )


def check_whole(document: Mapping[str, Any]) -> None:
    """HttpProblem 409 for what stands in for the document of a session whose own is damaged."""
    if not document.get("model_id"):
        raise HttpProblem(409, "the session's document is damaged and does not tell what it was given; delete it")


def check_room(store: Store) -> None:
    """HttpProblem 507 where recordings must not grow any more."""
    with store.staging() as staging:
        staging.claim(ROOM)
