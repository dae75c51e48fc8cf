"""How large can the arrays of a recording from elsewhere be? As its own model, particles and scans make them, at most.

A few kilobytes unpack to gigabytes of zeros. So what a recording says of its arrays is looked at before any is
unpacked: names, types, shapes, and how many bytes they come to.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pmpnbp.readout.mixture import MODES
from pmpnbp.readout.object_posterior import EACH, FIRST, LEAST, ROUNDS
from pmpnbp.recording.amounts import LONGEST_TEXT
from pmpnbp.recording.arrays import incoming_messages
from pmpnbp.recording.schema import PREFIX
from pmpnbp.scene.articulated_object import ArticulatedObject

# Bytes of all arrays of an iteration: forty-eight parts of 20,000 particles take 300 MiB.
LARGEST_ITERATION = 512 << 20
# Places that a search compares; it keeps some tens.
MOST_RIVALS = 10_000
# Modes of a posterior, with room for versions that told more of them.
MOST_MODES = 4 * MODES
# Deflate makes no more of what it cannot make smaller than this share, and so many bytes.
_PACKED_SHARE, _PACKED_BYTES = 1.01, 1024

# What an array is said to be: name, type and shape as `schema.pack` writes them, bytes that it is packed in.
Said = tuple[str, str, str, int]


@dataclass(frozen=True)
class ArrayShapes:
    """largest : kinds of numbers, as NumPy calls them, and the largest shape of each array, by its name"""

    largest: Mapping[str, tuple[str, tuple[int, ...]]]

    def check(self, said: Iterable[Said]) -> None:
        """Raise ValueError at the first array of an iteration that the model does not make, or where all together are
        too large."""
        names: set[str] = set()
        total = 0
        for name, dtype, shape, packed in said:
            size = self._bytes(name, np.dtype(dtype), [int(length) for length in json.loads(shape)])
            total += size
            if name in names or total > LARGEST_ITERATION or packed > _PACKED_SHARE * size + _PACKED_BYTES:
                raise ValueError(f"{name}: {size} bytes of {total}, packed in {packed}")
            names.add(name)

    def _bytes(self, name: str, dtype: np.dtype, shape: list[int]) -> int:
        known = name.removeprefix("state.") if name.startswith(("state.belief.", "state.messages.")) else name
        kinds, largest = self.largest[known]
        if 0 in shape and len(shape) <= len(largest) and min(shape) == 0:  # also says that the state has none
            return 0
        fits = len(shape) == len(largest) and all(0 < a <= b for a, b in zip(shape, largest, strict=True))
        if not fits or dtype.kind not in kinds or dtype.itemsize > 8:
            raise ValueError(f"{name}: {dtype} {shape}")
        return dtype.itemsize * int(np.prod(shape, dtype=object))


def array_shapes(model: ArticulatedObject, particles: int, scans: int) -> ArrayShapes:
    """Of the arrays that an inference makes with so many particles of each part and so many scans."""
    parts, dof, edges = len(model.parts), model.dof, len(model.edges)
    ends = np.array([[edge.child, edge.parent] for edge in model.edges], dtype=np.int64).reshape(-1)
    neighbours = max((len(messages) for messages in incoming_messages(ends, parts)), default=0)
    axes = max((len(edge.axes) for edge in model.edges), default=1)
    # the pooled product has a particle for each sample of each incoming message
    each = parts, particles * max(neighbours, 1)
    sent = 2 * edges, particles
    nuisances = 7 * scans + 3
    coordinates = 6 + dof + nuisances
    draws = MOST_MODES * (FIRST + (ROUNDS - 1) * max(LEAST, coordinates * min(coordinates, EACH)))
    whole, real = "iu", "f"
    return ArrayShapes(
        {
            "belief.poses": (real, (*each, 7)),
            "belief.log_weights": (real, each),
            "belief.log_unary": (real, each),
            **{f"belief.{name}": (whole, each) for name in ("source", "ancestor", "neighbour", "island")},
            "belief.joint_positions": (real, (each[1], dof)),
            "messages.sender": (whole, (2 * edges,)),
            "messages.receiver": (whole, (2 * edges,)),
            "messages.poses": (real, (*sent, 7)),
            **{f"messages.{name}": (real, sent) for name in ("log_weights", "log_unary", "log_neighbour")},
            "messages.joint_draw": (real, (*sent, axes)),
            "log_message_shares": (real, (*each, neighbours)),
            "temperature": (real, (parts,)),
            "effective_sample_size": (real, (parts,)),
            "mle": (real, (parts, 7)),
            "mle_joints": (real, (dof,)),
            "nuisances": (real, (nuisances,)),
            "rivals": (real, (MOST_RIVALS, 7 + dof)),
            "search_after": (whole, ()),
            "state.root": (real, (7,)),
            "state.joints": (real, (dof,)),
            "state.nuisances": (real, (nuisances,)),
            f"{PREFIX}root": (real, (7,)),
            f"{PREFIX}joints": (real, (dof,)),
            f"{PREFIX}drawn_roots": (real, (draws, 7)),
            f"{PREFIX}drawn_joints": (real, (draws, dof)),
            f"{PREFIX}drawn_sizes": (real, (draws, 3)),
            f"{PREFIX}nuisance_stds": (real, (nuisances,)),
            f"{PREFIX}log_weights": (real, (draws,)),
            f"{PREFIX}mode": (whole, (draws,)),
            f"{PREFIX}mode_weights": (real, (MOST_MODES,)),
            f"{PREFIX}mode_roots": (real, (MOST_MODES, 7)),
            f"{PREFIX}mode_joints": (real, (MOST_MODES, dof)),
            f"{PREFIX}effective_sample_size": (real, (1,)),
            f"{PREFIX}centre_root": (real, (7,)),
            f"{PREFIX}centre_joints": (real, (dof,)),
            f"{PREFIX}centre_nuisances": (real, (nuisances,)),
            f"{PREFIX}fit": (whole, (LONGEST_TEXT,)),
        }
    )
