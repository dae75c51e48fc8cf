"""Are runs made once each, wherever they are made, and after whatever ended the process that made them?"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

from pmpnbp.errors import RunError
from pmpnbp.runs import workers
from pmpnbp.runs.workers import spread
from tests.reproduce import example_runs

NUMBERS = [{"number": number} for number in range(6)]


def squares(found: list[tuple[Any, Any]]) -> dict[int, int]:
    assert len(found) == len({asked["number"] for asked, _ in found})
    return {asked["number"]: result["square"] for asked, result in found}


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
    with pytest.raises(RunError, match=r"the process of a run was killed 3 times, .*: \{'number': 0\}"):
        list(spread(example_runs.always_killed, NUMBERS, 1))


def test_of_a_run_that_is_killed_each_time_it_is_told_and_the_others_are_made(tmp_path: Path) -> None:
    asked = [{**one, "mark": str(tmp_path)} for one in NUMBERS]
    found = list(spread(example_runs.second_killed, asked, 2, killed=lambda one: {"square": -1, "process": 0}))
    assert squares(found) == {number: -1 if number == 2 else number**2 for number in range(6)}


def test_runs_are_taken_as_there_is_room() -> None:
    taken: list[int] = []

    def asked() -> Iterator[dict[str, int]]:
        for one in NUMBERS:
            taken.append(one["number"])
            yield one

    for done, _ in enumerate(spread(example_runs.squared, asked(), 1), start=1):
        assert len(taken) <= done + 1


def test_what_is_raised_and_cannot_travel_is_told_all_the_same() -> None:
    with pytest.raises(RunError, match="NoTravellerError: a stone that cannot be carried"):
        list(spread(example_runs.failing_with_what_stays, NUMBERS, 1))


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    cores = os.cpu_count() or 1
    for processes in (1, cores):
        ((_, result),) = spread(example_runs.threads, NUMBERS[:1], processes)
        assert result == {"numba": cores // processes, "blas": 1}


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
    monkeypatch.setattr(workers, "PATIENCE", 1)
    with pytest.raises(RunError, match=f"no Dask scheduler answers at '{address}'"):
        list(spread(example_runs.squared, NUMBERS, on=address))


@pytest.mark.parametrize("address", ["tcp://", "nowhere://x:1", "", "x", "tcp://x:y", "a b:1"])
def test_what_is_no_address_is_told(address: str) -> None:
    with pytest.raises(RunError, match=f"'{address}' is no address of a Dask scheduler; expected one like tcp://"):
        list(spread(example_runs.squared, NUMBERS, on=address))
