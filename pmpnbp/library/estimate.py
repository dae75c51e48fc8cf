"""An estimate as programs have it: the members of result.json as attributes and arrays.

The same type whoever made it: an inference in this process, a server, or a result.json that was kept.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import EstimateError
from pmpnbp.json_text import read_json
from pmpnbp.library.estimated import (
    Alternative,
    JointEstimate,
    LinkEstimate,
    Nuisance,
    alternative_of,
    joint_of,
    link_of,
)
from pmpnbp.readout.members import OF_POSTERIOR, OF_RUN
from pmpnbp.readout.verdict import advice, verdict

Array = NDArray[np.float64]

# Of the picture in a notebook, pixels.
PICTURE_WIDTH = 480
# Why there are no draws of an iteration.
NOTHING_TO_DRAW_FROM = "during the search there is no posterior, and nothing to draw from"
# Joints that a summary names.
SUMMED_UP = 6


class Scene(Protocol):
    """What an estimate was made of, where that is at hand."""

    def picture(self, width: int | None) -> bytes:
        """PNG: the estimate over its scan. Raises PmpnbpError where it cannot be drawn."""

    def show(self) -> None:
        """Open the page on it."""

    def to_arviz(self, draws: int) -> Any:
        """Draws of its posterior."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The members of result.json, which `to_dict` gives.

    fit : "good", "doubtful", "none", or None as long as there is no posterior; fit_reason : a sentence
    explained : share of what should be seen that the scan confirms; effective_draws : of the posterior
    links : by name; joints : the moving ones, by name; alternatives : whole objects, heaviest first
    unknown : a sentence for each joint and turn that the scan does not tell at all
    depth_noise : (V,) metres, standard deviation of each view's depths; depth_noise_area : (V,) pixels that err as one;
    depth_distortion : (V,) metres, of errors that are smooth over all of a part; empty in results of old
    nuisances : by name
    truth : errors against the truth where that is known, as result.json has them
    outdated : whether scans or settings of its session had changed since when it was asked for; result.json has no such
        member, and what is read from one is not
    """

    model: str
    method: str
    seed: int
    iteration: int
    converged: bool
    frame_id: str
    stamp: float | None
    certain: bool
    max_std: float
    seconds: float
    fit: str | None
    fit_reason: str | None
    explained: float | None
    effective_draws: float | None
    posterior_iteration: int | None
    links: Mapping[str, LinkEstimate]
    joints: Mapping[str, JointEstimate]
    alternatives: tuple[Alternative, ...]
    unknown: tuple[str, ...]
    depth_noise: Array
    depth_noise_area: Array
    depth_distortion: Array
    nuisances: Mapping[str, Nuisance]
    truth: Mapping[str, Any] | None
    _members: Mapping[str, Any]
    _scene: Scene | None
    outdated: bool = False

    @staticmethod
    def from_dict(members: Mapping[str, Any], scene: Scene | None = None) -> Estimate:
        """The estimate that result.json's members tell; `scene` draws and shows it. Raises EstimateError where they
        are none."""
        try:
            return _estimate(members, scene)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            came = f"{type(error).__name__}: {error}"
            raise EstimateError(f"this is no estimate as result.json has it ({came:.200})") from None

    @staticmethod
    def load(path: str | PathLike[str]) -> Estimate:
        """The estimate in a result.json. Raises EstimateError."""
        try:
            members = read_json(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise EstimateError(f"result '{Path(path).name}' cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise EstimateError(f"result '{Path(path).name}' is no JSON: {error}") from None
        return Estimate.from_dict(members)

    def to_dict(self) -> dict[str, Any]:
        """The members of result.json."""
        copy: dict[str, Any] = json.loads(json.dumps(self._members))
        return copy

    @property
    def verdict(self) -> str:
        """One line: was the object found, and what of it is certain?"""
        told = verdict(self._members)
        return f"Outdated, scans or settings have changed since: {told}" if self.outdated else told

    @property
    def summary(self) -> str:
        """Three lines: the verdict, where the joints stand with their central 90 %, and what to do next."""
        rows = standings(self)
        told = "; ".join(f"{name} {row}" for name, row in rows[:SUMMED_UP])
        more = f"; and {len(rows) - SUMMED_UP} more" if len(rows) > SUMMED_UP else ""
        following = "Next: let it make more iterations" if self.outdated else advice(self._members)
        return "\n".join([self.verdict, told + more, following])

    def picture(self, width: int | None = None) -> bytes:
        """PNG: the estimate drawn over the scan as its camera sees it. width : pixels, default: the camera's. Raises
        PmpnbpError where it cannot be drawn, EstimateError where its scan is not at hand."""
        return self._at_hand().picture(width)

    def show(self) -> None:
        """Open the page on it, in a browser where there is a screen, and print the page's address. Raises EstimateError
        where its scan is not at hand."""
        self._at_hand().show()

    def to_arviz(self, draws: int = 1000) -> Any:
        """The posterior as an `arviz.InferenceData` of draws of equal weight. Raises PmpnbpError where ArviZ is not
        installed, and EstimateError where there is no posterior, or it is not at hand."""
        return self._at_hand().to_arviz(draws)

    def _at_hand(self) -> Scene:
        if self._scene is None:
            raise EstimateError("this estimate was read from result.json, and its scan and posterior are not at hand")
        return self._scene

    def __repr__(self) -> str:
        rows = [f"{name} {row}" for name, row in standings(self)]
        return "\n".join([f"<Estimate of {self.model} after iteration {self.iteration}. {self.verdict}", *rows]) + ">"

    def _repr_html_(self) -> str:
        """What a notebook shows: the picture, the verdict and the joints."""
        try:
            data = base64.b64encode(self.picture(PICTURE_WIDTH)).decode()
            picture = f'<img alt="the estimate over the scan" src="data:image/png;base64,{data}">'
        except Exception:  # a notebook's cell shows what can be shown, wherever it runs
            picture = ""
        rows = "".join(
            f"<tr><th>{html.escape(name)}</th><td>{html.escape(row)}</td></tr>" for name, row in standings(self)
        )
        head = f"<b>{html.escape(self.model)}</b>, iteration {self.iteration}: {html.escape(self.verdict)}"
        return f"<div>{picture}<p>{head}</p><table>{rows}</table></div>"


def standings(found: Estimate) -> list[tuple[str, str]]:
    """Name and position of each joint, in words; of an object without any, of its links."""
    if not found.joints:
        return [(f"link {name}", _place(link)) for name, link in found.links.items()]
    return [(f"joint {name}", _stand(joint)) for name, joint in found.joints.items()]


def _place(link: LinkEstimate) -> str:
    std = "" if link.std_xyz is None else f" ± {1000 * link.std_xyz.max():.1f} mm"
    return f"at {', '.join(f'{number:.3f}' for number in link.pose[:3])} m{std}"


def _stand(joint: JointEstimate) -> str:
    slides = np.arange(len(joint.positions)) < {"prismatic": 1, "planar": 2, "floating": 3}.get(joint.type, 0)
    told = []
    for axis, position in enumerate(joint.positions):
        unit, factor = ("cm", 100.0) if slides[axis] else ("°", 180 / np.pi)
        text = f"{factor * position:.2f}"
        if joint.intervals is not None:
            low, high = factor * joint.intervals[axis]
            text += f" ({low:.2f} to {high:.2f})"
        told.append(f"{text} {unit}" if unit == "cm" else f"{text}{unit}")
    return ", ".join(told)


def _estimate(members: Mapping[str, Any], scene: Scene | None) -> Estimate:
    told: dict[str, Any] = {name: members[name] for name in OF_RUN}
    told |= {name: members.get(name) for name in OF_POSTERIOR}
    return Estimate(
        **told,
        links={name: link_of(name, entry) for name, entry in members["links"].items()},
        joints={name: joint_of(name, entry) for name, entry in members["joints"].items()},
        alternatives=tuple(alternative_of(entry) for entry in members.get("alternatives") or ()),
        unknown=tuple(members.get("unknown") or ()),
        depth_noise=np.array(members.get("depth_noise") or (), dtype=np.float64),
        depth_noise_area=np.array(members.get("depth_noise_area") or (), dtype=np.float64),
        depth_distortion=np.array(members.get("depth_distortion") or (), dtype=np.float64),
        nuisances={name: Nuisance(**entry) for name, entry in (members.get("nuisances") or {}).items()},
        truth=members.get("truth"),
        _members=members,
        _scene=scene,
    )
