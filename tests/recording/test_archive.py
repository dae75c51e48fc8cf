"""An archive gives every iteration as it was made, and opens and reads no more of the file than it has to."""

from __future__ import annotations

import json
import math
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.errors import DamageError, IterationError, RecordingError
from pmpnbp.inference import run
from pmpnbp.readout.snapshot import Criteria, snapshot
from pmpnbp.recording import Change, Inputs, IterationArchive, Recording
from pmpnbp.recording.archive import PROBLEMS
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.sameness import assert_same

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"
QUICK = {
    "image_width": 80,
    "triangles": 60,
    "splat_points": 64,
    "search_iterations": 1,
    "search_proposals": 100,
    "search_islands": 1,
    "search_restarts": 0,
    "anneal_iterations": 1,
    "refine_iterations": 1,
}
CRITERIA = Criteria(max_std=0.0025)
# Events are numbered with gaps: a session tells of its state in between.
EVENTS_EACH = 3


class Life:
    """A session's way with its archive: iterations made, written and announced."""

    def __init__(self, path: Path) -> None:
        box = np.array(json.loads((CABINET / "open" / "roi.json").read_text())["roi"])
        scan = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
        self.settings = changed(preset("robust"), QUICK)
        self.inputs = Inputs(CABINET / "cabinet.urdf", (scan,), box, UniformPrior(), self.settings, 12, 3)
        self.archive = IterationArchive(path, "session 'x'")
        self.announced: list[int] = []
        self.begin()

    def begin(self) -> None:
        problem = self.inputs.problem()
        self.step = run.first(problem)
        self.archive.begin(self.inputs, self.step, self._snapshot(problem))

    def iterate(self, count: int) -> None:
        for _ in range(count):
            problem = self.archive.problem(self.step.iteration + 1)
            self.step = run.following(self.step, problem)
            number = self.step.iteration
            self.archive.add(self.step, self._snapshot(problem), lambda number=number: self.announced.append(number))
        self.archive.flush()

    def change(self, **values: Any) -> None:
        self.settings = changed(self.settings, values)
        self.inputs = Inputs(
            self.inputs.model, self.inputs.scans, self.inputs.roi, self.inputs.prior, self.settings, 12, 3
        )
        at = self.archive.next_change(self.step.iteration)
        self.archive.change(Change(at, settings=self.settings), self.inputs.problem())

    def _snapshot(self, problem: Any) -> Any:
        event = EVENTS_EACH * (self.step.iteration + 1)
        return snapshot(problem, self.step.report, CRITERIA, converged=False, elapsed=0.5, event=event)


@pytest.fixture
def life(tmp_path: Path) -> Life:
    return Life(tmp_path / "recording.sqlite")


def opened(path: Path) -> IterationArchive:
    archive = IterationArchive(path, "session 'x'")
    archive.open(CRITERIA)
    return archive


def test_every_iteration_is_given_as_it_was_made(life: Life) -> None:
    made = [life.archive.read()]
    for _ in range(3):
        life.iterate(1)
        made.append(life.archive.read())
    assert life.announced == [1, 2, 3]
    life.archive.close()
    for archive in (life.archive, opened(life.archive.path)):
        for number, one in enumerate(made):
            again = archive.read(number)
            assert_same(again.report, one.report)
            assert (again.row_text, again.result_text) == (one.row_text, one.result_text)
        assert [row.encode() for row in archive.rows()] == [one.row_text for one in made]
        assert [json.loads(row)["iteration"] for row in archive.rows(after=0, last=2)] == [1, 2]
        with pytest.raises(IterationError, match="iteration 4 of session 'x' is not here; it has 0 to 3"):
            archive.read(4)


def test_it_is_gone_on_with_to_the_same_numbers(life: Life, tmp_path: Path) -> None:
    life.iterate(2)
    life.change(joint_draws=3)
    life.archive.close()
    archive = opened(life.archive.path)
    resumed = archive.resume()
    assert len(resumed.recent) == 1  # what came before was made with other settings
    assert_same(resumed.state, life.step.state)
    problem = archive.problem(3)
    assert problem.settings.joint_draws == 3
    life.iterate(1)
    assert_same(run.following(resumed, problem).state, life.step.state)


def test_reading_takes_the_connections_there_are(life: Life, monkeypatch: pytest.MonkeyPatch) -> None:
    life.iterate(3)
    opened_files: list[Path] = []
    original = Recording.__init__

    def counted(self: Recording, path: Path) -> None:
        opened_files.append(path)
        original(self, path)

    monkeypatch.setattr(Recording, "__init__", counted)
    for _ in range(20):
        for number in range(3):
            life.archive.read(number)
        life.archive.rows()
    assert len(opened_files) == 1
    life.archive.close()
    life.begin()  # another file in its place
    life.archive.rows()
    assert len(opened_files) == 2
    assert life.archive.iteration == 0 and len(life.archive.rows()) == 1


def test_a_late_listener_costs_a_few_rows_not_all(life: Life, monkeypatch: pytest.MonkeyPatch) -> None:
    life.iterate(40)
    events = [json.loads(row)["event"] for row in life.archive.rows()]
    expected = {event: [e for e in events if e > event] for event in (0, 1, 3, 4, 59, 60, 61, 122, 123, 999)}
    parsed: list[str] = []
    original = json.loads
    monkeypatch.setattr("pmpnbp.recording.trace_rows.json.loads", lambda text: parsed.append(text) or original(text))
    for event, later in expected.items():
        parsed.clear()
        rows = life.archive.rows_after_event(event)
        bisected = len(parsed)
        assert [original(row)["event"] for row in rows] == later
        assert bisected <= math.ceil(math.log2(len(events) + 1))


def test_few_problems_are_kept(life: Life) -> None:
    for number in range(2, 3 + PROBLEMS):
        life.iterate(1)
        life.change(joint_draws=number)
    life.iterate(1)
    last = life.step.iteration
    assert [life.archive.problem(number).settings.joint_draws for number in range(1, last + 1)] == [
        8,
        *range(2, last + 1),
    ]
    assert len(life.archive._problems) == PROBLEMS
    assert life.archive.problem(last) is life.archive.read(last).problem


def test_a_recording_from_elsewhere_is_read_and_never_written(life: Life) -> None:
    """Rows that are none are made from their iterations; with what they were made with, as `open` finds it."""
    life.iterate(3)
    life.archive.close()
    path = life.archive.path
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM summaries WHERE iteration = 2")
    connection.close()
    before = path.read_bytes()
    archive = IterationArchive(path, "recording 'y'", remedy="delete", foreign_row=lambda text, model: None)
    archive.open(CRITERIA)
    rows = [json.loads(row) for row in archive.rows()]
    assert [row["event"] for row in rows] == [1, 2, 3, 4]
    assert [json.loads(row)["iteration"] for row in archive.rows_after_event(2)] == [2, 3]
    timed = ("event", "elapsed")
    mine = {name: value for name, value in rows[3].items() if name not in timed}
    assert mine == {name: value for name, value in life.archive.read().row.items() if name not in timed}
    archive.close()
    assert path.read_bytes() == before


def test_what_is_damaged_says_what_helps(life: Life) -> None:
    life.archive.close()
    path = life.archive.path
    path.write_bytes(b"nothing of what was there" * 100)
    archive = IterationArchive(path, "session 'x'")
    with pytest.raises(RecordingError, match="is not a recording") as raised:
        archive.open(CRITERIA)
    archive.damage = str(raised.value)
    for call in (archive.read, archive.rows, lambda: archive.rows_after_event(0)):
        with pytest.raises(DamageError, match=r"session 'x' is failed: .*; only reset or delete helps"):
            call()
