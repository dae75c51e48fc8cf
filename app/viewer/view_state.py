"""What does a 3D view show? One value per open view: the page sets it, the scene is drawn from it.

It is what a link to a view has to carry, so everything in it is plain: names, numbers, and None for "nothing chosen".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from pmpnbp.errors import PmpnbpError

Theme = Literal["light", "dark"]
ScanColour = Literal["depth", "explained", "plain"]
ParticleColour = Literal["part", "weight"]
Triple = tuple[float, float, float]

THEMES: tuple[Theme, ...] = ("light", "dark")
SCAN_COLOURS: tuple[ScanColour, ...] = ("depth", "explained", "plain")
PARTICLE_COLOURS: tuple[ParticleColour, ...] = ("part", "weight")
# Numbers beyond this are no place in any scene, metres.
FARTHEST = 1e4


class ViewStateError(PmpnbpError):
    """A view cannot be shown like this; the text says what came and what was expected."""


@dataclass(frozen=True)
class Show:
    """Which layers are drawn.

    scan : the points; camera : the cameras' frustums; image : their depth images in them; particles : of every part;
    axes : orientations of the best particles of the selected part; estimate : the parts where the estimate has them;
    ellipsoids : covariances of their positions; truth : the parts where they really are; planes : support planes;
    region, prior : the region of interest and the gaussian prior, with handles; messages : of the selected edge
    """

    scan: bool = True
    camera: bool = True
    image: bool = False
    particles: bool = True
    axes: bool = False
    estimate: bool = True
    ellipsoids: bool = True
    truth: bool = False
    planes: bool = False
    region: bool = False
    prior: bool = False
    messages: bool = False


LAYERS = tuple(entry.name for entry in fields(Show))


@dataclass(frozen=True)
class Compare:
    """Another session to lay over this one. iteration : None for its newest."""

    session_id: str
    iteration: int | None = None


@dataclass(frozen=True)
class Eye:
    """Where the view is looked at from: position and look_at in metres, up a direction, all in world."""

    position: Triple
    look_at: Triple
    up: Triple


@dataclass(frozen=True)
class ViewState:
    """What a view shows.

    iteration : None for the newest, whatever that is; show : the layers
    colour_scan : by depth, by how well the estimate explains each point, or plain
    colour_particles : by part, or paler the less a particle weighs
    confidence : share of the position's distribution that an ellipsoid holds, above 0 and below 1
    part, edge, particle : what is selected: a part, two parts that a joint connects, a particle of the part
    compare : what to lay over it; camera : None for where the view begins
    region : x0 y0 z0 x1 y1 z1, metres, world; prior : as prior.json, gaussian: what the handles in the scene say
    hidden : nobody sees it just now, so nothing is drawn
    economy : who looks draws without a graphics card, so less is drawn, and less often
    """

    iteration: int | None = None
    show: Show = field(default_factory=Show)
    colour_scan: ScanColour = "depth"
    colour_particles: ParticleColour = "part"
    confidence: float = 0.75
    part: str | None = None
    edge: tuple[str, str] | None = None
    particle: int | None = None
    compare: Compare | None = None
    theme: Theme = "light"
    camera: Eye | None = None
    region: tuple[float, ...] | None = None
    prior: Mapping[str, Any] | None = None
    hidden: bool = False
    economy: bool = False


MEMBERS = tuple(entry.name for entry in fields(ViewState))


def members(state: ViewState) -> dict[str, Any]:
    """The state as JSON has it."""
    found = asdict(replace(state, prior=None))
    return found | {"prior": None if state.prior is None else dict(state.prior)}


def merged(state: ViewState, change: Mapping[str, Any]) -> ViewState:
    """The state with the members of `change` in place of its own; of `show` only those layers that are named.

    Another part forgets the particle, unless one is named too. Raises ViewStateError, which changes nothing.
    """
    unknown = [name for name in change if name not in MEMBERS]
    if unknown:
        raise ViewStateError(f"a view has no member {unknown[0]!r:.60}; it has {', '.join(MEMBERS)}")
    found: dict[str, Any] = {name: _READERS[name](state, value, name) for name, value in change.items()}
    if found.get("part", state.part) != state.part and "particle" not in found:
        found["particle"] = None
    new = replace(state, **found)
    if new.particle is not None and new.part is None:
        raise ViewStateError(f"particle {new.particle} is of no part; expected a 'part' with it")
    return new


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= FARTHEST:
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected a finite number of metres")
    return float(value)


def _index(state: ViewState, value: object, name: str) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 2**31:
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected a whole number from 0 on, or null")
    return value


def _flag(state: ViewState, value: object, name: str) -> bool:
    if not isinstance(value, bool):
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected true or false")
    return value


def _show(state: ViewState, value: object, name: str) -> Show:
    if not isinstance(value, Mapping):
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected an object of layers")
    for layer in value:
        if layer not in LAYERS:
            raise ViewStateError(f"layer {layer!r:.60} is not in a view; it has {', '.join(LAYERS)}")
    return replace(state.show, **{layer: _flag(state, chosen, layer) for layer, chosen in value.items()})


def _one_of(*choices: str) -> Any:
    def read(state: ViewState, value: object, name: str) -> str:
        if value not in choices:
            raise ViewStateError(f"'{name}' is {value!r:.60}; expected {' or '.join(choices)}")
        return str(value)

    return read


def _confidence(state: ViewState, value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected a share above 0 and below 1, such as 0.75")
    return float(value)


def _name(state: ViewState, value: object, name: str) -> str | None:
    if value is not None and not isinstance(value, str):
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected the name of a part, or null")
    return value


def _edge(state: ViewState, value: object, name: str) -> tuple[str, str] | None:
    if value is None:
        return None
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected the names of two parts, or null")
    one, other = (_name(state, end, name) for end in value)
    if one is None or other is None:
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected the names of two parts, or null")
    return one, other


def _compare(state: ViewState, value: object, name: str) -> Compare | None:
    if value is None:
        return None
    if not isinstance(value, Mapping) or not isinstance(value.get("session_id"), str):
        raise ViewStateError(f"'{name}' is {value!r:.60}; expected {{session_id, iteration}}, or null")
    if set(value) - {"session_id", "iteration"}:
        raise ViewStateError(f"'{name}' has {', '.join(map(str, value)):.80}; expected session_id and iteration")
    return Compare(value["session_id"], _index(state, value.get("iteration"), "compare.iteration"))


def _numbers(value: object, count: int, name: str) -> tuple[float, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != count:
        raise ViewStateError(f"'{name}' is {value!r:.80}; expected {count} numbers, metres in world")
    return tuple(_number(entry, name) for entry in value)


def _eye(state: ViewState, value: object, name: str) -> Eye | None:
    if value is None:
        return None
    if not isinstance(value, Mapping) or set(value) != {"position", "look_at", "up"}:
        raise ViewStateError(f"'{name}' is {value!r:.80}; expected {{position, look_at, up}}, or null")
    position, look_at, up = (_triple(value[key], f"{name}.{key}") for key in ("position", "look_at", "up"))
    if math.dist(position, look_at) < 1e-6 or math.hypot(*up) < 1e-6:
        raise ViewStateError(f"'{name}' looks nowhere; expected a position apart from look_at, and a direction up")
    return Eye(position, look_at, up)


def _triple(value: object, name: str) -> Triple:
    x, y, z = _numbers(value, 3, name)
    return x, y, z


def _region(state: ViewState, value: object, name: str) -> tuple[float, ...] | None:
    if value is None:
        return None
    box = _numbers(value, 6, name)
    if any(low >= high for low, high in zip(box[:3], box[3:], strict=True)):
        raise ViewStateError(f"'{name}' is {list(box)}; expected x0 < x1, y0 < y1 and z0 < z1")
    return box


def _prior(state: ViewState, value: object, name: str) -> Mapping[str, Any] | None:
    """Only its form; whether it fits the model is asked where the model is known."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or value.get("kind") != "gaussian":
        raise ViewStateError(f"'{name}' is {value!r:.80}; expected a gaussian prior as in prior.json, or null")
    return dict(value)


_READERS: Mapping[str, Any] = {
    "iteration": _index,
    "show": _show,
    "colour_scan": _one_of(*SCAN_COLOURS),
    "colour_particles": _one_of(*PARTICLE_COLOURS),
    "confidence": _confidence,
    "part": _name,
    "edge": _edge,
    "particle": _index,
    "compare": _compare,
    "theme": _one_of(*THEMES),
    "camera": _eye,
    "region": _region,
    "prior": _prior,
    "hidden": _flag,
    "economy": _flag,
}
