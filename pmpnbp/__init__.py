"""Beliefs over the poses and joints of articulated objects, from depth scans, by pull message passing for
nonparametric belief propagation.

    import pmpnbp
    found = pmpnbp.estimate("cabinet.urdf", "depth.png", camera="camera.json", roi=[0, -0.2, -0.1, 0.9, 0.7, 0.9])
    print(found)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from pmpnbp.errors import PmpnbpError
from pmpnbp.importing import many_modules

if TYPE_CHECKING:
    from pmpnbp.client.client import Client
    from pmpnbp.library.estimate import Estimate
    from pmpnbp.library.inputs import Model, load_model, load_scan
    from pmpnbp.library.iteration import Iteration
    from pmpnbp.library.playback import Playback, open_recording
    from pmpnbp.library.session import Session, estimate

    __version__: str

# Where each name is: importing them takes seconds, which whoever uses only some of them should not wait for.
_PLACES = {
    "Client": "pmpnbp.client.client",
    "Estimate": "pmpnbp.library.estimate",
    "Iteration": "pmpnbp.library.iteration",
    "Model": "pmpnbp.library.inputs",
    "Playback": "pmpnbp.library.playback",
    "Session": "pmpnbp.library.session",
    "estimate": "pmpnbp.library.session",
    "load_model": "pmpnbp.library.inputs",
    "load_scan": "pmpnbp.library.inputs",
    "open_recording": "pmpnbp.library.playback",
}

__all__ = [
    "Client",
    "Estimate",
    "Iteration",
    "Model",
    "Playback",
    "PmpnbpError",
    "Session",
    "estimate",
    "load_model",
    "load_scan",
    "open_recording",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from pmpnbp.version import version

        return version()
    if name not in _PLACES:
        raise AttributeError(f"module 'pmpnbp' has no attribute '{name}'")
    with many_modules():
        found = getattr(importlib.import_module(_PLACES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
