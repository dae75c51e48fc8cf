"""What lies in a checkout of the project but is not installed: benchmarks and the paper's experiments."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from pmpnbp.errors import PmpnbpError

PROJECT = Path(__file__).resolve().parents[2]


class CheckoutError(PmpnbpError):
    """The program was installed without them."""


def load(module: str, project: Path = PROJECT) -> ModuleType:
    """A module of the folder `project`. Raises CheckoutError where it is not there."""
    if not (project / Path(*module.split("."))).with_suffix(".py").is_file():
        raise CheckoutError(f"{module} is not installed with the package; run this from a checkout of the project")
    if str(project) not in sys.path:
        sys.path.insert(0, str(project))
    return importlib.import_module(module)
