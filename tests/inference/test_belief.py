"""Do states and reports have the shapes that their types say?"""

from __future__ import annotations

from dataclasses import is_dataclass, replace
from typing import get_type_hints

import numpy as np
import pytest
from jaxtyping import AbstractArray, jaxtyped

from pmpnbp.inference import problem, run
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds


def misshapen(value: object) -> list[str]:
    """Names of the arrays in a record, and in the records within it, whose shape or kind is not their type's."""
    found: list[str] = []
    inner: list[object] = []
    # what a dimension is called holds within one record
    with jaxtyped("context"):
        for name, hint in get_type_hints(type(value), include_extras=True).items():
            member = getattr(value, name)
            if is_dataclass(member):
                inner.append(member)
            elif issubclass(next(iter(getattr(hint, "__args__", ())), hint), AbstractArray):
                found += [] if isinstance(member, hint) else [name]
    return found + [name for record in inner for name in misshapen(record)]


@pytest.mark.parametrize("method", ["pmpnbp", "particle_filter"])
@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_arrays_have_the_shapes_of_their_types(method: str, preset: str) -> None:
    model = worlds.star(3)
    root, joints = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.zeros(model.dof)
    chosen = worlds.settings(preset, **({"search_iterations": 1, "search_proposals": 40} if preset == "robust" else {}))
    observation = worlds.seen(model, root, joints)
    made = problem.build(model, observation, UniformPrior("upright"), chosen, particles=20, method=method)
    state, report = run.begin(made)
    assert misshapen(state) == misshapen(report) == []
    for _ in range(3):
        state, report = run.advance(state, made)
        assert misshapen(state) == misshapen(report) == []
    turned = replace(report, map_poses=report.map_poses[:, :6], belief=replace(report.belief, log_weights=np.zeros(3)))
    assert misshapen(turned) == ["map_poses", "log_weights"]
