"""The command `pmpnbp`: what can be asked for on the command line, and how it ends.

Exit status 0; 2 for bad input, with one sentence on standard error; 1 where standard output cannot be written; 130 when
interrupted. Whatever takes long to import is imported by the command that needs it, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import importlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import NoReturn

from app import compiled_kernels
from app.help_examples import example
from app.interrupts import keep_interrupts
from app.option_values import OPTIONS, assignment, option, server_value, whole, within
from app.server_config import ServerConfig, environment_name
from app.standard_streams import StandardOutputError, drop_output, hold
from pmpnbp.errors import PmpnbpError
from pmpnbp.importing import many_modules
from pmpnbp.settings import SENSORS, SessionOptions

OK, NOT_WRITTEN, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
EXPERIMENTS = ("convergence", "occlusion", "robot", "planning", "push")
SHELLS = ("bash", "zsh", "fish")


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one sentence, as all our errors are."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message}; see {self.prog} --help\n")
        raise SystemExit(BAD_INPUT)


class _Help(argparse.HelpFormatter):
    """Wraps paragraphs, and leaves examples as they stand."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith("example") else super()._fill_text(text, width, indent)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (without the program's name) and return its exit status."""
    try:
        status = _status(argv)
        sys.stdout.flush()
        return status
    except StandardOutputError as error:
        sys.stderr.write(f"pmpnbp: {error}\n")
        return NOT_WRITTEN
    except BrokenPipeError:  # the reader of standard output has gone, as `head` does
        return OK


def _status(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parse(sys.argv[1:] if argv is None else argv)
    except SystemExit as done:  # --help, --version, and errors: a caller in the same process wants the status
        return done.code if isinstance(done.code, int) else BAD_INPUT
    try:
        compiled_kernels.choose()
        # imported here: what a command needs takes long to import, and no other command should wait for it
        with many_modules():
            command = importlib.import_module(f"app.commands.{arguments.command}")
        return command.run(arguments)
    except PmpnbpError as error:
        sys.stderr.write(f"pmpnbp {arguments.command}: {error}\n")
        return BAD_INPUT
    except (KeyboardInterrupt, SystemError) as error:
        # one that comes while a compiled function looks at its arguments is told by a SystemError
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        sys.stderr.write(f"pmpnbp {arguments.command}: interrupted\n")
        return INTERRUPTED


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = _parser()
    given = list(argv)
    # `--roi -0.1,…`: argparse would take the box for an option, as it starts with a minus and is no single number
    for place in range(len(given) - 1):
        if given[place] == "--roi":
            given[place : place + 2] = [f"--roi={given[place + 1]}"]
            break
    arguments, rest = parser.parse_known_args(given)
    # scans after an option, as in `MODEL A --camera CA B --camera CB`, which argparse leaves over
    scans = [] if arguments.command != "estimate" else [text for text in rest if not text.startswith("-")]
    unknown = [text for text in rest if text not in scans]
    if unknown:
        parser.error(f"{' '.join(unknown)} is not an option of {arguments.command}")
    if scans:
        arguments.scans += [Path(text) for text in scans]
    return arguments


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="pmpnbp",
        description="Poses of the links and positions of the joints of an articulated object, from depth scans.",
        epilog=example("estimate"),
        formatter_class=_Help,
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_estimate(commands)
    _add_serve(commands)
    _add_view(commands)
    commands.add_parser("settings", help="list every setting that --config takes")
    benchmark = commands.add_parser("benchmark", help="measure speeds, as ratios against references in the same run")
    benchmark.add_argument("--out", type=Path, metavar="FILE", help="where the figures go, as JSON")
    _add_reproduce(commands)
    _add_calibrate(commands)
    _add_batch(commands)
    completion = commands.add_parser("completion", help="print a script that completes commands and options in a shell")
    completion.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))
    completion.set_defaults(parser=parser)
    for name, command in commands.choices.items():
        command.formatter_class = _Help
        command.epilog = command.epilog or example(name)
    return parser


class _Version(argparse.Action):
    """Prints the version. An action of ours, because looking it up takes time that no other command should spend."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from pmpnbp.version import version

        sys.stdout.write(f"pmpnbp {version()}\n")
        parser.exit()


def _add_estimate(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "estimate",
        help="find an object in one scene's scans",
        description="Find the object MODEL in one or several scans of one scene. The result is JSON, progress goes to "
        "standard error.",
    )
    add = command.add_argument
    add("model", type=Path, metavar="MODEL", help="a URDF, or a zip holding one with its meshes")
    add("scans", type=Path, metavar="SCAN", nargs="+", help="PNG, PCD, PLY, XYZ, NPY or NPZ; several are several views")
    add(
        "--camera",
        type=Path,
        metavar="FILE",
        action="append",
        default=[],
        help="camera.json; once for all scans, or once for each in their order",
    )
    _add_session_options(command, [entry.name for entry in fields(SessionOptions)])
    add(
        "--config",
        type=assignment,
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="a setting, may be given again; `pmpnbp settings` lists them; preset=paper is the paper's algorithm",
    )
    add("--truth", type=Path, metavar="FILE", help="truth.json; adds the errors against it (ADD, ADD-S) to the result")
    add("--out", type=Path, metavar="FILE", help="where the result goes; default: standard output")
    add("--recording", type=Path, metavar="FILE", help="every iteration, as one SQLite file")
    add("--draws", type=Path, metavar="FILE", help="1000 draws of the posterior, as netCDF that ArviZ reads")
    add("--quiet", action="store_true", help="no progress on standard error")


def _add_serve(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "serve",
        help="start the server: page, REST and 3D view on one port",
        description="Start the server: page, REST and 3D view on one port. It prints the link to its page and serves "
        "until SIGTERM or Ctrl-C; sessions are kept. Every option can also be set in the environment, as the name in "
        "brackets; the option goes first.",
    )
    for entry in fields(ServerConfig):
        about = entry.metadata
        unit = f"{about['unit']} " if about["unit"] and not about["help"].startswith("requests") else ""
        default = "" if about["default"] is None or entry.name == "demo" else f"; default: {about['default']}"
        text = f"{unit}{about['help']}{default} [{environment_name(entry.name)}]"
        if entry.name == "demo":
            command.add_argument(option(entry.name), action=argparse.BooleanOptionalAction, help=text)
        else:
            metavar = {"data_dir": "DIR", "host": "ADDRESS", "token": "TOKEN"}.get(entry.name, "N")
            command.add_argument(option(entry.name), type=server_value(entry.name), metavar=metavar, help=text)


def _add_view(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "view",
        help="look at a recording in the browser",
        description="Look at a recording in the browser. A server of its own on this machine shows it, prints the link "
        "to its page and ends with SIGTERM or Ctrl-C; the file is not changed.",
    )
    command.add_argument("recording", type=Path, metavar="RECORDING", help="what `estimate --recording` writes")
    command.add_argument(
        "--port", type=whole(0, 65535), default=0, metavar="N", help="port to listen on; default: a free one"
    )
    command.add_argument(
        "--no-browser", dest="browser", action="store_false", help="print the link only, open no browser"
    )


def _add_reproduce(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "reproduce",
        help="make an experiment of the paper again",
        description="Make an experiment of the paper again: figures (PNG), tables (CSV) and a report that says which "
        "of its claims hold. Runs are kept as they are made: after an interruption the same command goes on.",
    )
    add = command.add_argument
    add("experiment", choices=EXPERIMENTS, metavar="EXPERIMENT", help=", ".join(EXPERIMENTS))
    add("--runs", type=whole(1, 1000), default=10, metavar="N", help="of each case; default: %(default)s")
    add("--out", type=Path, metavar="DIR", help="where everything goes; default: out/EXPERIMENT")
    add("--seed", type=whole(0, 2**31), default=0, metavar="N", help="the first run's; default: %(default)s")
    add("--iterations", type=within("iterations"), metavar="N", help="default: the experiment's own")
    add("--particles", type=within("particles"), metavar="N", help="of each part; default: the experiment's own")
    add("--all", action="store_true", help="convergence: every sample scene, not only two cabinets")
    add("--urdf", type=Path, metavar="FILE", help="robot: another robot, in a scan that is rendered of it")
    _add_spreading(command)


def _add_calibrate(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "calibrate",
        help="is the belief honest for a model, a camera and a region?",
        description="Is the belief honest for this object and camera? Scenes are rendered whose truth is drawn from "
        "the prior, the object is looked for in each as `estimate` does, and what is said of it is held against the "
        "truth: histograms of ranks, coverage, how far `certain` can be relied on. Figures (PNG), tables (CSV) and a "
        "report (Markdown) whose first sentence answers. One run in five is without the object. Runs are kept as they "
        "are made: after an interruption the same command goes on.",
    )
    add = command.add_argument
    add("model", type=Path, metavar="MODEL", help="a URDF, or a zip holding one with its meshes")
    add("--camera", type=Path, metavar="FILE", help="camera.json; default: one that has the region in its picture")
    read, metavar = OPTIONS["roi"]
    add("--roi", type=read, metavar=metavar, help="m, world: where the object is; default: a box that it has room in")
    add("--prior", type=Path, metavar="FILE", help="prior.json; default: upright, anywhere in the region, any yaw")
    add("--sensor", choices=SENSORS, default=SENSORS[0], help="kind of the camera; default: %(default)s")
    add("--runs", type=whole(1, 100_000), default=200, metavar="N", help="scenes; default: %(default)s")
    add("--seed", type=whole(0, 2**31), default=0, metavar="N", help="the first scene's; default: %(default)s")
    _add_session_options(command, ("particles", "iterations", "max_std"))
    add("--out", type=Path, metavar="DIR", help="where everything goes; default: out/calibrate_MODEL")
    _add_spreading(command)


def _add_batch(commands: argparse._SubParsersAction[_Parser]) -> None:
    command = commands.add_parser(
        "batch",
        help="many estimates: a list of scans, or a folder of scene folders",
        description="Make every estimate that MANIFEST asks for: a CSV file with a header, or JSON lines, with model, "
        "scan or scans, camera, roi, prior, seed and other options as columns; or a folder whose folders hold a scan "
        "each. Results (JSON), pictures, a table (CSV) and a report (HTML) go to --out. Rows are kept as they are "
        "made: after an interruption the same command goes on, and makes those anew whose files or options have "
        "changed.",
    )
    add = command.add_argument
    add("manifest", type=Path, metavar="MANIFEST", help="a CSV or JSON lines file, or a folder of scene folders")
    add("--out", type=Path, metavar="DIR", help="where everything goes; default: out/batch_MANIFEST")
    _add_spreading(command)
    for_all = command.add_argument_group("for every row that does not say it itself")
    for_all.add_argument("--model", type=Path, metavar="MODEL", help="a URDF, or a zip holding one with its meshes")
    for_all.add_argument("--camera", type=Path, metavar="FILE", help="camera.json")
    _add_session_options(for_all, [entry.name for entry in fields(SessionOptions)])
    for_all.add_argument(
        "--config", type=assignment, metavar="NAME=VALUE", action="append", default=[], help="a setting"
    )
    add("--quiet", action="store_true", help="no progress on standard error")


def _add_spreading(command: _Parser) -> None:
    """Options that say where runs are made."""
    command.add_argument(
        "--processes", type=whole(1, 256), default=1, metavar="N", help="runs at a time; default: %(default)s"
    )
    command.add_argument(
        "--on", metavar="ADDRESS", help="a Dask scheduler whose workers make the runs, as tcp://host:8786"
    )


def _add_session_options(command: argparse._ActionsContainer, names: Sequence[str]) -> None:
    """Those of SessionOptions, with their defaults and help."""
    for entry in fields(SessionOptions):
        if entry.name not in names:
            continue
        about, default = entry.metadata, entry.default
        text = about["help"] + ("" if default is None else f"; default: {default} {about['unit']}".rstrip())
        if about["choices"]:
            command.add_argument(option(entry.name), choices=about["choices"], default=default, help=text)
        else:
            read, metavar = OPTIONS[entry.name]
            command.add_argument(option(entry.name), type=read, default=default, metavar=metavar, help=text)


def program() -> NoReturn:
    """The command line as a process of its own, which ends with the status that `main` returns."""
    status: list[int] = []
    atexit.register(_leave, status)  # what is registered first is called last
    hold()
    keep_interrupts()
    try:
        status.append(main())
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done, and said
    except KeyboardInterrupt:  # once more, while it was ending
        status.append(INTERRUPTED)
    drop_output()
    sys.exit(status[0])


def _leave(status: Sequence[int]) -> None:
    """An interpreter that ends while one of its threads is in the compiler may abort the process: end without it."""
    if status and any(thread.name == compiled_kernels.WARM_UP for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status[0])


if __name__ == "__main__":
    program()
