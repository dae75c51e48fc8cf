"""An estimate drawn over its scan, and its draws: what is left of an inference once it is read out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pmpnbp.errors import EstimateError
from pmpnbp.library.estimate import NOTHING_TO_DRAW_FROM
from pmpnbp.pictures.pictures import Pictures
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.scene.observation import Scan


@dataclass(frozen=True)
class Drawing:
    """snapshot : the iteration, with its posterior where there is one; scan : that the picture is of
    recorded : a recording that ends with it, at the path it is given, or one that is there"""

    snapshot: Snapshot
    scan: Scan
    recorded: Callable[[Path], Path]

    def picture(self, width: int | None) -> bytes:
        """PNG, as `Estimate.picture`."""
        placed = self.snapshot.placed
        return _pictures().draw(self.scan, self.snapshot.problem.mrf.model, placed.part_poses, width)

    def show(self) -> None:
        """As `Estimate.show`."""
        from pmpnbp.library.page import show

        show(self.recorded)

    def to_arviz(self, draws: int) -> Any:
        """As `Estimate.to_arviz`."""
        from pmpnbp.readout.arviz_export import to_inference_data

        problem, posterior = self.snapshot.problem, self.snapshot.placed.posterior
        if posterior is None:
            raise EstimateError(NOTHING_TO_DRAW_FROM)
        of_run = {"method": problem.method, "seed": problem.seed, "frame_id": problem.observation.frame_id}
        return to_inference_data(problem.mrf.model, posterior, draws=draws, seed=problem.seed, attributes=of_run)


@cache
def _pictures() -> Pictures:
    """One for all: what draws off screen is made once in a process."""
    return Pictures()
