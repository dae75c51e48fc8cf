"""Are runs kept as they come, and told apart from those of something else?"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pmpnbp.errors import RunError
from pmpnbp.runs.run_log import NAME, RunLog

NUMBERS = [{"number": number} for number in range(3)]


def test_a_ledger_keeps_what_was_run(tmp_path: Path) -> None:
    run_log = RunLog(tmp_path / "new" / "folder", "robot")
    run_log.add({"scene": "open", "seed": 1}, {"add": [0.1, None]})
    again = RunLog(tmp_path / "new" / "folder", "robot")
    assert again.get({"seed": 1, "scene": "open"}) == {"add": [0.1, None]}
    assert again.get({"seed": 2, "scene": "open"}) is None


@pytest.mark.parametrize("cut", [2, 7, 20])
def test_a_line_that_was_cut_off_is_run_again(tmp_path: Path, cut: int) -> None:
    run_log = RunLog(tmp_path, "robot")
    for asked in NUMBERS[:3]:
        run_log.add(asked, {"square": 0})
    text = run_log.path.read_text()
    run_log.path.write_text(text[:-cut])
    again = RunLog(tmp_path, "robot")
    assert [again.get(asked) is None for asked in NUMBERS[:3]] == [False, False, True]
    again.add(NUMBERS[2], {"square": 4})
    assert [json.loads(line) for line in run_log.path.read_text().splitlines()][1:] == [
        {"asked": asked, "result": {"square": square}} for asked, square in zip(NUMBERS, (0, 0, 4), strict=False)
    ]


@pytest.mark.parametrize("head", ['{"experiment": "push", "version": "0"}\n', '"rubbish"\n', "[1]\n"])
def test_runs_of_something_else_are_not_mixed_in(tmp_path: Path, head: str) -> None:
    (tmp_path / NAME).write_text(head)
    with pytest.raises(RunError, match=r"runs.jsonl' holds runs of .*, and this is robot .*--out"):
        RunLog(tmp_path, "robot")
    assert (tmp_path / NAME).read_text() == head
