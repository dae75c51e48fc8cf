"""Is what should be seen there seen? A posterior says where the object is, given that it is there; this says whether.

What the scan confirms of the object at the estimate is counted in `inference/confirmation.py`. What a wrong model finds
in another object is told by what that object has besides: surfaces that touch the explained ones, and are explained by
nothing, while some of the model would be hidden in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.inference.confirmation import Confirmation
from pmpnbp.names import some_of
from pmpnbp.scene.observation import CONTINUED, OBJECT, View

Verdict = Literal["good", "doubtful", "none"]
# Shares of what should be seen: confirmed below which there is nothing, and from which on the fit may be good. On hard
# scenes right estimates have 0.69 and more, absent objects 0.24 and less (docs/algorithm.md).
NOTHING, GOOD = 0.35, 0.62
# Share of the object that something in front hides, above which the rest says too little.
HIDDEN = 0.6
# Surfaces that touch the object and go on make it doubtful, if they have this share of its confirmed pixels; such as
# are longer than the object, as a table may be that no plane was found in, a larger one, and if the last share of what
# is confirmed lies on one: of a door's frame, a few centimetres before the wall, some pixels are the wall's.
TOUCHING, LONG_TOUCHING, ON_LONG = 0.02, 0.25, 0.1
# Share of the object's pixels that may be of parts that are denied.
DENIED_SHARE = 0.5
# Confirmed pixels, weighed as the score is, that are too few: a corner of anything is found by chance; and the same of
# an object of which this share is hidden.
FEW, HALF_HIDDEN, FEW_IF_HIDDEN = 60.0, 0.3, 150.0
# The deviation of depths within the outline, in those that noise and fewer triangles give them, and metres besides:
# where it is larger than both, camera, scale or model is wrong. Of 487 right estimates, seeds to 770, the one
# that comes nearest has 1.86 and 1.8 mm.
OFF, BEYOND_NOISE = 1.95, 0.0016
# Neighbouring pixels are of one surface where their depths differ by a smaller share.
STEP = 0.015
# Pixels about the outline that touch the object because of the image's grain.
GRAIN = 2
# A surface is the object's where it has this share of the confirmed pixels, and so many.
OWN_SHARE, OWN_PIXELS = 0.02, 3


@dataclass(frozen=True, kw_only=True)
class Fit:
    """verdict : whether what should be seen is seen; reason : one sentence; explained : the share of it that the scan
    confirms, 0 to 1, weighed as the score is; missed : names of parts that are not where they should be seen; denied :
    of those that are seen through and not held, whose place is not to be believed, whatever that of the others is;
    beyond : of those outside the region of interest, of which the scan tells only where they are not."""

    verdict: Verdict
    reason: str
    explained: float
    missed: tuple[str, ...] = ()
    denied: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()


def assess(seen: Confirmation) -> Fit:
    """The fit of a place, by what the views say of it."""
    verdict, reason = _judged(seen)
    denied = tuple(name for name in seen.denied if name not in seen.held)
    beyond = tuple(name for name in seen.beyond if name not in (*seen.held, *seen.denied))
    if verdict == "good" and denied:
        it = "it" if len(denied) == 1 else "they"
        reason = f"{reason}; {_seen_through(denied)}, so that {it} may be elsewhere"
    if verdict == "good" and beyond:
        are = "is" if len(beyond) == 1 else "are"
        reason = f"{reason}; {some_of(beyond)} {are} outside the region of interest, and may be elsewhere"
    return Fit(
        verdict=verdict, reason=reason, explained=seen.explained, missed=seen.missed, denied=denied, beyond=beyond
    )


def _judged(seen: Confirmation) -> tuple[Verdict, str]:
    share = f"the scan confirms {100 * seen.explained:.0f} % of what should be seen"
    if seen.explained < NOTHING:
        return "none", share
    if seen.explained < GOOD:
        return "doubtful", share
    hidden = seen.hidden / max(seen.covered, 1)
    if hidden > HIDDEN or (hidden > HALF_HIDDEN and seen.score < FEW_IF_HIDDEN):
        return "doubtful", f"something in front hides {100 * hidden:.0f} % of the object, if it is there at all"
    if seen.outside_region:
        beyond = 100 * seen.outside / seen.covered
        return "doubtful", f"{share}, but {beyond:.0f} % of the object is outside the region of interest"
    if seen.score < FEW:
        return "doubtful", f"{share}, but that is {seen.confirmed} pixel{'' if seen.confirmed == 1 else 's'}"
    touching = 0
    for count, most in ((_touching, TOUCHING), (_touching_long, LONG_TOUCHING)):
        touching += sum(count(*pixels) for pixels in seen.pixels)
        if touching > most * seen.confirmed:
            return "doubtful", f"{share}, but {touching:,} pixels of the surfaces it lies on are explained by nothing"
    if seen.off > max(OFF * seen.noise, float(np.hypot(seen.noise, BEYOND_NOISE))):
        errors = f"{1000 * seen.off:.1f} mm, where {1000 * seen.noise:.1f} mm are expected"
        return "doubtful", f"{share}, but its depths are off by {errors}: are camera, depth scale and model right?"
    if seen.missed:
        return "doubtful", f"{share}, but not {some_of(seen.missed)}"
    if seen.denied_share > DENIED_SHARE or seen.root_denied:
        return "doubtful", f"{share}, but {_seen_through(seen.denied)}"
    return "good", share


def _seen_through(parts: Sequence[str]) -> str:
    return f"{some_of(parts)} {'is' if len(parts) == 1 else 'are'} seen through in places"


def _touching(view: View, covered: NDArray[np.bool_], confirmed: NDArray[np.bool_]) -> int:
    """Pixels beyond the object that may be it, on surfaces of which it explains a part."""
    within = view.category == OBJECT
    return _beyond(_surfaces(view.depth, within), within, covered, confirmed & within, OWN_SHARE)


def _touching_long(view: View, covered: NDArray[np.bool_], confirmed: NDArray[np.bool_]) -> int:
    """The same of patches that are longer than the object."""
    return _beyond(view.patches, view.category == CONTINUED, covered, confirmed, ON_LONG)


def _beyond(
    surfaces: NDArray[np.integer],
    within: NDArray[np.bool_],
    covered: NDArray[np.bool_],
    confirmed: NDArray[np.bool_],
    least: float,
) -> int:
    """Pixels `within` (h, w) that are not the object's, on `surfaces` (h, w) that have the share `least` of those that
    are `confirmed`, and OWN_PIXELS."""
    counts = np.bincount(surfaces[confirmed], minlength=int(surfaces.max(initial=0)) + 1)
    of_object = counts >= max(least * counts.sum(), OWN_PIXELS)
    beyond = within & ~ndimage.binary_dilation(covered, iterations=GRAIN)
    return int(np.count_nonzero(beyond & of_object[surfaces]))


def _surfaces(depth: NDArray[np.float32], within: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(h, w) numbers of the surfaces that pixels are on: neighbours of about one depth, both `within`, are on one. 0 is
    none."""
    # pixels and, between each two of them, whether they are on one
    joined = np.zeros((2 * depth.shape[0] - 1, 2 * depth.shape[1] - 1), dtype=np.bool_)
    joined[::2, ::2] = within
    for between, one, other in (
        (np.s_[::2, 1::2], np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[1::2, ::2], np.s_[:-1], np.s_[1:]),
    ):
        a, b = depth[one], depth[other]
        joined[between] = within[one] & within[other] & (np.abs(a - b) < STEP * np.maximum(a, b))
    labels: NDArray[np.int32] = ndimage.label(joined)[0][::2, ::2]
    return labels
