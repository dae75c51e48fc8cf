"""Many modules are imported sooner while nobody looks for garbage among them, which they do not make."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def many_modules() -> Iterator[None]:
    """The garbage collector waits meanwhile. It would go through all that the modules make, again and again: a fifth of
    the seconds that they take."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
