"""A recording made before is read as it was: the rows that its session wrote are those that its iterations give today.

`before/format_2.sqlite` is a session's, written by version 0.1.0 in November 2026: the sample cabinet, eight particles,
six iterations, settings changed after the third.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.errors import RecordingError
from pmpnbp.inference import run
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.belief import SOURCES
from pmpnbp.readout.snapshot import Criteria
from pmpnbp.recording import Change, IterationArchive, Recording, RecordingWriter
from pmpnbp.settings import SessionOptions

OLD = Path(__file__).parent / "before" / "format_2.sqlite"
CRITERIA = Criteria(max_std=0.0025)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return Path(shutil.copy(OLD, tmp_path / "recording.sqlite"))


def test_its_iterations_give_the_rows_that_it_was_written_with(path: Path) -> None:
    """But for the last digits, which another processor may round differently."""
    with Recording(path) as recording:
        written = [json.loads(text) for text in recording.summaries()]
    archive = IterationArchive(path, "recording 'old'", foreign_row=lambda text, model: None)
    archive.open(CRITERIA)
    made = [json.loads(row) for row in archive.rows()]
    assert {row["stage"] for row in made} == {"start", "search", "belief propagation", "refine"}
    for mine, theirs in zip(made, written, strict=True):
        for name in ("iteration", "stage", "seconds", "tolerance", "converged", "notes"):
            assert mine[name] == theirs[name], name
        scores = (mine["log_likelihood"] or 0.0), (theirs["log_likelihood"] or 0.0)  # the start has none
        assert scores[0] == pytest.approx(scores[1], rel=1e-9)
        assert mine["effective_sample_size"] == pytest.approx(theirs["effective_sample_size"], rel=1e-9)
        # what was called the standard deviation then was the particles', by which nothing is certain
        for link, axes in theirs["std_xyz"].items():
            assert mine["particle_std_xyz"][link] == pytest.approx(axes, rel=1e-6, abs=1e-12), link
        assert mine["std_xyz"] is None and not mine["certain"] and mine["certain_by_link"] is None


def test_rows_that_do_not_tell_which_links_were_certain_say_so(path: Path) -> None:
    """Those of the time before posteriors, and those that tell of one."""
    with Recording(path) as recording:
        old = json.loads(recording.summaries()[-1])
    told = old | {"particle_std_xyz": old["std_xyz"], "posterior_iteration": old["iteration"]}
    connection = sqlite3.connect(path)
    connection.execute("UPDATE summaries SET text = ? WHERE iteration = ?", (json.dumps(told), old["iteration"]))
    connection.commit()
    connection.close()
    archive = IterationArchive(path, "session 'old'")
    archive.open(CRITERIA)
    rows = [json.loads(row) for row in archive.rows()]
    assert [row["certain_by_link"] for row in rows] == [None] * len(rows)
    assert [rows[0]["phase"], rows[-1]["phase"]] == ["searching", "at rest" if old["converged"] else "settling"]
    assert [row["std_xyz"] for row in rows] == [None] * (len(rows) - 1) + [old["std_xyz"]]
    assert archive.row == rows[-1]


def test_it_is_gone_on_with_by_a_scan_that_replaces(path: Path, tmp_path: Path) -> None:
    """It is older than modes; what was changed before stays as it was."""
    with Recording(path) as recording:
        before = recording.changes()
        scan = recording.restored_inputs(tmp_path).scans[0]
    with RecordingWriter.appending(path) as writer:
        writer.change(Change(6, scan=scan, mode="replaces"))
    with Recording(path) as recording:
        after = recording.changes()
        assert [change.mode for change in after] == [*(change.mode for change in before), "replaces"]
        assert [change.settings for change in after[:-1]] == [change.settings for change in before]
        assert recording.problem().arrival == Arrival(6, 0, 1)


def test_a_mode_that_there_is_none_of_is_damage(path: Path, tmp_path: Path) -> None:
    with Recording(path) as recording:
        scan = recording.restored_inputs(tmp_path).scans[0]
    with RecordingWriter.appending(path) as writer:
        writer.change(Change(6, scan=scan))
    connection = sqlite3.connect(path)
    connection.execute("UPDATE changes SET mode = 'hides' WHERE scan IS NOT NULL")
    connection.commit()
    connection.close()
    with Recording(path) as recording, pytest.raises(RecordingError, match="damaged: its changes cannot be read"):
        recording.changes()


def test_its_arrays_are_where_they_were(path: Path) -> None:
    with Recording(path) as recording:
        report = recording.report(4)
        parts = recording.parts
    assert parts == ("frame", "drawer1", "drawer2", "drawer3")
    belief, messages = report.belief, report.messages
    assert belief.poses.shape == (4, 8, 7) and belief.poses.dtype == np.float64
    np.testing.assert_allclose(np.exp(belief.log_weights).sum(axis=1), 1)
    np.testing.assert_allclose(np.linalg.norm(belief.poses[..., 3:], axis=-1), 1)
    assert {SOURCES[source] for source in np.unique(belief.origin.source)} <= {"own", "neighbour"}
    assert messages is not None
    np.testing.assert_allclose(np.exp(messages.log_weights).sum(axis=1), 1)
    assert [(int(s), int(r)) for s, r in zip(messages.sender, messages.receiver, strict=True)] == [
        (0, 1),
        (1, 0),
        (0, 2),
        (2, 0),
        (0, 3),
        (3, 0),
    ]


def test_its_inputs_and_changes_are_those_it_was_made_with(path: Path, tmp_path: Path) -> None:
    with Recording(path) as recording:
        inputs = recording.restored_inputs(tmp_path)
        settings = [recording.settings(number).joint_draws for number in range(7)]
        # which was not kept then
        assert recording.max_std() == SessionOptions.max_std
    assert settings == [8, 8, 8, 8, 3, 3, 3]
    assert inputs.roi is not None
    assert inputs.roi.tolist() == [-0.0822, -0.1926, -0.1, 0.8932, 0.7035, 0.85]
    assert (inputs.particles, inputs.seed, inputs.method) == (8, 11, "pmpnbp")


def test_it_is_gone_on_with(path: Path) -> None:
    archive = IterationArchive(path, "session 'old'")
    assert [json.loads(change.note)["config"] for change in archive.open(CRITERIA)] == [{"joint_draws": 3}]
    step = run.following(archive.resume(), archive.problem(6))
    assert step.iteration == 6 and np.isfinite(step.report.belief.poses).all()
