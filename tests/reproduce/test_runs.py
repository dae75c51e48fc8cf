"""Are runs made once each, wherever they are made, kept as they come, and gone on with after whatever ended them?"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

from benchmarks.reproduce import spread as spread_module
from benchmarks.reproduce.experiment import Experiment, Options, make
from benchmarks.reproduce.run_log import NAME, ReproduceError, RunLog
from benchmarks.reproduce.spread import spread
from tests.reproduce import example_runs

NUMBERS = [{"number": number} for number in range(6)]


def squares(found: list[tuple[Any, Any]]) -> dict[int, int]:
    assert len(found) == len({asked["number"] for asked, _ in found})
    return {asked["number"]: result["square"] for asked, result in found}


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
    with pytest.raises(ReproduceError, match=r"runs.jsonl' holds runs of .*, and this is robot .*--out"):
        RunLog(tmp_path, "robot")
    assert (tmp_path / NAME).read_text() == head


@pytest.mark.parametrize("processes", [1, 2])
def test_runs_are_made_in_processes_of_their_own(processes: int) -> None:
    found = list(spread(example_runs.squared, NUMBERS, processes))
    assert squares(found) == {number: number**2 for number in range(6)}
    made_in = {result["process"] for _, result in found}
    assert os.getpid() not in made_in and len(made_in) <= processes


def test_a_process_that_is_killed_is_replaced(tmp_path: Path) -> None:
    asked = [{**one, "mark": str(tmp_path / "mark")} for one in NUMBERS]
    assert squares(list(spread(example_runs.killed_once, asked, 2))) == {number: number**2 for number in range(6)}


def test_processes_that_are_killed_again_and_again_end_it_in_a_sentence() -> None:
    with pytest.raises(ReproduceError, match="processes were killed 3 times; 6 runs are left"):
        list(spread(example_runs.always_killed, NUMBERS, 1))


def test_what_a_run_raises_is_heard() -> None:
    with pytest.raises(ValueError, match="a stone in the gears"):
        list(spread(example_runs.failing, NUMBERS, 1))


@pytest.fixture
def cluster() -> Iterator[distributed.LocalCluster]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


def test_runs_are_spread_over_workers_that_are_killed_and_come_back(
    tmp_path: Path, cluster: distributed.LocalCluster
) -> None:
    asked = [{"number": number, "folder": str(tmp_path)} for number in range(20)]
    found = []
    for one in spread(example_runs.waiting_for_a_third, asked, on=cluster.scheduler_address):
        found.append(one)
        if len(found) == 4:
            os.kill(one[1]["process"], signal.SIGKILL)  # its nanny starts another
    assert squares(found) == {number: number**2 for number in range(20)}
    begun_in = {name.name.split("-")[1] for name in tmp_path.iterdir()}
    assert len(begun_in) == 3


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "127.0.0.1:1"])
def test_a_scheduler_that_is_not_there_is_told(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spread_module, "PATIENCE", 1)
    with pytest.raises(ReproduceError, match=f"no Dask scheduler answers at '{address}'"):
        list(spread(example_runs.squared, NUMBERS, on=address))


@pytest.mark.parametrize("address", ["tcp://", "nowhere://x:1", "", "x", "tcp://x:y", "a b:1"])
def test_what_is_no_address_is_told(address: str) -> None:
    with pytest.raises(
        ReproduceError, match=f"'{address}' is no address of a Dask scheduler; expected one like tcp://"
    ):
        list(spread(example_runs.squared, NUMBERS, on=address))


def test_an_experiment_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    written: list[RunLog] = []
    options = Options(tmp_path)

    def stage(_: Options, run_log: RunLog) -> list[dict[str, Any]]:
        return [{**one, "folder": str(tmp_path)} for one in NUMBERS[:4]]

    def interrupted(_: Options, run_log: RunLog) -> list[dict[str, Any]]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("push", Experiment(example_runs.slow, (stage, interrupted), lambda _, run_log: None), options)
    make("push", Experiment(example_runs.always_killed, (stage,), lambda _, run_log: written.append(run_log)), options)
    assert [written[0].get(one) is not None for one in stage(options, written[0])] == [True] * 4
