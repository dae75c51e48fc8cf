"""How does a run come into a process of its own, and what came of it back? One process, which makes one run at a time.

A process is begun anew, not forked: threads of the kernels do not survive a fork. Each is tied to its parent by a pipe,
which tells either of the other's end, so that a kill is noticed at once and is known to be of just that run.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from pmpnbp.errors import RunError
from pmpnbp.importing import many_modules

# Of what may compute with several threads, the variables that say with how many.
_THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


class KilledError(Exception):
    """The process has ended, whatever it was doing."""


class RunProcess:
    """A process of its own that makes runs, one after the other.

    perform : a function of a module; processes : how many share this machine's cores
    """

    def __init__(self, perform: Callable[[Any], Any], processes: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        # pickled here, so that the number of threads is set before it brings what computes
        packed = pickle.dumps(perform)
        self._process = context.Process(target=_work, args=(theirs, packed, processes), daemon=True)
        self._process.start()
        theirs.close()

    def begin(self, asked: Any) -> None:
        """Have it make a run; `connection` can be read from once it has. A process that has ended tells so there."""
        with suppress(OSError):
            self.connection.send(asked)

    def result(self) -> Any:
        """What came of the run: waits for it. Raises what the run raised, and KilledError where the process ended."""
        try:
            came, told = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            raise KilledError from None
        if came:
            return told
        raise told

    def end(self) -> None:
        """End it, whatever it is doing."""
        self.connection.close()
        self._process.kill()
        self._process.join()


def share_cores(processes: int) -> None:
    """Let kernels and BLAS take this process's share of the cores; an environment that says less is followed."""
    share = max(1, (os.cpu_count() or 1) // processes)
    numba = sys.modules.get("numba")
    if numba is not None:  # which has read its variable already
        numba.set_num_threads(min(share, numba.config.NUMBA_NUM_THREADS))
        return
    for name in _THREADS:
        said = os.environ.get(name, "")
        os.environ[name] = str(min(share, int(said)) if said.isdecimal() and int(said) > 0 else share)


def _work(connection: Connection, packed: bytes, processes: int) -> None:
    # at the terminal an interrupt reaches every process; the parent decides what it ends
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    share_cores(processes)
    with suppress(EOFError, OSError):  # the parent has ended
        while True:
            asked = connection.recv()
            try:
                with many_modules():
                    perform = pickle.loads(packed)
                told = (True, perform(asked))
            except Exception as error:
                error.add_note("".join(traceback.format_exception(error)))
                told = (False, _as_sent(error))
            connection.send(told)


def _as_sent(error: Exception) -> Exception:
    """The error, or where it does not survive the way, one that says the same."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RunError(f"{type(error).__name__}: {error}")
    return error
