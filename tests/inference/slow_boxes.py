"""Algorithm boxes 1 and 2, and the product of eq. 5, written down as printed: one sample at a time, plain weights.

The slow twin of `pmpnbp.inference.belief_propagation`. It is handed the samples and the joint draws, so that nothing
is left to chance, and the potentials as functions of single poses, as the boxes ask for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pmpnbp.geometry.poses import Array

# A message or a belief: samples and their weights.
Weighted = tuple[Sequence[Array], list[float]]


@dataclass(frozen=True)
class SlowBoxes:
    """neighbours : rho(s) of every node s, in order
    phi : (node, pose) → the unary potential
    psi : (t, s, pose of t, pose of s) → the pairwise potential
    sample : (t, s, pose of s, joint draw) → the pose of t that the joint draw leads to
    """

    neighbours: dict[int, list[int]]
    phi: Callable[[int, Array], float]
    psi: Callable[[int, int, Array, Array], float]
    sample: Callable[[int, int, Array, Array], Array]

    def factors(
        self,
        t: int,
        s: int,
        samples: Sequence[Array],
        draws: Sequence[Sequence[Array]],
        before: dict[tuple[int, int], Weighted],
        power: float = 1.0,
    ) -> tuple[list[float], list[float]]:
        """Box 1, step 2, for the message t → s: w_unary and w_neigh of every sample.

        draws : for each sample its joint draws (one, as printed; of several the mean is taken)
        before : the messages u → t of the iteration before, none in the first; power : 1 / tempering, 1 as printed
        """
        unary, neighbouring = [], []
        for mu_ts, tried in zip(samples, draws, strict=True):
            likelihoods = []
            for draw in tried:
                x_t = self.sample(t, s, mu_ts, draw)  # 2a
                likelihoods.append(self.phi(t, x_t) ** power)  # 2b
            unary.append(sum(likelihoods) / len(likelihoods))
            w_neigh = 1.0
            for u in self.neighbours[t]:
                if u == s or (u, t) not in before:
                    continue
                big_w = 0.0
                for mu_ut, w_ut in zip(*before[u, t], strict=True):
                    big_w += w_ut * self.psi(t, s, mu_ut, mu_ts)  # 2c (i)
                w_neigh *= big_w  # 2c (ii)
            neighbouring.append(w_neigh)
        return unary, neighbouring

    def message(self, unary: Sequence[float], neighbouring: Sequence[float]) -> list[float]:
        """Box 1, step 2d, and to a sum of one."""
        return normalised([a * b for a, b in zip(unary, neighbouring, strict=True)])

    def updated(self, s: int, message: Weighted) -> list[float]:
        """Box 2, steps 1a and 1b: the weights of one incoming message after the unary potential of s."""
        return normalised([w * self.phi(s, mu) for mu, w in zip(*message, strict=True)])

    def pooled(self, s: int, incoming: Sequence[Weighted]) -> Weighted:
        """Box 2, steps 1 to 3: the belief of s from its incoming messages."""
        samples: list[Array] = []
        weights: list[float] = []
        for message in incoming:
            weights += self.updated(s, message)
            samples += list(message[0])
        return samples, normalised(weights)

    def product(
        self, s: int, samples: Sequence[Array], factors: Sequence[Sequence[float]], power: float = 1.0
    ) -> list[float]:
        """Eq. 5 on samples that all messages have weighed: the belief's weights."""
        return normalised(
            [self.phi(s, mu) ** power * math.prod(factor[i] for factor in factors) for i, mu in enumerate(samples)]
        )


def normalised(weights: Sequence[float]) -> list[float]:
    """Weights that add up to one."""
    total = sum(weights)
    return [w / total for w in weights]
