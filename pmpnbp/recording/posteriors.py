"""Which arrays make a posterior, and back. They stand among those of the iteration that it was read out from.

A posterior could be made again from its iteration, but only on the machine that made it would every draw be the same.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import RecordingError
from pmpnbp.inference.problem import Problem
from pmpnbp.json_text import read_json
from pmpnbp.readout.fit import Fit, Verdict
from pmpnbp.readout.posterior import Centre, ObjectMode, Posterior
from pmpnbp.recording.arrays import Arrays
from pmpnbp.recording.report_check import are_in_reach, are_numbers, are_poses, are_small, are_whole
from pmpnbp.recording.schema import PREFIX

_DRAWS = ("root", "joints", "drawn_roots", "drawn_joints", "log_weights", "mode")
# Only where nuisances are free, of a posterior that was recorded since they are told.
_OF_NUISANCES = ("drawn_sizes", "nuisance_stds")
# Of a fit, names of parts; what was recorded before there were those beyond the region has none.
_PARTS = ("missed", "denied", "beyond")


def posterior_arrays(posterior: Posterior) -> Arrays:
    """The arrays of a posterior by name."""
    fit, modes = posterior.fit, posterior.modes
    text = {"verdict": fit.verdict, "reason": fit.reason, "explained": fit.explained}
    text |= {name: getattr(fit, name) for name in _PARTS}
    found: Arrays = {name: getattr(posterior, name) for name in _DRAWS}
    found["mode_weights"] = np.array([mode.weight for mode in modes])
    found["mode_roots"] = np.array([mode.root for mode in modes])
    found["mode_joints"] = np.array([mode.joints for mode in modes])
    found["effective_sample_size"] = np.array([posterior.effective_sample_size])
    found |= {name: values for name in _OF_NUISANCES if (values := getattr(posterior, name)) is not None}
    if posterior.centre is not None:
        found["centre_root"], found["centre_joints"] = posterior.centre.root, posterior.centre.joints
        if posterior.centre.nuisances is not None:
            found["centre_nuisances"] = posterior.centre.nuisances
    found["fit"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
    return {PREFIX + name: values for name, values in found.items()}


def to_posterior(iteration: int, arrays: Mapping[str, NDArray[Any]]) -> Posterior | None:
    """The posterior that was read out from an iteration, bit for bit; None where it has none. Raises KeyError,
    TypeError or ValueError where the arrays are no posterior's."""
    if PREFIX + "fit" not in arrays:
        return None
    found = {name.removeprefix(PREFIX): values for name, values in arrays.items() if name.startswith(PREFIX)}
    fit = {"beyond": ()} | read_json(found["fit"].tobytes().decode())
    modes = zip(found["mode_weights"].tolist(), found["mode_roots"], found["mode_joints"], strict=True)
    return Posterior(
        iteration=iteration,
        **{name: found[name] for name in _DRAWS},
        modes=tuple(ObjectMode(weight=float(weight), root=root, joints=joints) for weight, root, joints in modes),
        effective_sample_size=float(found["effective_sample_size"].item()),
        fit=Fit(**{**fit, **{name: tuple(fit[name]) for name in _PARTS}}),
        drawn_sizes=found.get("drawn_sizes"),
        nuisance_stds=found.get("nuisance_stds"),
        centre=_centre(found),
    )


def _centre(arrays: Mapping[str, NDArray[Any]]) -> Centre | None:
    """None of a posterior that was recorded before there was one, or without one."""
    if "centre_root" not in arrays:
        return None
    return Centre(root=arrays["centre_root"], joints=arrays["centre_joints"], nuisances=arrays.get("centre_nuisances"))


def check_posterior_fits(problem: Problem, posterior: Posterior) -> None:
    """RecordingError where arrays of a posterior from elsewhere have other shapes or kinds than its problem makes, its
    weights are none, or its fit."""
    if not _fits(problem, posterior):
        raise RecordingError(
            f"the posterior of iteration {posterior.iteration} does not fit the model of its recording"
        )


@np.errstate(all="ignore")  # whatever the numbers are, it is told once
def _fits(problem: Problem, posterior: Posterior) -> bool:
    if posterior.log_weights.ndim != 1 or posterior.log_weights.dtype.kind != "f":
        return False
    draws, dof, count = len(posterior.log_weights), problem.mrf.model.dof, len(posterior.modes)
    fit, mode = posterior.fit, posterior.mode
    sound = (
        are_poses(posterior.root, (7,))
        and are_in_reach(posterior.joints, (dof,))
        and are_poses(posterior.drawn_roots, (draws, 7))
        and are_in_reach(posterior.drawn_joints, (draws, dof))
        and (posterior.drawn_sizes is None or _are_sizes(posterior.drawn_sizes, draws))
        and (posterior.nuisance_stds is None or _are_stds(posterior.nuisance_stds, problem.nuisance_std))
        and (posterior.centre is None or _is_centre(problem, posterior.centre))
        and are_whole(mode, (draws,))
        and all(are_poses(one.root, (7,)) and are_in_reach(one.joints, (dof,)) for one in posterior.modes)
    )
    if not sound or not draws or not count:
        return False
    shares = np.array([one.weight for one in posterior.modes])
    return bool(
        np.isclose(np.exp(posterior.log_weights).sum(), 1, atol=1e-3)
        and np.isclose(shares.sum(), 1, atol=1e-3)
        and np.all(shares >= 0)
        and np.all((mode >= 0) & (mode < count))
        and 0 <= posterior.effective_sample_size <= draws
        and fit.verdict in get_args(Verdict)
        and isinstance(fit.reason, str)
        and isinstance(fit.explained, float | int)
        and 0 <= fit.explained <= 1
        and all(isinstance(name, str) for names in _PARTS for name in getattr(fit, names))
    )


def _is_centre(problem: Problem, centre: Centre) -> bool:
    nuisances = centre.nuisances is None or are_small(centre.nuisances, problem.nuisance_std.shape)
    return nuisances and are_poses(centre.root, (7,)) and are_in_reach(centre.joints, (problem.mrf.model.dof,))


def _are_sizes(sizes: NDArray[Any], draws: int) -> bool:
    return are_numbers(sizes, (draws, 3)) and bool(np.all(sizes > -1))


def _are_stds(stds: NDArray[Any], priors: NDArray[Any]) -> bool:
    return are_numbers(stds, priors.shape) and bool(np.all(stds >= 0))
