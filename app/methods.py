"""Which ways to infer are there? Checked before anything heavy is loaded."""

from __future__ import annotations

from pmpnbp.errors import SettingError

METHODS = ("pmpnbp",)


def check_method(method: str) -> None:
    """Raise SettingError for a method that this version does not have."""
    if method not in METHODS:
        raise SettingError(f"method '{method}' comes with a later version; this one has {', '.join(METHODS)}")
