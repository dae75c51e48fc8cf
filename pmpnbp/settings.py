"""What can be asked of an inference: every option and every setting with its name, default, unit, limits and help.

An option is one entry of `SessionOptions` and holds for the whole of an inference; a setting is one entry of `Settings`
and can be changed between iterations. Command line, REST and page are derived from these entries. The defaults of the
settings are the preset `robust`; the preset `paper` turns every deviation from the paper off: algorithm boxes 1 and 2
and equations 10 and 11 to the letter. docs/algorithm.md gives the measured reason for each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

from pmpnbp.errors import SettingError

# How an inference is made: the paper's algorithm boxes 1 and 2, or the particle filter it compares them with.
Method = Literal["pmpnbp", "particle_filter"]
METHODS: tuple[str, ...] = get_args(Method)
# Kinds of depth cameras.
SENSORS = ("structured_light", "time_of_flight", "stereo")


def _setting(
    default: Any,
    unit: str,
    help_text: str,
    *,
    paper: Any = None,
    low: float = -math.inf,
    high: float = 100.0,
    choices: tuple[str, ...] = (),
) -> Any:
    """One entry. `paper` is the value in the preset `paper` where it differs; `low` and `high` are the smallest and the
    largest value allowed: a larger one would tell nothing more, and take all memory or be too large to reckon with."""
    metadata = {"unit": unit, "help": help_text, "paper": default if paper is None else paper}
    high = high if type(default) in (int, float) else math.inf
    return field(default=default, metadata=metadata | {"low": low, "high": high, "choices": choices})


@dataclass(frozen=True)
class SessionOptions:
    """What an inference is asked for beside model, scans and settings. `SessionOptions.seed` is its default."""

    method: str = _setting(
        "pmpnbp", "", "belief propagation over the parts, or a particle filter over whole objects", choices=METHODS
    )
    particles: int = _setting(400, "", "particles of each part", low=2, high=20_000)
    iterations: int = _setting(100, "", "iterations at most; a run may end earlier", low=1, high=100_000)
    seed: int = _setting(0, "", "the same seed and input give the same numbers", low=0, high=2**63 - 1)
    roi: tuple[float, ...] | None = _setting(
        None,
        "m",
        "region of interest: x0 y0 z0 x1 y1 z1 of a box that holds the object, world; default: all that was seen",
    )
    prior: Mapping[str, Any] | None = _setting(
        None, "", "what is known beforehand, as prior.json; default: upright, anywhere on the points seen"
    )
    # the paper's 0.25 cm
    max_std: float = _setting(
        0.0025,
        "m",
        "a link is certain where its standard deviation is not larger along any axis; above 0",
        low=0,
        high=math.inf,
    )


@dataclass(frozen=True)
class Settings:
    """All settings, frozen. Build one with `preset` and `changed`."""

    image_width: int = _setting(
        120,
        "pixels",
        "width of the working depth image, at most; twice that in a region much larger than the object",
        low=16,
        high=1280,
    )
    triangles: int = _setting(
        500, "triangles", "triangle budget of a part's mesh in the inference", low=12, high=100_000
    )
    renderer: Literal["splats", "rasteriser"] = _setting(
        "splats", "", "how a part alone is rendered", choices=("splats", "rasteriser")
    )
    splat_points: int = _setting(256, "points", "visible surface points that stand for a part", low=16, high=4096)
    pixel_score: Literal["robust", "distance"] = _setting(
        "robust",
        "",
        "score of a pixel: robust, or eq. 10's plain distance",
        paper="distance",
        choices=("robust", "distance"),
    )
    tolerance_start: float = _setting(0.06, "m", "distance at which a pixel stops to be explained, at first", low=1e-4)
    tolerance_end: float = _setting(0.012, "m", "the same once annealed", low=1e-4)
    sensor: Literal["estimated", "structured_light", "time_of_flight", "stereo"] = _setting(
        "estimated",
        "",
        "how noisy depths are: as the scan's own surfaces say, or as is usual of such a sensor",
        choices=("estimated", *SENSORS),
    )
    free_space_cost: float = _setting(
        1.0,
        "",
        "cost of a pixel where the scan sees through the surface, up to six times that amid a smooth one",
        low=0,
    )
    occlusion_cost: float = _setting(0.02, "", "cost of a pixel where something stands before the surface", low=0)
    support_reward: float = _setting(0.1, "", "largest reward of a pixel on a floor, wall or table", low=0)
    continued_reward: float = _setting(
        0.0, "", "share of a pixel's reward on a smooth surface that goes on where the object ends", paper=1.0, low=0
    )
    depth_scale_std: float = _setting(
        0.0, "", "a camera's depths are all too long by one share, 0 give or take this; 0: by none", low=0, high=0.2
    )
    camera_std: float = _setting(
        0.005,
        "m",
        "further cameras are off by 0 give or take this, and turned as far; 0: by none",
        paper=0.0,
        low=0,
        high=0.2,
    )
    size_std: float = _setting(
        0.0,
        "",
        "the object is larger than its model each way by a share, 0 give or take this; 0: by none",
        low=0,
        high=0.2,
    )
    unary_scale: float = _setting(1.0, "", "lambda_r of eq. 10 where weights are not tempered", low=0)
    effective_share: float = _setting(
        0.15, "", "share of particles that tempering keeps effective; 0 turns tempering off", paper=0.0, low=0
    )
    pairwise_form: Literal["projected", "limits"] = _setting(
        "projected",
        "",
        "pairwise potential: residual after projection on the joint, or eq. 11",
        paper="limits",
        choices=("projected", "limits"),
    )
    sigma_position: float = _setting(0.01, "m", "sigma_pos of the pairwise potential, once annealed", low=1e-5)
    sigma_orientation: float = _setting(0.05, "rad", "sigma_ori of the pairwise potential, once annealed", low=1e-5)
    joint_draws: int = _setting(8, "draws", "joint positions tried for each message sample", paper=1, low=1, high=256)
    joint_memory: float = _setting(
        0.5, "", "share of those draws taken near positions that did well", paper=0.0, low=0, high=1.0
    )
    neighbour_proposals: float = _setting(
        0.35, "", "share of a part's particles proposed through joints from its neighbours", paper=0.0, low=0, high=1.0
    )
    belief_product: Literal["shared", "pooled"] = _setting(
        "shared",
        "",
        "incoming messages judge one shared sample set (their product), or box 2's pooled sets",
        paper="pooled",
        choices=("shared", "pooled"),
    )
    messages_keep_unary: bool = _setting(
        False, "", "box 2 step 1a to the letter: messages keep the receiver's unary factor", paper=True
    )
    prior_factor: bool = _setting(True, "", "a gaussian prior goes on weighing its part after the start", paper=False)
    object_estimate: bool = _setting(
        True, "", "estimate the object as a whole each iteration, else each part's best particle", paper=False
    )
    neighbour_sum: bool = _setting(True, "", "weigh message samples by the sender's other messages (box 1 step 2c)")
    anneal_iterations: int = _setting(
        2,
        "iterations",
        "over which tolerance and diffusion shrink, half after a search with a narrow prior",
        paper=0,
        low=0,
        high=10_000,
    )
    diffusion_position_start: float = _setting(0.04, "m", "diffusion of particles at first", low=0)
    diffusion_position_end: float = _setting(0.0015, "m", "diffusion of particles, once annealed", paper=0.01, low=0)
    diffusion_rotation_start: float = _setting(0.15, "rad", "turning of particles at first", low=0)
    diffusion_rotation_end: float = _setting(0.005, "rad", "turning of particles, once annealed", paper=0.05, low=0)
    search_iterations: int = _setting(
        4,
        "iterations",
        "of whole-object search before belief propagation, half with a narrow prior; 0 starts as the paper does",
        paper=0,
        low=0,
        high=1000,
    )
    search_iterations_per_joint: int = _setting(
        1,
        "iterations",
        "more for every joint in a row beyond the second; chains of ten joints and more take one in all",
        low=0,
        high=100,
    )
    search_proposals: int = _setting(
        3000, "hypotheses", "tried in each iteration of the search, for every three joints", low=10, high=200_000
    )
    search_explained: float = _setting(
        0.8, "", "share of what the search's result covers that the scan must confirm, else it searches again", low=0
    )
    search_unexplained: float = _setting(
        0.5,
        "",
        "as a multiple of what the search's result explains, what else may be the object, from which on it is looked "
        "for there, too; 0 never",
        low=0,
    )
    search_restarts: int = _setting(2, "searches", "made again at most, in its last iteration", low=0, high=100)
    search_islands: int = _setting(
        40, "hypotheses", "distinct ones that survive each iteration of the search", low=1, high=2000
    )
    view_explained: float = _setting(
        0.62,
        "",
        "share of what should be seen in a new view that it must confirm, else the search begins again; 0: never",
        paper=0.0,
        low=0,
        high=1.0,
    )
    moved_std_xyz: float = _setting(
        0.05, "m", "how far the object may have moved along each axis where a scan replaces others", low=0, high=1e4
    )
    moved_std_rpy: float = _setting(0.15, "rad", "how far it may have been turned then", low=0)
    moved_joint_share: float = _setting(
        0.5, "", "how far each joint may have been moved then, as a share of its range", low=0, high=1.0
    )
    refine_iterations: int = _setting(
        0, "iterations", "after annealing that score with the rasteriser instead of splats", paper=0, low=0, high=10_000
    )
    converged_motion: float = _setting(0.001, "m", "largest motion of any part between iterations at rest", low=0)
    converged_iterations: int = _setting(3, "iterations", "at rest in a row that count as converged", low=1, high=1000)

    def __post_init__(self) -> None:
        for entry in fields(self):
            _check(entry.name, getattr(self, entry.name), entry.metadata, type(entry.default))


def _check(name: str, value: Any, metadata: Mapping[str, Any], kind: type) -> None:
    if metadata["choices"] and value not in metadata["choices"]:
        raise SettingError(f"setting '{name}' is {value!r}; it can be {' or '.join(metadata['choices'])}")
    low, high = metadata["low"], metadata["high"]
    of = f" {metadata['unit']}" if metadata["unit"] in ("m", "rad") else ""
    if kind in (int, float) and not (math.isfinite(value) and value >= low):
        raise SettingError(f"setting '{name}' is {value!r}; it must be a finite number of at least {low}{of}")
    if kind in (int, float) and value > high:
        raise SettingError(f"setting '{name}' is {value!r}; it must be at most {high}{of}")


def checked_option(name: str, value: Any) -> Any:
    """The value of a simple option: its method, or a number. Raises SettingError for one that it cannot have: also for
    a `max_std` of 0, which no standard deviation is within."""
    entry = next(one for one in fields(SessionOptions) if one.name == name)
    found = _convert(name, value, type(entry.default))
    if name == "max_std" and found <= 0:
        raise SettingError(f"'max_std' is {value!r}; expected metres above zero")
    _check(name, found, entry.metadata, type(entry.default))
    return found


def check_method(method: str) -> None:
    """Raise SettingError where `method` is none of METHODS."""
    if method not in METHODS:
        raise SettingError(f"method '{method}' does not exist; there are {' and '.join(METHODS)}")


def preset(name: str) -> Settings:
    """The preset `robust` (all defaults) or `paper`. Raises SettingError for another name."""
    if name == "robust":
        return Settings()
    if name == "paper":
        return Settings(**{entry.name: entry.metadata["paper"] for entry in fields(Settings)})
    raise SettingError(f"preset '{name}' does not exist; there are robust and paper")


def changed(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """`settings` with `changes`, whose values may be text. `preset` among them is applied first.

    Raises SettingError for an unknown name, naming those there are, or a value of the wrong kind.
    """
    if "preset" in changes:
        settings = preset(str(changes["preset"]))
    known = {entry.name: entry for entry in fields(Settings)}
    values: dict[str, Any] = {}
    for name, value in changes.items():
        if name == "preset":
            continue
        if name not in known:
            raise SettingError(f"setting '{name}' does not exist; there are preset, {', '.join(known)}")
        values[name] = _convert(name, value, type(known[name].default))
    return replace(settings, **values)


def _convert(name: str, value: Any, kind: type) -> Any:
    if kind is bool:
        if isinstance(value, bool):
            return value
        if str(value).lower() in ("true", "1", "yes", "false", "0", "no"):
            return str(value).lower() in ("true", "1", "yes")
    elif kind is str:
        return str(value)
    elif not isinstance(value, bool):
        try:
            number = float(value)
            if kind is float:
                return number
            if number == int(number):
                return int(number)
        except (TypeError, ValueError, OverflowError):
            pass
    expected = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
    raise SettingError(f"setting '{name}' is {value!r}; it must be {expected}")


@dataclass(frozen=True)
class Schedule:
    """What the annealing has reached in an iteration: see `schedule`."""

    progress: float
    tolerance: float
    diffusion_position: float
    diffusion_rotation: float
    sigma_position: float
    sigma_orientation: float


def schedule(
    settings: Settings, iteration: int, search_iterations: int | None = None, anneal_iterations: int | None = None
) -> Schedule:
    """Annealed values in an `iteration` from 1 on: geometric from start to end over search and annealing together.

    search_iterations, anneal_iterations : as many as the problem has; without them those of the settings.
    """
    before = settings.search_iterations if search_iterations is None else search_iterations
    annealing = settings.anneal_iterations if anneal_iterations is None else anneal_iterations
    span = annealing + before if annealing else 0
    progress = 1.0 if span == 0 else min(max(iteration - 1, 0) / span, 1.0)

    def between(start: float, end: float) -> float:
        return end if progress == 1.0 or start <= 0 or end <= 0 else start ** (1 - progress) * end**progress

    position = between(settings.diffusion_position_start, settings.diffusion_position_end)
    rotation = between(settings.diffusion_rotation_start, settings.diffusion_rotation_end)
    return Schedule(
        progress,
        between(settings.tolerance_start, settings.tolerance_end),
        position,
        rotation,
        # two particles that fit each other are apart by the diffusion of both, so the kernel is no narrower than that
        settings.sigma_position if span == 0 else max(settings.sigma_position, 1.5 * position),
        settings.sigma_orientation if span == 0 else max(settings.sigma_orientation, 1.5 * rotation),
    )
