"""A recording is gone on with from its last whole iteration, and what was changed on the way is done again as well."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmpnbp.errors import RecordingError
from pmpnbp.inference import run
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.inference.problem import Problem
from pmpnbp.recording import Change, Inputs, Recording, RecordingWriter, make_whole
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.sameness import assert_same

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"
# Small enough to be quick: what is recorded has the same form.
QUICK = {
    "image_width": 80,
    "triangles": 60,
    "splat_points": 64,
    "search_iterations": 2,
    "search_proposals": 300,
    "search_islands": 1,
    "search_restarts": 0,
    "anneal_iterations": 2,
    "refine_iterations": 1,
}
Made = tuple[IterationReport, State]


def scan_of(scene: str) -> Any:
    return load_scan(CABINET / scene / "depth.png", CABINET / scene / "camera.json")


@pytest.fixture(scope="module")
def inputs() -> Inputs:
    roi = np.array(json.loads((CABINET / "open" / "roi.json").read_text())["roi"])
    settings = changed(preset("robust"), QUICK)
    return Inputs(CABINET / "cabinet.urdf", (scan_of("open"),), roi, UniformPrior(), settings, 40, 11)


def later(inputs: Inputs, changes: Sequence[Change], iteration: int) -> Inputs:
    """What iteration `iteration` is made with: the slow, obvious twin of the reader."""
    moves = 0
    for change in changes:
        if change.after_iteration < iteration:
            inputs = replace(inputs, settings=change.settings or inputs.settings)
            if change.scan is not None:
                kept = inputs.scans if change.mode == "joins" else ()
                moves += change.mode == "replaces"
                arrival = Arrival(change.after_iteration, len(kept), moves)
                inputs = replace(inputs, scans=(*kept, change.scan), arrival=arrival)
    return inputs


def iterations_of(inputs: Inputs, changes: Sequence[Change], count: int) -> list[Made]:
    state, report = run.begin(inputs.problem())
    made = [(report, state)]
    for number in range(1, count + 1):
        state, report = run.advance(state, later(inputs, changes, number).problem())
        made.append((report, state))
    return made


@pytest.fixture(scope="module")
def changes(inputs: Inputs) -> list[Change]:
    finer = changed(inputs.settings, {"joint_draws": 3, "splat_points": 96})
    longer = changed(finer, {"image_width": 100})
    return [Change(2, settings=finer, note="finer"), Change(3, scan=scan_of("second_view")), Change(3, settings=longer)]


@pytest.fixture(scope="module")
def made(inputs: Inputs, changes: list[Change]) -> list[Made]:
    return iterations_of(inputs, changes, 6)


def recorded(path: Path, inputs: Inputs, made: Sequence[Made], changes: Sequence[Change] = ()) -> Path:
    with RecordingWriter(path, inputs, inputs.problem().mrf.model) as writer:
        write(writer, made, changes)
    return path


def write(writer: RecordingWriter, made: Sequence[Made], changes: Sequence[Change]) -> None:
    for report, state in made:
        writer.write(report, state, f"row {report.iteration}")
        for change in changes:
            if change.after_iteration == report.iteration:
                writer.change(change)


def test_any_iteration_is_done_again_with_what_it_was_made_with(
    tmp_path: Path, inputs: Inputs, changes: list[Change], made: list[Made]
) -> None:
    with Recording(recorded(tmp_path / "run.sqlite", inputs, made, changes)) as recording:
        assert recording.iterations() == [0, 1, 2, 3, 4, 5, 6]
        for number in range(6):
            state, report = run.advance(recording.state(number), recording.problem(number + 1))
            assert_same(state, made[number + 1][1])
            assert_same(report, made[number + 1][0], without=("seconds",))
        assert [recording.settings(number).joint_draws for number in (1, 2, 3, 4)] == [8, 8, 3, 3]
        assert [len(recording.problem(number).observation.views) for number in (3, 4)] == [1, 2]
        assert recording.settings() == changes[2].settings
        assert [change.note for change in recording.changes()] == ["finer", "", ""]
        assert_same(recording.changes()[1].scan, changes[1].scan)
        # a change does something: with the problem of before, other numbers come out
        _, other = run.advance(recording.state(3), recording.problem(3))
        assert other.belief.log_unary.tobytes() != made[4][0].belief.log_unary.tobytes()


def test_a_scan_that_replaces_is_replayed_too(tmp_path: Path, inputs: Inputs) -> None:
    """The scene changes amid a search that began again, and once more after it: every iteration is done again, also
    from a file that was gone on with, and none remembers the scans that are gone."""
    second, third = scan_of("second_view"), scan_of("arm")
    came = [Change(2, scan=second), Change(3, scan=third, mode="replaces"), Change(7, scan=second, mode="replaces")]
    made = iterations_of(inputs, came, 9)
    assert [state.search_after for _, state in made] == [0, 0, 0, 2, 3, 3, 3, 3, 7, 7]
    assert all(report.search_after == state.search_after for report, state in made)
    path = recorded(tmp_path / "run.sqlite", inputs, made[:6], came)
    with RecordingWriter.appending(path) as writer:
        write(writer, made[6:], came)
    with Recording(path) as recording:
        assert [change.mode for change in recording.changes()] == ["joins", "replaces", "replaces"]
        assert [len(recording.problem(number).observation.views) for number in (2, 3, 4, 8)] == [1, 2, 1, 1]
        for number in range(9):
            assert_same(recording.report(number), made[number][0])
            state, report = run.advance(recording.state(number), recording.problem(number + 1))
            assert_same(state, made[number + 1][1])
            assert_same(report, made[number + 1][0], without=("seconds",))


def test_inputs_of_an_iteration_come_back(
    tmp_path: Path, inputs: Inputs, changes: list[Change], made: list[Made]
) -> None:
    with Recording(recorded(tmp_path / "run.sqlite", inputs, made, changes)) as recording:
        (tmp_path / "model").mkdir()
        first = recording.restored_inputs(tmp_path / "model", 2)
        assert (len(first.scans), first.settings) == (1, inputs.settings)
        last = recording.restored_inputs(tmp_path / "model")
        assert (len(last.scans), last.settings) == (2, changes[2].settings)


def test_a_recording_is_gone_on_with(tmp_path: Path, inputs: Inputs, changes: list[Change], made: list[Made]) -> None:
    """Written in three goes it holds the same, to the bit, as written in one."""
    whole = recorded(tmp_path / "whole.sqlite", inputs, made, changes)
    pieces = recorded(tmp_path / "pieces.sqlite", inputs, made[:3], changes)
    for first, last in ((3, 4), (4, 7)):
        assert make_whole(pieces) == first - 1
        with RecordingWriter.appending(pieces) as writer:
            write(writer, made[first:last], changes)
    tables = ("inputs", "scans", "iterations", "arrays", "summaries", "changes", "notes")
    for table in tables:
        contents = []
        for path in (whole, pieces):
            with sqlite3.connect(path) as connection:
                contents.append(sorted(connection.execute(f"SELECT * FROM {table}").fetchall(), key=repr))
            connection.close()
        assert contents[0] == contents[1], table
    assert not list(tmp_path.glob("*-wal"))


def test_written_is_told_once_it_is_there_and_in_order(tmp_path: Path, inputs: Inputs, made: list[Made]) -> None:
    path, told = tmp_path / "run.sqlite", []

    def there() -> None:
        with Recording(path) as recording:
            told.append(recording.newest())

    with RecordingWriter(path, inputs, inputs.problem().mrf.model) as writer:
        for report, state in made:
            writer.write(report, state, None, there)
        writer.flush()
        assert told == [0, 1, 2, 3, 4, 5, 6]
        with Recording(path) as recording:
            assert recording.summaries() == [] and recording.summary(3) is None


def test_summaries_are_kept(tmp_path: Path, inputs: Inputs, made: list[Made]) -> None:
    with Recording(recorded(tmp_path / "run.sqlite", inputs, made)) as recording:
        assert recording.summaries(4) == ["row 5", "row 6"]
        assert recording.summary(0) == "row 0" and recording.summary(7) is None


@pytest.mark.parametrize("damage", ["array", "rows", "cut short"])
def test_a_damaged_tail_is_left_out(
    damage: str, tmp_path: Path, inputs: Inputs, changes: list[Change], made: list[Made]
) -> None:
    path = recorded(tmp_path / "run.sqlite", inputs, made, changes)
    if damage == "cut short":
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    else:
        query = {
            "array": "UPDATE arrays SET data = x'00' WHERE iteration = 5 AND name = 'belief.poses'",
            "rows": "DELETE FROM arrays WHERE iteration > 4 AND name LIKE 'belief%'",
        }[damage]
        connection = sqlite3.connect(path)
        connection.execute(query)
        if damage == "array":
            connection.execute("DELETE FROM arrays WHERE iteration = 6")
        connection.commit()
        connection.close()
    whole = make_whole(path)
    # the further scan, added after iteration 3, was cut off with it
    assert whole == (3 if damage == "cut short" else 4)
    assert make_whole(path) == whole  # and now there is nothing to be done
    with RecordingWriter.appending(path) as writer:
        for change in changes[1:] if damage == "cut short" else ():
            writer.change(change)
        for report, state in made[whole + 1 :]:
            writer.write(report, state)
    with Recording(path) as recording:
        assert recording.sound()
        assert recording.notes() == [f"what came after iteration {whole} was damaged and is left out"]
        assert recording.iterations() == [0, 1, 2, 3, 4, 5, 6]
        assert recording.summaries() == [f"row {number}" for number in range(whole + 1)]
        for report, state in made:
            assert_same(recording.report(report.iteration), report)
            assert_same(recording.state(report.iteration), state)
        # they belong to their iterations, those too that were lost and made again
        assert [change.after_iteration for change in recording.changes()] == [2, 3, 3]
    assert [left.name for left in tmp_path.iterdir()] == ["run.sqlite"]


def test_a_log_that_a_killed_writer_left_is_read(tmp_path: Path, inputs: Inputs, made: list[Made]) -> None:
    path = tmp_path / "run.sqlite"
    with RecordingWriter(path, inputs, inputs.problem().mrf.model) as writer:
        write(writer, made, ())
        writer.flush()
        killed = tmp_path / "killed.sqlite"
        for end in ("", "-wal"):
            killed.with_name(killed.name + end).write_bytes(path.with_name(path.name + end).read_bytes())
    log = killed.with_name("killed.sqlite-wal")
    log.write_bytes(log.read_bytes()[:-1000])  # the last commit did not reach the disk
    assert make_whole(killed) == 5
    with RecordingWriter.appending(killed) as writer:
        write(writer, made[6:], ())
    with Recording(killed) as recording:
        assert recording.iterations() == [0, 1, 2, 3, 4, 5, 6]
        assert_same(recording.state(6), made[6][1])


def test_what_cannot_be_gone_on_with_is_said(tmp_path: Path, inputs: Inputs, made: list[Made]) -> None:
    path = recorded(tmp_path / "run.sqlite", inputs, made[:2])
    connection = sqlite3.connect(path)
    connection.execute("DELETE FROM arrays")
    connection.commit()
    connection.close()
    with pytest.raises(RecordingError, match=r"'run.sqlite' is damaged: none of its iterations is whole"):
        make_whole(path)
    with pytest.raises(RecordingError, match=r"'none.sqlite' is not there"):
        make_whole(tmp_path / "none.sqlite")


def test_thinning_out_goes_on_where_it_was(tmp_path: Path, inputs: Inputs, made: list[Made]) -> None:
    report, state = made[6]
    many = [(replace(report, iteration=number), replace(state, iteration=number)) for number in range(60)]
    path = recorded(tmp_path / "run.sqlite", inputs, [])
    limit = path.stat().st_size + 300_000
    for first in range(0, 60, 7):
        with RecordingWriter.appending(path, max_bytes=limit) as writer:
            write(writer, many[first : first + 7], ())
    with Recording(path) as recording:
        there = recording.iterations()
        stride = there[1]
        assert stride in (2, 4, 8, 16)
        # those that were the newest when a writer began may have stayed
        assert set(there) >= {*range(0, 60, stride), 59}
        assert [number for number in there if number % stride] == [59]
        assert len(recording.summaries()) == 60


def test_a_recording_of_the_first_format_is_read_and_gone_on_with(
    tmp_path: Path, inputs: Inputs, changes: list[Change], made: list[Made]
) -> None:
    path = recorded(tmp_path / "run.sqlite", inputs, made[:3])
    connection = sqlite3.connect(path)
    connection.execute("DROP TABLE summaries")
    connection.execute("DROP TABLE changes")
    connection.execute("PRAGMA user_version = 1")
    connection.commit()
    connection.close()
    with Recording(path) as recording:
        assert recording.changes() == [] and recording.summaries() == [] and recording.summary(1) is None
        assert_same(recording.state(2), made[2][1])
        assert len(recording.problem(2).observation.views) == 1
    assert make_whole(path) == 2
    with RecordingWriter.appending(path) as writer:
        writer.change(changes[0])
        write(writer, made[3:4], ())
    with Recording(path) as recording:
        assert recording.summaries() == ["row 3"]
        assert recording.settings(3) == changes[0].settings
        problem: Problem = recording.problem(3)
        assert_same(run.advance(recording.state(2), problem)[0], made[3][1])
