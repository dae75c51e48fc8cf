"""A posterior is told from the recording, draw for draw, whatever becomes of the iteration it was read out from."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.errors import RecordingError
from pmpnbp.inference import run
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import Step
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.posterior import Centre, Posterior
from pmpnbp.readout.snapshot import Criteria, snapshot
from pmpnbp.recording import Inputs, IterationArchive, Recording, RecordingWriter
from pmpnbp.recording.posteriors import check_posterior_fits, posterior_arrays, to_posterior
from pmpnbp.recording.schema import pack
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.sameness import assert_same

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"
QUICK = {
    "image_width": 80,
    "triangles": 60,
    "splat_points": 64,
    "search_proposals": 300,
    "search_islands": 1,
    "search_restarts": 0,
    "search_iterations": 1,
    "anneal_iterations": 2,
    "refine_iterations": 1,
}
Made = tuple[Inputs, Problem, list[Step], Posterior]


@pytest.fixture(scope="module")
def made() -> Made:
    """Three iterations, and the posterior of the second."""
    box = np.array(json.loads((CABINET / "open" / "roi.json").read_text())["roi"])
    scan = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
    inputs = Inputs(CABINET / "cabinet.urdf", (scan,), box, UniformPrior(), changed(preset("robust"), QUICK), 12, 3)
    problem = inputs.problem()
    steps = [run.first(problem)]
    for _ in range(3):
        steps.append(run.following(steps[-1], problem))
    return inputs, problem, steps, of_estimate(problem, steps[2].report)


def recorded(path: Path, made: Made) -> Path:
    """A recording whose third iteration was told with the second's posterior, too."""
    inputs, problem, steps, posterior = made
    archive = IterationArchive(path, "session 'x'")
    for step in steps:
        told = posterior if step.iteration >= 2 else None
        read = snapshot(problem, step.report, Criteria(max_std=0.0025), converged=False, elapsed=0.0, posterior=told)
        if step.iteration == 0:
            archive.begin(inputs, step, read)
        else:
            archive.add(step, read, lambda: None)
    archive.close()
    return path


def opened(path: Path, **options: Any) -> IterationArchive:
    archive = IterationArchive(path, "session 'x'", **options)
    archive.open(Criteria(max_std=0.0025))
    return archive


def altered(path: Path, iteration: int, **arrays: np.ndarray) -> None:
    connection = sqlite3.connect(path)
    for name, values in arrays.items():
        connection.execute(
            "INSERT OR REPLACE INTO arrays VALUES (?, ?, ?, ?, ?)", (iteration, f"posterior.{name}", *pack(values))
        )
    connection.commit()
    connection.close()


def test_it_comes_back_bit_for_bit(made: Made) -> None:
    assert_same(to_posterior(2, posterior_arrays(made[3])), made[3])
    assert to_posterior(2, {}) is None
    check_posterior_fits(made[1], made[3])


def test_a_fit_of_before_parts_beyond_the_region_were_told_has_none(made: Made) -> None:
    arrays = posterior_arrays(made[3])
    text = json.loads(arrays["posterior.fit"].tobytes())
    for name, refused in (("beyond", False), ("denied", True)):
        left = json.dumps({member: value for member, value in text.items() if member != name})
        shorter = arrays | {"posterior.fit": np.frombuffer(left.encode(), dtype=np.uint8)}
        if refused:
            with pytest.raises(KeyError, match=name):
                to_posterior(2, shorter)
        else:
            found = to_posterior(2, shorter)
            assert found is not None and found.fit == made[3].fit and found.fit.beyond == ()


def test_later_iterations_are_told_with_the_draws_that_were_recorded(made: Made, tmp_path: Path) -> None:
    """Not with such as are made again: here they are others."""
    path = recorded(tmp_path / "run.sqlite", made)
    assert_same(opened(path).read(3).placed.posterior, made[3])
    shifted = made[3].drawn_roots + np.r_[0.001, 0, 0, 0, 0, 0, 0]
    altered(path, 2, drawn_roots=shifted)
    for number in (2, 3):
        found = opened(path).read(number).placed.posterior
        assert found is not None and np.array_equal(found.drawn_roots, shifted)
    assert opened(path).read(1).placed.posterior is None


def test_it_outlives_its_iteration(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "run.sqlite"
    inputs, problem, steps, posterior = made
    with RecordingWriter(path, inputs, problem.mrf.model, max_bytes=1) as writer:
        for step in steps:
            writer.write(step.report, step.state, posterior=posterior)
    with Recording(path) as recording:
        assert recording.iterations() == [0, 3]
        assert_same(recording.posterior(2), posterior)
        # and belongs to no other
        assert recording.posterior(0) is None and recording.posterior(3) is None
        with pytest.raises(RecordingError, match=r"iteration 2 of recording 'run.sqlite' was thinned out"):
            recording.report(2)


def test_it_is_kept_with_an_iteration_that_was_recorded_before(made: Made, tmp_path: Path) -> None:
    inputs, problem, steps, posterior = made
    with RecordingWriter(tmp_path / "run.sqlite", inputs, problem.mrf.model) as writer:
        for step in steps:
            writer.write(step.report, step.state)
        writer.keep(posterior)
    with Recording(tmp_path / "run.sqlite") as recording:
        assert_same(recording.posterior(2), posterior)
        assert_same(recording.report(2), steps[2].report)


def test_draws_of_many_sizes_come_back(made: Made, tmp_path: Path, rng: np.random.Generator) -> None:
    sizes, stds = rng.normal(0, 0.02, (len(made[3].mode), 3)), np.linspace(0.0, 0.02, 10)
    told = replace(made[3], drawn_sizes=sizes, nuisance_stds=stds)
    path = recorded(tmp_path / "run.sqlite", (*made[:3], told))
    with Recording(path) as recording:
        found = recording.posterior(2)
    assert found is not None
    np.testing.assert_array_equal(found.drawn_sizes, sizes)
    np.testing.assert_array_equal(found.nuisance_stds, stds)


def test_a_recording_of_before_is_told_with_draws_that_are_made_again(made: Made, tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.sqlite", made)
    connection = sqlite3.connect(path)
    connection.execute("DELETE FROM arrays WHERE name LIKE 'posterior.%'")
    connection.commit()
    connection.close()
    assert_same(opened(path).read(3).placed.posterior, made[3])


Alter = Callable[[Posterior], Posterior]
WRONG: dict[str, Alter] = {
    "poses of no length": lambda one: replace(one, drawn_roots=np.zeros_like(one.drawn_roots)),
    "draws without a number": lambda one: replace(one, drawn_joints=np.full_like(one.drawn_joints, np.nan)),
    "draws beyond all squares": lambda one: replace(one, drawn_joints=np.full_like(one.drawn_joints, 1e308)),
    "a middle beyond all squares": lambda one: replace(
        one, centre=Centre(root=one.root, joints=np.full_like(one.joints, 1e308), nuisances=None)
    ),
    "another model's joints": lambda one: replace(one, drawn_joints=one.drawn_joints[:, :1]),
    "sizes of another count": lambda one: replace(one, drawn_sizes=np.zeros((len(one.mode), 2))),
    "draws turned inside out": lambda one: replace(one, drawn_sizes=np.full((len(one.mode), 3), -1.5)),
    "deviations of other nuisances": lambda one: replace(one, nuisance_stds=np.zeros(3)),
    "deviations below nought": lambda one: replace(one, nuisance_stds=np.full(10, -0.1)),
    "weights of more than one": lambda one: replace(one, log_weights=np.zeros_like(one.log_weights)),
    "one weight for all": lambda one: replace(one, log_weights=np.zeros(())),
    "a mode that is none": lambda one: replace(one, mode=one.mode + 7),
    "modes in fractions": lambda one: replace(one, mode=one.mode + 0.5),
    "no modes": lambda one: replace(one, modes=()),
    "modes of no weight": lambda one: replace(one, modes=tuple(replace(mode, weight=0.0) for mode in one.modes)),
    "more effective draws than draws": lambda one: replace(one, effective_sample_size=1e9),
    "a verdict that is none": lambda one: replace(one, fit=replace(one.fit, verdict="splendid")),  # type: ignore[arg-type]
    "a reason that is no text": lambda one: replace(one, fit=replace(one.fit, reason=7)),  # type: ignore[arg-type]
    "more than all explained": lambda one: replace(one, fit=replace(one.fit, explained=7.0)),
}


@pytest.mark.parametrize("alter", list(WRONG.values()), ids=list(WRONG))
def test_one_from_elsewhere_that_does_not_fit_is_refused(made: Made, alter: Alter) -> None:
    with pytest.raises(RecordingError, match="the posterior of iteration 2 does not fit the model of its recording"):
        check_posterior_fits(made[1], alter(made[3]))


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b'{"verdict": "good"}', b"\xff"])
def test_a_fit_that_cannot_be_read_is_damage(made: Made, tmp_path: Path, text: bytes) -> None:
    path = recorded(tmp_path / "run.sqlite", made)
    altered(path, 2, fit=np.frombuffer(text, dtype=np.uint8))
    with (
        Recording(path) as recording,
        pytest.raises(RecordingError, match=r"'run.sqlite' is damaged: the posterior of iteration 2 cannot be read"),
    ):
        recording.posterior(2)
