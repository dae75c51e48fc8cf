"""The posterior in ArviZ: is what comes back from the file what was drawn, as often as it weighs?"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.arviz_export import MissingArvizError, load_arviz, to_inference_data
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.posterior import ObjectMode, Posterior
from tests.inference import small_worlds as worlds

MODEL = worlds.sliding_chain(3)
WEIGHTS = np.array([0.4, 0.25, 0.2, 0.1, 0.05, 0.0])


def drawn(rng: np.random.Generator) -> Posterior:
    """Six draws of two modes, one of which weighs nothing."""
    roots = np.concatenate([rng.normal(size=(6, 3)), poses.random_quaternions(rng, (6,))], axis=1)
    joints = rng.uniform(MODEL.lower, MODEL.upper, (6, MODEL.dof))
    with np.errstate(divide="ignore"):
        log_weights = np.log(WEIGHTS)
    return Posterior(
        iteration=9,
        root=roots[0],
        joints=joints[0],
        drawn_roots=roots,
        drawn_joints=joints,
        log_weights=log_weights,
        mode=np.array([0, 0, 0, 1, 1, 1]),
        modes=tuple(ObjectMode(weight=weight, root=roots[k], joints=joints[k]) for weight, k in ((0.85, 0), (0.15, 3))),
        effective_sample_size=3.5,
        fit=Fit(verdict="good", reason="the scan confirms 90 %", explained=0.9),
    )


def which(data: Any, posterior: Posterior) -> Array:
    """(N,) the number of the draw that each of the exported is."""
    apart = data.posterior["joint_position"].values[0][:, None] - posterior.drawn_joints
    np.testing.assert_array_equal(np.abs(apart).min(axis=1), 0.0)
    return np.abs(apart).sum(axis=-1).argmin(axis=1)


def test_draws_come_back_from_the_file_as_often_as_they_weigh(rng: np.random.Generator, tmp_path: Path) -> None:
    posterior = drawn(rng)
    data = to_inference_data(MODEL, posterior, draws=400, seed=3, attributes={"method": "pmpnbp"})
    data.to_netcdf(str(tmp_path / "draws.nc"))
    read = load_arviz().from_netcdf(str(tmp_path / "draws.nc"))
    number = which(read, posterior)
    assert np.abs(np.bincount(number, minlength=6) - 400 * WEIGHTS).max() <= 1
    assert list(read.posterior.joint.values) == list(MODEL.coordinate_names)
    assert list(read.posterior.link.values) == list(MODEL.links)
    links = posterior.link_poses(MODEL)[number]
    np.testing.assert_array_equal(read.posterior["link_position"].sel(axis=["x", "y", "z"]).values[0], links[..., :3])
    orientation = read.posterior["link_orientation"].sel(component=["w", "x", "y", "z"]).values[0]
    np.testing.assert_allclose(np.abs(np.sum(orientation * links[..., 3:], axis=-1)), 1.0)
    assert np.all(orientation[..., 0] >= 0)
    np.testing.assert_allclose(read.sample_stats["log_weight"].values[0], posterior.log_weights[number])
    np.testing.assert_array_equal(read.sample_stats["mode"].values[0], posterior.mode[number])
    named = {name: read.attrs[name] for name in ("method", "model", "fit", "effective_sample_size", "iteration")}
    assert named == {
        "method": "pmpnbp",
        "model": MODEL.name,
        "fit": "good",
        "effective_sample_size": 3.5,
        "iteration": 9,
    }
    np.testing.assert_allclose(read.attrs["mode_weights"], [0.85, 0.15])


def test_the_seed_decides_the_order_and_nothing_else(rng: np.random.Generator) -> None:
    posterior = drawn(rng)
    one, same, other = (which(to_inference_data(MODEL, posterior, draws=50, seed=s), posterior) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    np.testing.assert_array_equal(np.sort(one), np.sort(other))
    assert np.any(np.diff(one) < 0), "draws in the order of their modes would look like a chain that moved"


def test_an_object_without_joints_has_links_only(rng: np.random.Generator, tmp_path: Path) -> None:
    posterior = replace(drawn(rng), drawn_joints=np.zeros((6, 0)), joints=np.zeros(0))
    data = to_inference_data(worlds.sliding_chain(1), posterior, draws=10)
    data.to_netcdf(str(tmp_path / "draws.nc"))
    assert set(load_arviz().from_netcdf(str(tmp_path / "draws.nc")).posterior) == {"link_position", "link_orientation"}


def test_without_the_package_one_sentence_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingArvizError, match=r"pip install 'pmpnbp\[arviz\]'"):
        load_arviz()
