"""Where are runs made? One after the other in a process of their own, in several, or on other machines through Dask."""

from __future__ import annotations

import multiprocessing
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from benchmarks.reproduce.run_log import Asked, ReproduceError, Result

Perform = Callable[[Asked], Result]
# How often the runs that a killed process has left are begun anew.
ATTEMPTS = 3
# Seconds that a Dask scheduler may take to answer.
PATIENCE = 10
ADDRESS = re.compile(r"((tcp|tls|wss?)://)?([\w.-]+|\[[0-9a-fA-F:]+\]):[0-9]{1,5}")


def spread(
    perform: Perform, asked: Sequence[Asked], processes: int = 1, on: str | None = None
) -> Iterator[tuple[Asked, Result]]:
    """What was asked and what came of it, as soon as it is there.

    perform : a function of a module; processes : on this machine, among which its cores are divided
    on : address of a Dask scheduler, whose workers then make the runs

    Raises ReproduceError where Dask is not installed or not there, or where processes are killed again and again.
    """
    return _on_dask(perform, asked, on) if on is not None else _in_processes(perform, asked, processes)


def _in_processes(perform: Perform, asked: Sequence[Asked], processes: int) -> Iterator[tuple[Asked, Result]]:
    # begun anew, not forked: threads of the kernels do not survive a fork
    context = multiprocessing.get_context("spawn")
    left = list(range(len(asked)))
    for _ in range(ATTEMPTS):
        with ProcessPoolExecutor(
            processes, mp_context=context, initializer=_share_cores, initargs=(processes,)
        ) as pool:
            waiting = {pool.submit(perform, asked[number]): number for number in left}
            try:
                for done in as_completed(waiting):
                    result = done.result()
                    left.remove(waiting[done])
                    yield asked[waiting[done]], result
            except BrokenProcessPool:
                continue
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        return
    raise ReproduceError(f"processes were killed {ATTEMPTS} times; {len(left)} runs are left, for want of memory maybe")


def _share_cores(processes: int) -> None:
    """In a new process, before kernels are loaded."""
    import numba

    numba.set_num_threads(max(1, min(numba.config.NUMBA_NUM_THREADS, (os.cpu_count() or 1) // processes)))


def _on_dask(perform: Perform, asked: Sequence[Asked], address: str) -> Iterator[tuple[Asked, Result]]:
    if not ADDRESS.fullmatch(address):
        raise ReproduceError(f"'{address}' is no address of a Dask scheduler; expected one like tcp://192.0.2.7:8786")
    try:
        import distributed
    except ImportError:
        raise ReproduceError("--on needs Dask: pip install 'pmpnbp[distributed]'") from None
    try:
        client = distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise ReproduceError(f"no Dask scheduler answers at '{address}': {error}") from None
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            sys.stderr.write(f"waiting for workers at '{address}'\n")
        # a run whose worker is killed goes to another one, or waits until it is back
        waiting = dict(zip(client.map(perform, asked, pure=False, retries=ATTEMPTS), asked, strict=True))
        try:
            for done in distributed.as_completed(list(waiting)):
                try:
                    yield waiting[done], done.result()
                except distributed.KilledWorker:
                    raise ReproduceError(
                        f"workers at '{address}' were killed again and again by the run {dict(waiting[done])}"
                    ) from None
                except ModuleNotFoundError as error:
                    raise ReproduceError(
                        f"scheduler or workers at '{address}' do not find '{error.name}'; install the same "
                        f"version of pmpnbp there"
                    ) from None
        finally:
            client.cancel(list(waiting))
