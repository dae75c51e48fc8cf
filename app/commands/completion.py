"""`pmpnbp completion`: the script with which a shell completes commands, options, choices and files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import shtab


def run(arguments: argparse.Namespace) -> int:
    """Print the script for `arguments.shell`; return 0."""
    _prepare(arguments.parser)
    sys.stdout.write(shtab.complete(arguments.parser, shell=arguments.shell) + "\n")
    return 0


def _prepare(parser: argparse.ArgumentParser) -> None:
    """Tell shtab which arguments are files and folders: those that are read as a path, and those that stand for DIR. Of
    a command it shows the line of the list of commands, not all that its help begins with."""
    for action in parser._actions:  # argparse has no public way to go through them; shtab takes this one, too
        if isinstance(action, argparse._SubParsersAction):
            for listed in action._choices_actions:
                command = action.choices[listed.dest]
                command.description = listed.help
                _prepare(command)
        elif action.metavar == "DIR":
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
