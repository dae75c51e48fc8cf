"""Which options do the studies of success share? Seeds, budget and settings."""

from __future__ import annotations

import argparse

from pmpnbp.settings import METHODS, SessionOptions, Settings, changed, preset
from sample_data.scenes import Scene
from sample_data.sensor import KINDS


def parser(description: str, *, seeds: int, iterations: int) -> argparse.ArgumentParser:
    """A parser with the shared options and these defaults."""
    options = argparse.ArgumentParser(description=description)
    options.add_argument("--seeds", type=int, default=seeds, help=f"runs of each scene (default {seeds})")
    options.add_argument(
        "--iterations", type=int, default=iterations, help=f"at most, if it does not converge (default {iterations})"
    )
    options.add_argument("--particles", type=int, default=SessionOptions.particles, help="M (default %(default)s)")
    options.add_argument(
        "--method", choices=METHODS, default=SessionOptions.method, help="how to infer (default %(default)s)"
    )
    options.add_argument(
        "--config", action="append", default=[], metavar="NAME=VALUE", help="a setting other than the preset's"
    )
    return options


def add_sensor(parser: argparse.ArgumentParser) -> None:
    """The option by which a study's scenes are seen by another camera."""
    parser.add_argument(
        "--sensor", choices=KINDS, default=Scene.sensor, help="kind of the camera in the scenes (default %(default)s)"
    )


def add_halves(parser: argparse.ArgumentParser) -> None:
    """The options by which a study's seeds are chosen, for `halved`."""
    parser.add_argument("--tuning", action="store_true", help="the even seeds, that constants may be chosen on")
    parser.add_argument("--first", type=int, default=0, help="an even number that the seeds begin from (default 0)")


def halved(arguments: argparse.Namespace) -> range:
    """The seeds of a study: the odd ones, or with `--tuning` the even ones."""
    first = arguments.first + (not arguments.tuning)
    return range(first, first + 2 * arguments.seeds, 2)


def settings(arguments: argparse.Namespace) -> Settings:
    """The preset `robust` with the settings of `--config`. Raises SettingError for an unknown one."""
    return changed(preset("robust"), dict(entry.partition("=")[::2] for entry in arguments.config))
