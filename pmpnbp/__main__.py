"""`python -m pmpnbp`: the installed command, looked up and not imported, because the library knows no command line."""

from __future__ import annotations

import sys
from importlib.metadata import entry_points
from pathlib import Path

if __name__ == "__main__":
    if not sys.flags.safe_path:  # the working folder would come first, and may hold an app.py of its own
        sys.path[0] = str(Path(__file__).resolve().parent.parent)
    command, *_ = entry_points(group="console_scripts", name="pmpnbp")
    try:
        command.load()()  # which ends the process itself
    except KeyboardInterrupt:  # before it has begun
        sys.exit(130)
