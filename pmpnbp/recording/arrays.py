"""Which arrays make an iteration, and back: report and state as named arrays, without what others of them imply.

Where all messages to a part judge the part's own particles, a message's poses are the belief's; a message's weights are
its two factors, normalised; a message's share in a particle's weight is their sum. Left out, an iteration is half as
large. What the state has in common with the report is not written twice. Everything comes back bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import Belief, IterationReport, Messages, Origin, State

Arrays = dict[str, NDArray[Any]]
# The report's own arrays: names in the file, which are older than the fields', and the fields.
_OF_REPORT = {
    "log_message_shares": "log_message_shares",
    "temperature": "inverse_temperature",
    "effective_sample_size": "effective_sample_size",
    "mle": "map_poses",
    "mle_joints": "map_joints",
    "nuisances": "nuisances",
    "rivals": "rivals",
}
# Those that a report may be without: the paper's estimate has no joints; the state's rivals are the report's.
_OPTIONAL = {"mle_joints", "nuisances", "rivals"}


def to_arrays(report: IterationReport, state: State) -> Arrays:
    """The arrays of an iteration by name."""
    found = _members("belief", report.belief) | _members("messages", report.messages)
    own = {name: getattr(report, member) for name, member in _OF_REPORT.items()}
    found |= {name: np.asarray(array) for name, array in own.items() if array is not None}
    kept = _members("belief", state.belief) | _members("messages", state.messages)
    for name in found.keys() | kept.keys():
        if name.startswith(("belief.", "messages.")) and not _same(found.get(name), kept.get(name)):
            # an empty array where the state has none: it does not keep what the report tells
            found[f"state.{name}"] = kept.get(name, np.zeros(0, dtype=np.bool_))
    for name in ("root", "joints", "nuisances"):
        if getattr(state, name) is not None:
            found[f"state.{name}"] = getattr(state, name)
    if report.search_after:
        found["search_after"] = np.array(report.search_after)
    if report.messages is not None:
        for name, values in implied(found).items():
            if _same(found.get(name), values):
                del found[name]
    return found


def implied(found: Mapping[str, NDArray[Any]]) -> Arrays:
    """Poses, weights and shares of messages as the other arrays of an iteration have them, where they do."""
    belief, receiver = found["belief.poses"], found["messages.receiver"]
    factors = found["messages.log_unary"] + found["messages.log_neighbour"]
    result: Arrays = {"messages.log_weights": lw.normalise(factors)}
    if len(receiver) == 0 or factors.shape[1] != belief.shape[1]:
        return result
    result["messages.poses"] = belief[receiver]
    incoming = incoming_messages(receiver, len(belief))
    shares = np.full((*belief.shape[:2], max(len(messages) for messages in incoming)), np.nan)
    for node, messages in enumerate(incoming):
        for place, message in enumerate(messages):
            shares[node, :, place] = factors[message]
    return result | {"log_message_shares": shares}


def incoming_messages(receiver: NDArray[np.integer], nodes: int) -> list[list[int]]:
    """For each node the messages that reach it, in order of their number, as `Mrf.incoming`."""
    return [np.flatnonzero(receiver == node).tolist() for node in range(nodes)]


def to_report(number: int, scalars: Mapping[str, Any], arrays: Arrays) -> IterationReport:
    """The report of iteration `number` from the row of `iterations` and its arrays."""
    found = _completed(arrays)
    own: dict[str, Any] = {member: _frozen(found[name]) for name, member in _OF_REPORT.items() if name not in _OPTIONAL}
    own |= {_OF_REPORT[name]: found.get(name) for name in _OPTIONAL}
    return IterationReport(
        iteration=number,
        stage=scalars["stage"],
        belief=_belief(found, ""),
        messages=_messages(found, ""),
        map_score=float("nan") if scalars["mle_score"] is None else scalars["mle_score"],
        tolerance=scalars["tolerance"],
        seconds=scalars["seconds"],
        notes=tuple(scalars["notes"]),
        search_after=_search_after(found),
        **own,
    )


def to_state(number: int, arrays: Arrays) -> State:
    """The state after iteration `number`."""
    found = _completed(arrays)
    return State(
        iteration=number,
        belief=_belief(found, "state."),
        messages=_messages(found, "state."),
        root=found.get("state.root"),
        joints=found.get("state.joints"),
        nuisances=found.get("state.nuisances"),
        rivals=found.get("rivals"),
        search_after=_search_after(found),
    )


def _search_after(found: Arrays) -> int:
    return int(found.get("search_after", np.array(0)))


def _completed(arrays: Arrays) -> Arrays:
    return arrays if "messages.receiver" not in arrays else implied(arrays) | arrays


def _members(prefix: str, value: Belief | Messages | None) -> Arrays:
    if value is None:
        return {}
    members = vars(value)
    if isinstance(value, Belief):  # in the file a particle's origin is not set apart
        members = {name: member for name, member in members.items() if name != "origin"} | vars(value.origin)
    return {f"{prefix}.{name}": member for name, member in members.items() if member is not None}


def _belief(found: Arrays, first: str) -> Belief:
    members = {
        entry.name: _either(found, first, f"belief.{entry.name}") for entry in (*fields(Belief), *fields(Origin))
    }
    joints = members.pop("joint_positions")
    del members["origin"]
    present = _present(members)
    origin = Origin(**{entry.name: present.pop(entry.name) for entry in fields(Origin)})
    return Belief(origin=origin, joint_positions=joints, **present)


def _messages(found: Arrays, first: str) -> Messages | None:
    members = {entry.name: _either(found, first, f"messages.{entry.name}") for entry in fields(Messages)}
    return None if members["sender"] is None else Messages(**_present(members))


def _present(members: Mapping[str, NDArray[Any] | None]) -> Arrays:
    """The members. Raises KeyError where one is missing."""
    for name, member in members.items():
        if member is None:
            raise KeyError(name)
    return dict(members)  # type: ignore[arg-type]  # checked above


def _either(found: Arrays, first: str, name: str) -> NDArray[Any] | None:
    own = found.get(first + name)
    if own is None:
        return found.get(name)
    return None if own.dtype == np.bool_ else own


def _same(a: NDArray[Any] | None, b: NDArray[Any] | None) -> bool:
    if a is None or b is None:
        return a is b
    if a is b:
        return True
    # as bytes: NaN equals NaN, and minus zero is not zero
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def _frozen(array: NDArray[Any]) -> Array:
    array.setflags(write=False)
    return array
