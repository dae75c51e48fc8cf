"""Where are runs made? One after the other in a process of their own, in several, or on other machines through Dask.

What is asked for is taken one by one as there is room, so that it need not all be in memory at once; it travels to
where the run is made, and so does what came of it.
"""

from __future__ import annotations

import importlib
import logging
import re
import sys
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from multiprocessing.connection import wait
from types import ModuleType
from typing import Any, TypeVar

from pmpnbp.errors import RunError
from pmpnbp.runs.processes import KilledError, RunProcess, share_cores

Asked = TypeVar("Asked")
Result = TypeVar("Result")

# How often a run is begun whose process is killed.
ATTEMPTS = 3
# Seconds that a Dask scheduler may take to answer.
PATIENCE = 10
# Runs for each of the workers' threads that are with the scheduler: the next one is there when one ends.
AHEAD = 2
ADDRESS = re.compile(r"((tcp|tls|wss?)://)?([\w.-]+|\[[0-9a-fA-F:]+\]):[0-9]{1,5}")


def spread(
    perform: Callable[[Asked], Result],
    asked: Iterable[Asked],
    processes: int = 1,
    on: str | None = None,
    killed: Callable[[Asked], Result] | None = None,
) -> Iterator[tuple[Asked, Result]]:
    """What was asked and what came of it, each once, as soon as it is there.

    perform : a function of a module; processes : on this machine, among which its cores are divided
    on : address of a Dask scheduler, whose workers then make the runs
    killed : what came of a run whose process was killed each time it was begun; without it that raises

    Raises RunError where Dask is not installed or not there, or where a run's process is killed again and again.
    """
    if on is not None:
        return _on_dask(perform, asked, on, killed)
    return _in_processes(perform, asked, processes, killed)


def _in_processes(
    perform: Callable[[Asked], Result], asked: Iterable[Asked], processes: int, killed: Callable[[Asked], Result] | None
) -> Iterator[tuple[Asked, Result]]:
    left = iter(asked)
    again: deque[tuple[Asked, int]] = deque()
    idle: list[RunProcess] = []
    # by connection: the process, its run, and how often that was killed
    busy: dict[Any, tuple[RunProcess, Asked, int]] = {}

    def fill() -> None:
        while len(busy) < processes:
            one, kills = again.popleft() if again else (next(left, None), 0)
            if one is None:
                return
            process = idle.pop() if idle else RunProcess(perform, processes)
            busy[process.connection] = (process, one, kills)
            process.begin(one)

    try:
        fill()
        while busy:
            done = []
            for connection in wait(list(busy)):
                process, one, kills = busy.pop(connection)
                try:
                    done.append((one, process.result()))
                    idle.append(process)
                except KilledError:
                    process.end()
                    if kills + 1 < ATTEMPTS:
                        again.append((one, kills + 1))
                    elif killed is not None:
                        done.append((one, killed(one)))
                    else:
                        raise RunError(
                            f"the process of a run was killed {ATTEMPTS} times, for want of memory maybe: {one!r:.200}"
                        ) from None
            fill()
            yield from done
    finally:
        for process in [*idle, *(process for process, _, _ in busy.values())]:
            process.end()


def _on_dask(
    perform: Callable[[Asked], Result], asked: Iterable[Asked], address: str, killed: Callable[[Asked], Result] | None
) -> Iterator[tuple[Asked, Result]]:
    distributed = _dask(address)
    # what it logs are tracebacks of what is told in a sentence here
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise RunError(f"no Dask scheduler answers at '{address}': {error}") from None
    left = iter(asked)
    waiting: dict[Any, Asked] = {}
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            sys.stderr.write(f"waiting for workers at '{address}'\n")
        done = distributed.as_completed()

        def fill() -> None:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            threads = sum(worker["nthreads"] for worker in workers)
            hosts = [worker["host"] for worker in workers]
            sharing = max((hosts.count(host) for host in hosts), default=1)
            while len(waiting) < AHEAD * max(1, threads) and (one := next(left, None)) is not None:
                with warnings.catch_warnings():
                    # Dask advises against tasks of many megabytes, which a scan may well be
                    warnings.simplefilter("ignore", UserWarning)
                    # a run whose worker is killed goes to another one, or waits until it is back
                    future = client.submit(_on_worker, perform, sharing, one, pure=False, retries=ATTEMPTS)
                waiting[future] = one
                done.add(future)

        try:
            fill()
            for future in done:
                one = waiting.pop(future)
                try:
                    result = future.result()
                except distributed.KilledWorker:
                    if killed is None:
                        raise RunError(
                            f"workers at '{address}' were killed again and again by the run {one!r:.200}"
                        ) from None
                    result = killed(one)
                except CancelledError:
                    raise RunError(f"the Dask scheduler at '{address}' has gone") from None
                except ModuleNotFoundError as error:
                    raise RunError(
                        f"scheduler or workers at '{address}' do not find '{error.name}'; install the same "
                        f"version of pmpnbp there"
                    ) from None
                fill()
                yield one, result
        finally:
            client.cancel(list(waiting))


def _dask(address: str) -> ModuleType:
    if not ADDRESS.fullmatch(address):
        raise RunError(f"'{address}' is no address of a Dask scheduler; expected one like tcp://192.0.2.7:8786")
    try:
        return importlib.import_module("distributed")
    except ImportError:
        raise RunError("--on needs Dask: pip install 'pmpnbp[distributed]'") from None


def _on_worker(perform: Callable[[Asked], Result], sharing: int, asked: Asked) -> Result:
    """A run on a machine whose cores so many workers share."""
    if "numba" in sys.modules:  # its kernels may run in any of the worker's threads
        share_cores(sharing)
    return perform(asked)
