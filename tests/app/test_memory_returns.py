"""Does nothing of a closed view, or of a deleted session, stay in memory?"""

from __future__ import annotations

import ctypes
import gc
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any

import pytest

from app.sessions.run_queue import RunQueue
from tests.app import small_sessions as small
from tests.app.open_views import drawn, looking, painter, until

# Where a large block was freed: is the next one mapped on its own again?
LARGE_TWICE = """
import ctypes, sys
from app.memory import MAPPED_FROM, hold_less
glibc = ctypes.CDLL(None)
glibc.malloc.restype, glibc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
class Info(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena ordblks smblks hblks hblkhd a b c d e".split()]
glibc.mallinfo2.restype = Info
if sys.argv[1] == "held less":
    hold_less()
mapped = lambda: glibc.mallinfo2().hblks
before = mapped()
while mapped() == before:  # what there is room for in the heap is not mapped
    block = glibc.malloc(MAPPED_FROM + 4096)
glibc.free(block)
before = mapped()
glibc.malloc(MAPPED_FROM + 4096)
print(mapped() - before)
"""


def alive(references: dict[str, weakref.ref[Any]]) -> list[str]:
    """The names of what is still there, once what threads that end hold just now had its time to go."""
    for _ in range(100):
        gc.collect()
        left = [name for name, reference in references.items() if reference() is not None]
        if not left:
            break
        time.sleep(small.PATIENCE)
    return left


def test_nothing_of_a_closed_view_stays(serve: Callable[..., Any]) -> None:
    served = serve().ready()
    served.app.state.views._linger = 0.0
    path = small.after(served.client, 2)
    view = f"{path}/views/closed"
    with looking(served, view):
        drawn(served, view, 2)
        own = painter(served, view)
        left = {
            "painter": weakref.ref(own),
            "view": weakref.ref(own._view),
            "drawing": weakref.ref(own._drawing),
            "scene": weakref.ref(own._scene),
            "stage": weakref.ref(next(iter(own._stages.values()))),
            "points": weakref.ref(next(iter(own._stages.values())).scans[0]),
            "viser": weakref.ref(own._view.server),
        }
        del own
    until(lambda: len(served.app.state.views) == 0)
    assert alive(left) == []


def test_nothing_of_a_deleted_session_stays(serve: Callable[..., Any]) -> None:
    served = serve().ready()
    path = small.create(served.client)
    view = f"{path}/views/doomed"
    with looking(served, view):
        small.step(served.client, path, 4)
        drawn(served, view, 4)
        served.client.get(f"{path}/estimate?iteration=1").raise_for_status()
        served.client.get(f"{path}/estimate?posterior=true").raise_for_status()
        session = served.app.state.sessions.get(path.rpartition("/")[2])
        newest = session.archive.present
        left = {
            "session": weakref.ref(session),
            "archive": weakref.ref(session.archive),
            "snapshot": weakref.ref(newest),
            "problem": weakref.ref(newest.problem),
            "belief": weakref.ref(newest.report.belief),
            "stage": weakref.ref(next(iter(painter(served, view)._stages.values()))),
        }
        del session, newest
        assert served.client.delete(path).status_code == 204
    assert alive(left) == []


def test_a_nudge_that_comes_late_holds_no_deleted_session(
    serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command's thread may have done it, and ended, before whoever gave the command goes on."""
    prompt = RunQueue.nudge

    def late(queue: RunQueue, owner: object) -> None:
        for thread in threading.enumerate():
            if thread.name.startswith("session-") and thread is not threading.current_thread():
                thread.join()
        prompt(queue, owner)

    served = serve().ready()
    path = small.after(served.client, 1)
    left = {"session": weakref.ref(served.app.state.sessions.get(path.rpartition("/")[2]))}
    monkeypatch.setattr(RunQueue, "nudge", late)
    assert served.client.delete(path).status_code == 204
    assert alive(left) == []


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="glibc's own figures")
@pytest.mark.parametrize(("how", "mapped"), [("held less", "1"), ("left to itself", "0")])
def test_what_is_large_goes_back_by_itself(how: str, mapped: str) -> None:
    told = subprocess.run([sys.executable, "-c", LARGE_TWICE, how], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == mapped
