"""Ctrl-C is heard wherever it comes. Python drops what is raised in a finaliser, as LLVM's objects have, or in a
callback of a C library, and the command would go on as if nobody had asked it to end."""

from __future__ import annotations

import signal
import sys
import threading

# Seconds until an interrupt that was dropped comes again, by which the finaliser has ended.
SOON = 0.02


def keep_interrupts() -> None:
    """From now on a KeyboardInterrupt that Python drops is raised again in the main thread."""
    before = sys.unraisablehook

    def dropped(what: sys.UnraisableHookArgs) -> None:
        if what.exc_type is not KeyboardInterrupt:
            before(what)
            return
        # soon, and not here, where it would be dropped again; a signal, which ends a wait as well
        again = threading.Timer(SOON, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()

    sys.unraisablehook = dropped
