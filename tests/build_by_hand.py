"""The steps of the Dockerfile without a container engine: each instruction carried out in copies of a bare Debian root.

    debootstrap --variant=minbase --include=python3,python3-pip,python3-venv bookworm ROOT
    python -m tests.build_by_hand ROOT WORK [--bind FOLDER ...] [--pass NAME ...]

What comes out is `WORK/image`, a root to be entered by `chroot`, whose size is printed. As root, on Linux. `--bind`
shows a folder of the host inside, and `--pass` hands an environment variable on: what a network behind a proxy needs.
Debian's own Python stands in for that of the base image; VOLUME, EXPOSE, HEALTHCHECK, ENTRYPOINT and CMD change no
file and are left to `tests/test_deployment.py`.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from tests.dockerfile import copy_parts, instructions

PROJECT = Path(__file__).resolve().parent.parent
CHANGE_NO_FILE = ("VOLUME", "EXPOSE", "HEALTHCHECK", "ENTRYPOINT", "CMD")


class Stage:
    """A root being built: its folder, what ENV, WORKDIR and USER have set."""

    def __init__(self, root: Path, environment: dict[str, str], bind: list[str]) -> None:
        self.root = root
        self.environment = dict(environment)
        self.bind = bind
        self.folder = "/"
        self.user = "root"

    def run(self, command: str) -> None:
        """RUN: in a mount namespace of its own, so that nothing stays mounted."""
        mounts = [
            "mount --make-rprivate /",
            f"mount -t proc proc {self.root}/proc",
            f"mount --rbind /dev {self.root}/dev",
        ]
        for folder in self.bind:
            (self.root / folder.lstrip("/")).mkdir(parents=True, exist_ok=True)
            mounts.append(f"mount --rbind {folder} {self.root}{folder}")
        settings = " ".join(f"{name}={shlex.quote(value)}" for name, value in self.environment.items())
        inside = f"cd {shlex.quote(self.folder)} && {command}"
        steps = [*mounts, f"chroot {self.root} /usr/bin/env -i {settings} /bin/sh -c {shlex.quote(inside)}"]
        subprocess.run(["unshare", "--mount", "sh", "-ec", "\n".join(steps)], check=True)

    def copy(self, argument: str, stages: dict[str, Stage]) -> None:
        """COPY, from the project or from an earlier stage."""
        options, sources, target = copy_parts(argument)
        origin = stages[options["from"]].root if "from" in options else PROJECT
        for source in sources:
            place = origin / source.lstrip("/")
            goal = self.root / os.path.join(self.folder, target).lstrip("/")
            if not place.is_dir() and (len(sources) > 1 or target.endswith(("/", "."))):
                goal = goal / place.name
            goal.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run(["cp", "-aT" if place.is_dir() else "-pT", str(place), str(goal)], check=True)
            if origin == PROJECT:  # .dockerignore
                for cache in [*goal.rglob("__pycache__")] if goal.is_dir() else []:
                    shutil.rmtree(cache)
                subprocess.run(["chown", "-R", "root:root", str(goal)], check=True)
            if "chown" in options:
                self.run(f"chown -R {options['chown']} {shlex.quote('/' + str(goal.relative_to(self.root)))}")


def build(base: Path, work: Path, bind: list[str], handed_on: dict[str, str]) -> Stage:
    """Every stage of the Dockerfile, each in its folder of `work`; the last one."""
    stages: dict[str, Stage] = {}
    stage = Stage(base, {}, bind)
    for name, argument in instructions((PROJECT / "Dockerfile").read_text(encoding="utf-8")):
        print(f"{name} {argument}", flush=True)
        if name == "FROM":
            origin, _, called = (argument + " AS image").partition(" AS ")
            called = called.split()[0]
            parent = stages.get(origin)
            shutil.rmtree(work / called, ignore_errors=True)
            subprocess.run(["cp", "-a", str(parent.root if parent else base), str(work / called)], check=True)
            standard = {"PATH": "/usr/local/bin:/usr/local/sbin:/usr/bin:/usr/sbin:/bin:/sbin", **handed_on}
            stage = stages[called] = Stage(work / called, parent.environment if parent else standard, bind)
            if parent is None:  # the base image has its Python under these names
                for program in ("python", "python3"):
                    link = stage.root / "usr" / "local" / "bin" / program
                    link.unlink(missing_ok=True)
                    link.symlink_to("/usr/bin/python3")
        elif name == "ENV":
            for word in shlex.split(argument):
                key, _, value = word.partition("=")
                stage.environment[key] = value.replace("$PATH", stage.environment["PATH"])
        elif name == "WORKDIR":
            stage.folder = argument
            (stage.root / argument.lstrip("/")).mkdir(parents=True, exist_ok=True)
        elif name == "COPY":
            stage.copy(argument, stages)
        elif name == "RUN":
            stage.run(argument)
        elif name == "USER":
            stage.user = argument
        elif name not in CHANGE_NO_FILE:
            raise SystemExit(f"instruction {name} is not one that this script knows")
    for key in handed_on:
        stage.environment.pop(key, None)
    return stage


def main() -> None:
    """Build, print the size and how to enter."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--bind", action="append", default=[])
    parser.add_argument("--pass", action="append", default=[], dest="names")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    stage = build(
        options.root.resolve(),
        options.work.resolve(),
        options.bind,
        {name: os.environ[name] for name in options.names if name in os.environ},
    )
    size = subprocess.run(["du", "-sxb", str(stage.root)], capture_output=True, text=True, check=True).stdout.split()[0]
    print(f"{stage.root}: {int(size) / 1e9:.2f} GB; environment {stage.environment}; user {stage.user}")


if __name__ == "__main__":
    sys.exit(main())
