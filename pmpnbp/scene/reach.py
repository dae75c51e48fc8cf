"""How far away may anything be? What is given is refused beyond this where it is read, as all that is computed from it
then stays where the kernels can look it up."""

from __future__ import annotations

# Metres from the origin of the world, along each axis, that a camera or a prior's mean may be; metres that an object
# may reach from its root link; and the largest standard deviation of a prior.
FARTHEST = 1e4
# Metres that a camera's pixel may look to the side at a depth of one metre: the tangent of 84°.
WIDEST_RAY = 10.0
