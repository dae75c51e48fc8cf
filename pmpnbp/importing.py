"""Many modules are imported sooner while nobody looks for garbage among them, which they do not make, and whole only if
Ctrl-C waits: libraries take what is raised as another library is imported, whatever it is, for a sign that this is not
there, and go on without it."""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def many_modules() -> Iterator[None]:
    """The garbage collector waits meanwhile: it would go through all that the modules make, again and again, a fifth of
    the seconds that they take. So does a KeyboardInterrupt, which is raised at the end."""
    collects = gc.isenabled()
    gc.disable()
    try:
        with _interrupt_waits():
            yield
    finally:
        if collects:
            gc.enable()


@contextmanager
def _interrupt_waits() -> Iterator[None]:
    """Where SIGINT raises a KeyboardInterrupt, which it does in the main thread only, it does so at the end."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    came = False

    def wait(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True

    signal.signal(signal.SIGINT, wait)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if came:
        raise KeyboardInterrupt
