"""Which version of the package is this?"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed_version


def version() -> str:
    """The installed version, or "unknown" where the package runs from a checkout that was not installed."""
    try:
        return installed_version("pmpnbp")
    except PackageNotFoundError:
        return "unknown"
