"""`python -m pmpnbp`, the same as the command `pmpnbp`."""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":
    if not sys.flags.safe_path:  # the working folder would come first, and may hold an app.py of its own
        sys.path[0] = str(Path(__file__).resolve().parent.parent)
    from app.cli import main

    sys.exit(main())
