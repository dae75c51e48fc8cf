"""Does a recording from elsewhere cost no more than its own model makes it, whatever its arrays say they are?

A few kilobytes of it unpack to gigabytes; here 64 MiB of zeros stand for them, where the model makes some kilobytes.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.errors import IterationError, RecordingError
from pmpnbp.readout.snapshot import Criteria
from pmpnbp.recording import IterationArchive, Recording
from pmpnbp.recording.array_shapes import LARGEST_ITERATION, ArrayShapes, array_shapes
from pmpnbp.recording.arrays import to_arrays
from pmpnbp.recording.posteriors import posterior_arrays
from pmpnbp.recording.schema import pack
from tests.app.scenes import scene
from tests.readout.test_particle_terms import iterations

OLD = Path(__file__).parent / "before" / "format_2.sqlite"
BOMB = 64 << 20


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A recording of iterations 0 to 5 of four parts with eight particles each."""
    return Path(shutil.copy(OLD, tmp_path / "recording.sqlite"))


def alter(path: Path, script: str, *values: Any) -> None:
    connection = sqlite3.connect(path)
    connection.execute(script, values)
    connection.commit()
    connection.close()


def put(path: Path, iteration: int, name: str, dtype: str, shape: Any, data: bytes) -> None:
    alter(path, "INSERT OR REPLACE INTO arrays VALUES (?, ?, ?, ?, ?)", iteration, name, dtype, json.dumps(shape), data)


def opened(path: Path) -> IterationArchive:
    archive = IterationArchive(path, "recording 'hostile'", foreign_row=lambda text, model: None)
    archive.open(Criteria(max_std=0.0025))
    return archive


def peak(call: Any) -> int:
    """The most memory that a call takes, bytes."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("name", "dtype", "shape"),
    [
        ("belief.poses", "<f8", [4, BOMB // 32]),
        ("belief.poses", "<f8", [4, BOMB // 224, 7]),
        ("belief.log_weights", "<f8", [4, BOMB // 32]),
        ("rivals", "<f8", [BOMB // 80, 10]),
        ("state.belief.poses", "<f8", [4, BOMB // 224, 7]),
        ("anything", "|u1", [BOMB]),
        ("belief.source", "|u1", [4, BOMB // 4]),
        ("temperature", f"|V{BOMB // 4}", [4]),
        ("mle_joints", "<f8", [0, 3]),
    ],
)
def test_a_bomb_is_damage_before_it_goes_off(path: Path, name: str, dtype: str, shape: list[int]) -> None:
    size = np.dtype(dtype).itemsize * int(np.prod(shape))
    put(path, 3, name, dtype, shape, zlib.compress(bytes(size), 1))
    archive = opened(path)
    assert archive.iteration == 5

    def read() -> None:
        with pytest.raises(IterationError, match="iteration 3"):
            archive.read(3)

    assert peak(read) < BOMB // 8
    assert archive.read(2).iteration == 2


def test_a_posterior_may_be_the_bomb(path: Path) -> None:
    put(path, 3, "posterior.drawn_roots", "<f8", [BOMB // 56, 7], zlib.compress(bytes(BOMB // 56 * 56), 1))
    with Recording(path) as recording:
        recording.distrust()

        def read() -> None:
            with pytest.raises(RecordingError, match="iteration 3 does not fit the model of its recording"):
                recording.posterior(3)

        assert peak(read) < BOMB // 8


def test_the_newest_iteration_may_be_the_bomb(path: Path) -> None:
    put(path, 5, "belief.poses", "<f8", [4, BOMB // 224, 7], zlib.compress(bytes(BOMB // 224 * 224), 1))
    assert peak(lambda: opened(path).close()) < BOMB // 2  # a model is read
    assert opened(path).iteration == 4


def test_what_is_packed_in_more_than_it_unpacks_to_is_not_read(path: Path) -> None:
    put(path, 3, "mle_joints", "<f8", [3], zlib.compress(bytes(24)) + bytes(BOMB))
    archive = opened(path)

    def read() -> None:
        with pytest.raises(IterationError, match="iteration 3"):
            archive.read(3)

    assert peak(read) < BOMB // 8


@pytest.mark.parametrize(
    ("script", "says"),
    [
        (
            "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n WHERE x < 2000) "
            "INSERT INTO notes SELECT x, 'hello' FROM n",
            "has more than 1000 rows of notes, which no recording has",
        ),
        ("INSERT INTO notes VALUES (1, printf('%.*c', 2000000, 'x'))", "has more than 1048576 bytes of notes"),
        ("INSERT INTO model SELECT * FROM model", "has more than 1 rows of model"),
        ("UPDATE inputs SET value = '[' || printf('%.*c', 5000000, ' ') || ']'", "its inputs cannot be read"),
        ("UPDATE inputs SET value = '40000' WHERE name = 'particles'", "its model or scans cannot be read"),
        ("UPDATE inputs SET value = '-1' WHERE name = 'seed'", "its model or scans cannot be read"),
        ("UPDATE scans SET shape = '[8192, 8192]'", "its model or scans cannot be read"),
        ("UPDATE scans SET frame_id = x'ff00'", "its model or scans cannot be read"),
        ("UPDATE model SET file_name = '..'", "its model or scans cannot be read"),
    ],
)
def test_more_than_a_recording_says_is_refused(path: Path, script: str, says: str) -> None:
    alter(path, script)
    with pytest.raises(RecordingError, match=says):
        opened(path).read()


def test_what_the_program_makes_fits() -> None:
    """Every array of iterations of both products, and of one with a posterior, as a recording would say it."""
    for product in ("shared", "pooled"):
        problem, reports = iterations("gaussian", product)
        shapes = array_shapes(problem.mrf.model, problem.particles, len(problem.observation.views))
        for report in reports:
            check(shapes, to_arrays(report, _state_of(report)))
    last = scene().snapshots[-1]
    posterior = last.placed.posterior
    assert posterior is not None
    problem = last.problem
    check(
        array_shapes(problem.mrf.model, problem.particles, len(problem.observation.views)), posterior_arrays(posterior)
    )


def test_all_arrays_together_are_bounded_too() -> None:
    count = LARGEST_ITERATION // 8
    shapes = ArrayShapes({"a": ("f", (count,)), "b": ("f", (count,))})
    shapes.check([("a", "<f8", json.dumps([count]), 1000)])
    with pytest.raises(ValueError, match="b: "):
        shapes.check([("a", "<f8", json.dumps([count]), 1000), ("b", "<f8", "[1]", 20)])
    with pytest.raises(ValueError, match="a: "):
        shapes.check([("a", "<f8", "[1]", 20), ("a", "<f8", "[1]", 20)])


def check(shapes: ArrayShapes, arrays: dict[str, Any]) -> None:
    packed = {name: pack(array) for name, array in arrays.items()}
    shapes.check((name, dtype, shape, len(data)) for name, (dtype, shape, data) in packed.items())


def _state_of(report: Any) -> Any:
    from pmpnbp.inference.belief import State

    return State(iteration=report.iteration, belief=report.belief, messages=report.messages, rivals=report.rivals)
