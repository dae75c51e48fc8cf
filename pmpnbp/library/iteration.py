"""One iteration of an inference, as programs look at it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np

from pmpnbp.errors import EstimateError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.library.estimate import Estimate
from pmpnbp.readout.placement import Placement, place
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.scene.articulated_object import parts_of_links


class Iteration:
    """What one iteration made; immutable. Poses are (7,) x y z qw qx qy qz, link in world, metres.

    report : everything about it, as `pmpnbp.inference.belief` has it
    converged : whether the inference is at rest in it
    """

    def __init__(
        self,
        snapshot: Callable[[], Snapshot],
        estimate: Callable[[Snapshot], Estimate],
        problem: Problem,
        report: IterationReport,
        converged: bool,
    ) -> None:
        self.report = report
        self.converged = converged
        self._problem = problem
        self._model = problem.mrf.model
        self._make = snapshot
        self._estimate = estimate

    @property
    def number(self) -> int:
        """0 is the start."""
        return self.report.iteration

    @property
    def stage(self) -> str:
        """What made it: start, search, belief propagation, ..."""
        return self.report.stage

    @property
    def seconds(self) -> float:
        """Of wall time that it took."""
        return self.report.seconds

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm, of the estimate."""
        return self.report.map_score

    @property
    def effective_sample_size(self) -> Mapping[str, float]:
        """Of each part's particles, by the part's name."""
        names = [part.name for part in self._model.parts]
        return dict(zip(names, self.report.effective_sample_size.tolist(), strict=True))

    @property
    def poses(self) -> Mapping[str, Array]:
        """Where the algorithm has each link, by its name; where it is believed to be is the `estimate`'s to say."""
        return dict(zip(self._model.links, self._placed.link_poses, strict=True))

    @property
    def joints(self) -> Mapping[str, Array]:
        """(K,) positions of each joint that moves, metres or radians, by its name; likewise."""
        vector = self._placed.joint_positions
        return {joint.name: joint.positions(vector) for joint in self._model.joints if joint.kind != "fixed"}

    def particles(self, link: str) -> Array:
        """(M, 7): the belief's particles about a link. Raises EstimateError for one that the model does not have."""
        self._node(link)
        return self._placed.particles[:, self._model.links.index(link)]

    def log_weights(self, link: str) -> Array:
        """(M,): their natural log weights, of which the exponentials add up to 1. Raises EstimateError likewise."""
        return self.report.belief.log_weights[self._node(link)]

    def message(self, sender: str, receiver: str) -> tuple[Array, Array]:
        """(M, 7) and (M,): what the part of one link says about another link, as particles with log weights. Raises
        EstimateError where no message goes there; the search and the particle filter send none."""
        source, target = self._node(sender), self._node(receiver)
        messages = self.report.messages
        if messages is not None:
            found = np.flatnonzero((messages.sender == source) & (messages.receiver == target))
            if len(found):
                part = self._model.parts[target]
                carried = part.poses_part_link[part.links.index(receiver)]
                return poses.multiply(messages.poses[found[0]], carried), messages.log_weights[found[0]]
        raise EstimateError(
            f"iteration {self.number} ({self.stage}) has no message from '{sender:.60}' to '{receiver:.60}'"
        )

    def estimate(self) -> Estimate:
        """The estimate, with its posterior read out, which takes some tenths of a second; during the search there is
        no posterior."""
        return self._estimate(self.snapshot)

    @cached_property
    def snapshot(self) -> Snapshot:
        """The iteration read out, as `pmpnbp.readout.snapshot` has it."""
        return self._make()

    @cached_property
    def _placed(self) -> Placement:
        return place(self._problem, self.report)

    def _node(self, link: str) -> int:
        parts = parts_of_links(self._model)
        if link not in parts:
            raise EstimateError(f"link '{link:.60}' is not in the model; it has {', '.join(self._model.links)}")
        return parts[link]

    def __repr__(self) -> str:
        rest = ", at rest" if self.converged else ""
        return f"<Iteration {self.number}: {self.stage}{rest}, log likelihood {self.log_likelihood:.1f}>"
